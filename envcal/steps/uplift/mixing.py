"""Lights of known spectra, and the mixtures of two that pixels between them get."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from envcal.config import UpliftSettings
from envcal.lights_file import LightRecord, Lights

if TYPE_CHECKING:
    from uplift.lights.mixtures import Mixtures
    from uplift.spectrum import Observer

#: Emissions that an uplift file may hold.
_MOST_EMISSIONS = 64


def with_mixtures(lights: Lights, settings: UpliftSettings, seen: Observer) -> tuple[Lights, Mixtures | None]:
    """Return the lights with the mixtures behind them that the settings ask for; None where there are none."""
    if not settings.mixtures or settings.method != "constrained":
        return lights, None
    from uplift.lights.mixtures import mixtures_of
    from uplift.pixels import FALLBACK_LIGHTS

    known = [light.declared or light.type != "smooth" for light in lights.lights]
    mixtures = mixtures_of(
        [light.emission for light in lights.lights],
        [light.share for light in lights.lights],
        known,
        room=_MOST_EMISSIONS - len(lights.lights) - len(FALLBACK_LIGHTS),
    )
    if not mixtures.parts:
        return lights, None
    more = [
        _record(lights.lights[i], lights.lights[j], part, len(lights.lights) + number, emission, seen)
        for number, ((i, j, part), emission) in enumerate(zip(mixtures.parts, mixtures.emissions, strict=True))
    ]
    return lights.model_copy(update={"lights": [*lights.lights, *more]}), mixtures


def _record(
    one: LightRecord,
    other: LightRecord,
    part: float,
    label: int,
    emission: np.typing.NDArray[np.float64],
    seen: Observer,
) -> LightRecord:
    from uplift.illuminants import cct_duv_of

    cct, duv = (float(value) if np.isfinite(value) else None for value in cct_duv_of(emission, seen))
    return one.model_copy(
        update={
            "cluster": label,
            "type": "mixture",
            "cct": cct,
            "duv": duv,
            "source": f"{part:.0%} of the light of cluster {one.cluster}, {1 - part:.0%} of that of cluster {other.cluster}",
            "confidence": min(one.confidence, other.confidence),
            "emission": [float(value) for value in emission],
        }
    )
