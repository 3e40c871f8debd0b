"""Cameras that nobody measured, ordinary and odd: how often their light is refused, and what it is worth where it is not.

`python -m benchmarks spectrometer --only odd-cameras`. The ordinary ones are those of the set, each read with a model of cameras that
has not seen it. Odd ones are made of every so-many-th of them by a change that no camera of the set has. One room is relit; what is
refused counts 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import rooms as relit
from benchmarks.spectrometer.lamps import EYES, Float64, Tested
from benchmarks.spectrometer.readings import model_without, prior_without, read
from benchmarks.spectrometer.relight import SPACE
from uplift.spectrometer import anchored, measure_light

NM = EYES.wavelengths_nm
FIRST, EVERY = 2, 16


def _shifted(by_nm: float) -> Callable[[Float64], Float64]:
    return lambda curves: np.stack([np.interp(NM - by_nm, NM, curve, left=0.0, right=0.0) for curve in curves.T], -1)


def _narrowed(to_nm: float) -> Callable[[Float64], Float64]:
    return lambda curves: curves * np.exp(-0.5 * ((NM[:, np.newaxis] - [600.0, 540.0, 450.0]) / to_nm) ** 2)


def _without_red_cut(curves: Float64) -> Float64:
    """The filter that ends the red at 620 nm and more taken out: what is there goes on and falls slowly."""
    goes_on = 1.3 * curves[np.searchsorted(NM, 620.0)] * np.exp(-(NM[:, np.newaxis] - 620.0) / 120.0)
    return np.where(NM[:, np.newaxis] > 620.0, np.maximum(curves, goes_on), curves)


CHANGES: dict[str, Callable[[Float64], Float64]] = {
    "ordinary": lambda curves: curves,
    **{f"moved by {by:+.0f} nm": _shifted(by) for by in (-20.0, -10.0, -5.0, 5.0, 10.0, 20.0)},
    "narrowed to 40 nm": _narrowed(40.0),
    "narrowed to 25 nm": _narrowed(25.0),
    "without the red cut": _without_red_cut,
    "violet cut at 430 nm": lambda curves: curves / (1.0 + np.exp(-(NM[:, np.newaxis] - 430.0) / 4.0)),
    "8 % of grey in each channel": lambda curves: curves + 0.08 * curves.max(axis=0),
}


def odd_cameras(folder: Path, every: Sequence[Tested], curves: Float64) -> dict[str, Any]:
    """Change → readings, refused ones (by camera), and the relight errors over those of the scaled uplift."""
    context = {"observer": EYES, "space": SPACE}
    room, surfaces = relit.rooms(folder, EYES)[0], relit.atlas(folder, EYES)
    models = [model_without(curves, camera) for camera in range(len(curves))]
    out: dict[str, Any] = {change: {"ratios": [], "refused": {}} for change in CHANGES}
    for number, lamp in enumerate(every):
        source = relit.Lamp(lamp.family, lamp.name, lamp.emission, 0.0, 0.0, in_library=False)
        scene = relit.lit(room, dict.fromkeys(range(3), (source, 1.0)), count=100, **context)  # type: ignore[arg-type]
        labels = np.zeros(scene.rgb.shape[:2], np.uint32)
        scaled = relit.scaled_error(scene, surfaces, **context)  # type: ignore[arg-type]
        for change, changed in CHANGES.items():
            for camera in range(len(curves)) if change == "ordinary" else range(FIRST, len(curves), EVERY):
                odd = anchored(changed(curves[camera]), EYES)
                reading = read(lamp.emission, odd, seed=9000 + 100 * number + camera)
                light = measure_light(reading, camera=models[camera], observer=EYES, prior=prior_without(lamp))
                ratio = 1.0
                if light.refused:
                    out[change]["refused"][camera] = out[change]["refused"].get(camera, 0) + 1
                else:
                    ratio = relit.error(scene, labels, [light.emission], surfaces, **context) / scaled  # type: ignore[arg-type]
                out[change]["ratios"].append(ratio)
    return out


def one_of_each(every: Sequence[Tested]) -> list[Tested]:
    """The middle lamp of each family, and two LEDs more."""
    out = []
    for family in dict.fromkeys(lamp.family for lamp in every):
        own = [lamp for lamp in every if lamp.family == family]
        out += own[len(own) // 5 :: max(1, len(own) // 3)][:3] if family == "led" else [own[len(own) // 2]]
    return out
