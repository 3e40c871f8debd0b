"""Charts that no single light explains: how often the reason that `measure_light` names is the one that was put in.

`python -m benchmarks spectrometer --only refusals`. Four lamps, two cameras, sensitivities given or not.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.spectrometer.lamps import EYES, Float64
from benchmarks.spectrometer.readings import read
from uplift.spectrometer import Reading, anchored, measure_light
from uplift.spectrum import illuminant

LAMPS = ("LED-B3", "FL2", "A", "D50")
NM = EYES.wavelengths_nm
VEIL = 0.05  # of the white patch
SHARES = (0.3, 0.7)  # of the second light, at the sides of the chart
NARROW_NM, SHIFT_NM = 15.0, 20.0
_NOT_THIS_CHART = "none of the usual reasons"
_CAMERA = ("are those of another camera", "sensitivities are unlike those")  # where they were given, and not
#: Case → what the text must say.
TOLD: dict[str, str | tuple[str, str]] = {
    "veil": "a veil of light",
    "second light": "the colour of the light changes across the chart",
    "narrow camera": _CAMERA,
    "shifted camera": _CAMERA,
    "upside down": _NOT_THIS_CHART,
    "two patches exchanged": _NOT_THIS_CHART,
}


def named(curves: Float64, cameras: list[int]) -> dict[str, list[int]]:
    """Case → how often it was named rightly, of how many."""
    out = {case: [0, 0] for case in TOLD}
    for camera in cameras:
        for seed, name in enumerate(LAMPS):
            for case, reading in _cases(name, curves[camera], seed):
                for given in (True, False):
                    found = measure_light(reading, camera=curves[camera] if given else None, observer=EYES)
                    told = TOLD[case]
                    out[case][0] += (told if isinstance(told, str) else told[0 if given else 1]) in found.refused
                    out[case][1] += 1
    return out


def _cases(name: str, curves: Float64, seed: int) -> Iterator[tuple[str, Reading]]:
    light = illuminant(name, EYES)
    one = read(light, curves, seed)
    other = read(illuminant("A" if name == "D50" else "LED-B5", EYES), curves, seed)
    share = SHARES[0] + (SHARES[1] - SHARES[0]) * (np.arange(24) % 6)[:, np.newaxis] / 5
    yield "veil", Reading(one.values + VEIL * one.values[18], one.noise)
    yield "second light", Reading((1 - share) * one.values + share * other.values, one.noise)
    narrow = curves * np.exp(-0.5 * ((NM[:, np.newaxis] - [600.0, 540.0, 450.0]) / NARROW_NM) ** 2)
    yield "narrow camera", read(light, anchored(narrow, EYES), seed)
    shifted = np.stack([np.interp(NM - SHIFT_NM, NM, curve) for curve in curves.T], axis=-1)
    yield "shifted camera", read(light, anchored(shifted, EYES), seed)
    yield "upside down", Reading(one.values[::-1].copy(), one.noise)
    exchanged = np.arange(24)
    exchanged[[5, 11]] = 11, 5
    yield "two patches exchanged", Reading(one.values[exchanged], one.noise[exchanged])
