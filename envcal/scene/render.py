"""Render the scene with Mitsuba under one lighting after the other, in passes.

Passes bound the memory, show progress and tell the noise: the difference of the means of even and odd passes. A small lamp
seen by way of the mirror ball makes fireflies, so a pass that is more than four times as bright in a pixel as the median
pass is counted as four times the median: caustics end up a little dark, in both lightings alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from envcal.errors import EnvcalError
from envcal.reporter import Progress, silent

Image = npt.NDArray[np.float32]

#: Samples that a pass may hold at once; each needs some hundred bytes.
_LANES = 1 << 22
#: A pixel of a pass counts for at most this many times the median of the passes.
_FIREFLY = 4.0
_LEAST_PASSES = 8
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
#: What the scalar variant, some two hundred times slower, is asked for unless the size is given.
SCALAR_SIZE, SCALAR_SPP = (192, 108), 8


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """A lighting's picture: `image` [height, width, 3] of linear sRGB, and the means of even and of odd passes.

    `background` [height, width] is where nothing but the map is seen; None if that is not known.
    """

    image: Image
    even: Image
    odd: Image
    background: npt.NDArray[np.bool_] | None = None


def mitsuba() -> ModuleType:
    """Return Mitsuba with the emitter registered; an `EnvcalError` that says what to install if it cannot be had."""
    import importlib

    importlib.import_module("envcal.mitsuba")
    return importlib.import_module("mitsuba")


def set_variant(asked: str) -> tuple[str, str | None]:
    """Set a Mitsuba variant; "auto" is the spectral LLVM one, or the scalar one with a warning, which is returned."""
    mitsuba()
    from envcal.mitsuba import set_variant as choose

    if asked != "auto":
        choose(asked)
        return asked, None
    try:
        choose("llvm_ad_spectral")
    except EnvcalError as error:
        choose("scalar_spectral")
        return (
            "scalar_spectral",
            f"rendered slowly and small with scalar_spectral, for there is no usable LLVM: {error}",
        )
    return "llvm_ad_spectral", None


def render(
    scene_file: Path,
    parameters: Mapping[str, Any],
    *,
    size: tuple[int, int],
    spp: int,
    tame: bool = True,
    progress: Progress = silent,
) -> Rendered:
    """Render `scene_file` (width, height = `size`) in the variant that is set, `spp` samples a pixel in all.

    `tame` takes the fireflies down; without it the mean is unbiased.
    """
    import gc

    mi = mitsuba()
    width, height = size
    try:
        scene = mi.load_file(str(scene_file), width=str(width), height=str(height), **parameters)
    except (RuntimeError, ValueError, OSError) as error:
        raise EnvcalError(f"{scene_file}: Mitsuba cannot load it: {str(error).strip()}") from error
    passes = max(_LEAST_PASSES, -(-width * height * spp // _LANES))
    passes += passes % 2
    each = _even_count(-(-spp // passes))
    passes = max(_LEAST_PASSES, 2 * round(spp / each / 2))
    layers = np.empty((passes, height, width, 3), np.float32)
    for k in range(passes):
        layers[k] = np.asarray(mi.render(scene, spp=each, seed=k))
        progress(k + 1, passes)
    depth = mi.load_dict({"type": "aov", "aovs": "depth:depth"})
    background = np.asarray(mi.render(scene, integrator=depth, spp=16))[..., 0] <= 0
    del scene
    gc.collect()
    tamed = without_fireflies(layers) if tame else layers
    return Rendered(tamed.mean(axis=0), tamed[::2].mean(axis=0), tamed[1::2].mean(axis=0), background)


def _even_count(samples: int) -> int:
    """The least k·k or k·(k + 1) that is not below `samples`: what Mitsuba's multijitter sampler takes as it is."""
    k = max(1, math.isqrt(samples))
    return next(count for count in (k * k, k * (k + 1), (k + 1) ** 2) if count >= samples)


def without_fireflies(passes: Image) -> Image:
    """Return passes [n, height, width, 3] in which no pixel is brighter than four times its median over the passes."""
    bright = passes @ _LUMINANCE.astype(np.float32)
    limit = _FIREFLY * np.median(bright, axis=0)
    factor = np.where((bright > limit) & (limit > 0), limit / np.maximum(bright, 1e-30), 1.0)
    return np.asarray(passes * factor[..., np.newaxis], np.float32)


def progress_of(progress: Progress, part: int, parts: int) -> Callable[[int, int], None]:
    """A progress for one of several equal parts of the work."""

    def move(done: int, total: int) -> None:
        progress(part * total + done, parts * total)

    return move
