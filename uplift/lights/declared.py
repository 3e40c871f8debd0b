"""What a person declares: whether it can be so, and which cluster it is said of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from uplift import UpliftError
from uplift.cluster import Clusters
from uplift.illuminants import FAMILIES
from uplift.illuminants.fluorescent import NAMES as FLUORESCENT_NAMES
from uplift.illuminants.led import NAMES as LED_NAMES
from uplift.lights.record import Declared
from uplift.spectrum import Observer, RGBSpace, checked_emission

DISCHARGE_NAMES = tuple(f"HP{i}" for i in range(1, 6))
NAMED_TYPES = (
    dict.fromkeys(FLUORESCENT_NAMES, "fluorescent")
    | dict.fromkeys(LED_NAMES, "led")
    | dict.fromkeys(DISCHARGE_NAMES, "discharge")
)
PLACE_RADIUS = 1.0 / 360.0  # of the width: what "at (u, v)" takes in


def called(declared: Declared, number: int) -> str:
    """Return what messages call the declaration."""
    return f"declared light {number + 1}" + (f" ({declared.name})" if declared.name else "")


def mistakes_of(declared: Declared, observer: Observer) -> list[str]:
    """Return what is wrong with a declaration, as far as it can be told without the map."""
    found = []
    if not all(0.0 <= value <= 1.0 for value in declared.at):
        found.append(f"at {tuple(declared.at)}; expected u and v from 0 to 1, from the top left of the map")
    if declared.type is None and declared.cct is None and declared.emission is None:
        found.append("says nothing; give a type, a cct or a measured spectrum, or remove it")
    if declared.emission is not None:
        if declared.type not in (None, "measured") or declared.cct is not None:
            found.append("has a measured spectrum and a type or cct besides; a spectrum says it all, remove the others")
        try:
            checked_emission(declared.emission, observer, place="measured spectrum")
        except UpliftError as error:
            found.append(str(error))
        return found
    if declared.type == "measured":
        found.append("type measured without a spectrum; give one, or another type")
    elif declared.type in NAMED_TYPES:
        if declared.cct is not None:
            found.append(f"{declared.type} is one lamp with a cct of its own; remove cct, or name the type only")
    elif declared.type is not None and declared.type not in FAMILIES:
        found.append(
            f"type {declared.type!r} is unknown; expected one of {', '.join(FAMILIES)}, measured, or a lamp by name "
            "such as FL11, LED-V2, HP1"
        )
    elif declared.cct is not None:
        family = FAMILIES[declared.type or "smooth"]
        if not family.low_k <= declared.cct <= family.high_k:
            found.append(
                f"cct {declared.cct:g} K; expected {family.low_k:g} to {family.high_k:g} K for "
                f"{declared.type or 'a light of unknown type'}. Correct it, or give a measured spectrum"
            )
    return found


def placed(
    image: npt.NDArray[np.float32], clusters: Clusters, declared: Sequence[Declared], space: RGBSpace
) -> tuple[dict[int, Declared], list[str]]:
    """Return which declaration each cluster has and warnings: that of the light most present within 1 degree of its place."""
    height, width = clusters.labels.shape
    known: dict[int, Declared] = {}
    warnings = []
    for number, one in enumerate(declared):
        x, y = min(int(one.at[0] * width), width - 1), min(int(one.at[1] * height), height - 1)
        reach = max(0, round(PLACE_RADIUS * width))
        columns = np.arange(x - reach, x + reach + 1) % width
        rows = np.arange(max(y - reach, 0), min(y + reach, height - 1) + 1)
        around = np.ix_(rows, columns)
        light = image[around].astype(np.float64) @ space.luminance_weights
        light = np.where(np.isfinite(light), np.maximum(light, 0.0), 0.0)
        if light.max() <= 0:
            raise UpliftError(
                f"{called(one, number)}: the map is black or empty at {tuple(one.at)}; point to the lamp or to what it lights"
            )
        votes = np.bincount(clusters.labels[around].ravel().astype(np.int64), light.ravel(), clusters.count)
        cluster = int(np.argmax(votes))
        if cluster in known:
            warnings.append(
                f"{called(one, number)} is in the same cluster ({cluster}) as another declared light, which is used; the "
                "two lights have too similar colours to be told apart"
            )
        else:
            known[cluster] = one
    return known, warnings
