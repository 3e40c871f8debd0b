"""What a person declares: whether it can be so, and which cluster it is said of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uplift import UpliftError
from uplift.cct import cct_duv, mired, uv_of_xy, xy_of_rgb
from uplift.cluster import Clusters
from uplift.cluster.count import ALIKE_UV
from uplift.illuminants import FAMILIES
from uplift.illuminants.fluorescent import NAMES as FLUORESCENT_NAMES
from uplift.illuminants.led import NAMES as LED_NAMES
from uplift.lights.record import Declared
from uplift.spectrum import Observer, RGBSpace, checked_emission

Floats = npt.NDArray[np.float64]

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
    known: dict[int, Declared] = {}
    used: dict[int, tuple[str, _Place]] = {}
    warnings = []
    for number, one in enumerate(declared):
        name = called(one, number)
        place = _place_of(image, clusters, one, space)
        if not place.luminance > 0:
            raise UpliftError(
                f"{name}: the map is black or empty at {tuple(one.at)}; point to the lamp or to what it lights"
            )
        if place.cluster in known:
            warnings.append(_not_used(name, place, *used[place.cluster], clusters, space))
        else:
            known[place.cluster], used[place.cluster] = one, (name, place)
    return known, warnings


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """What the map shows where a light was declared."""

    cluster: int
    rgb: Floats  # [3] sum over the place
    luminance: float  # the greatest


def _place_of(image: npt.NDArray[np.float32], clusters: Clusters, one: Declared, space: RGBSpace) -> _Place:
    height, width = clusters.labels.shape
    x, y = min(int(one.at[0] * width), width - 1), min(int(one.at[1] * height), height - 1)
    reach = max(0, round(PLACE_RADIUS * width))
    columns = np.arange(x - reach, x + reach + 1) % width
    rows = np.arange(max(y - reach, 0), min(y + reach, height - 1) + 1)
    around = np.ix_(rows, columns)
    rgb = image[around].astype(np.float64)
    rgb = np.where(np.isfinite(rgb).all(axis=2, keepdims=True), np.maximum(rgb, 0.0), 0.0)
    light = rgb @ space.luminance_weights
    votes = np.bincount(clusters.labels[around].ravel().astype(np.int64), light.ravel(), clusters.count)
    return _Place(int(np.argmax(votes)), rgb.sum(axis=(0, 1)), float(light.max()))


def _not_used(name: str, place: _Place, other_name: str, other: _Place, clusters: Clusters, space: RGBSpace) -> str:
    """Why a second declaration in a cluster has no light of its own, and what to do."""
    cluster = place.cluster
    told = f"{name} is not used: it is in the same cluster ({cluster}) as {other_name}, whose spectrum holds there. "
    alike, apart = _apart(place.rgb, other.rgb, clusters.alike, space)
    if alike:
        return told + (
            f"The map shows the two places {apart} apart, too alike to be told apart ({clusters.alike[0]:g} mired or Duv "
            f"{clusters.alike[1]:g} are enough). Declare one of them"
        )
    one_alone = "declare the stronger light alone: what the other lights keeps its colours, under that one's spectrum"
    told += f"The map shows the two places {apart} apart, so they are not too alike, but "
    if clusters.outdoor[cluster]:
        return told + f"sun, sky and all they light count as one outdoor light. If one is no daylight, {one_alone}"
    if clusters.direct[cluster] and place.luminance <= clusters.lamp_above:
        return told + (
            f"this one is too dim beside the other to count as a lamp: its luminance is {place.luminance:.3g}, and a lamp of "
            f"this map begins at {clusters.lamp_above:.3g}; it is taken for something that light {cluster} lights. Point to its "
            f"brightest place, or {one_alone}"
        )
    return told + (
        f"this one sheds too little of the light, or its colours run into the other's, to be found as a light of its own. "
        f"Point to its brightest place, or {one_alone}"
    )


def _apart(one: Floats, other: Floats, limits: tuple[float, float], space: RGBSpace) -> tuple[bool, str]:
    """Whether two colours [3] are so alike that clusters of them are one light, and how far apart they are, in words."""
    xy = xy_of_rgb(np.stack([one, other]), space.xyz_from_rgb)
    cct, duv = cct_duv(xy)
    if np.isfinite(cct).all():
        along, across = float(abs(np.diff(mired(cct))[0])), float(abs(np.diff(duv)[0]))
        return along < limits[0] and across < limits[1], f"{along:.0f} mired and Duv {across:.3f}"
    on_plane = float(np.hypot(*np.diff(uv_of_xy(xy), axis=0)[0]))
    return on_plane < ALIKE_UV, f"{on_plane:.3f} in (u, v)"
