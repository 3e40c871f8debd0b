"""A forward model of a camera's bracket: a smooth scene over many decades, seen with known faults."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from calibrate.exposure import FrameInfo

Counts = npt.NDArray[np.uint16]
Radiance = npt.NDArray[np.float64]
TIMES = tuple(Fraction(4**n, 256) for n in range(6))
BLACK, WHITE = 512.0, 16383.0


@dataclass
class Frame:
    info: FrameInfo
    counts: Counts
    decoded: int = 0

    def mosaic(self) -> Counts:
        self.decoded += 1
        return self.counts


def scene(shape: tuple[int, int], *, seed: int, low: float = -3.0, high: float = 2.2) -> Radiance:
    """Radiance between 10^low and 10^high: soft hills with texture, as it falls on a mosaic RGGB of a warm scene."""
    rng = np.random.default_rng(seed)
    coarse = rng.standard_normal((shape[0] // 16 + 2, shape[1] // 16 + 2))
    hills = cv2.resize(cv2.GaussianBlur(coarse, (0, 0), 2.5), shape[::-1], interpolation=cv2.INTER_CUBIC)
    hills = (hills - hills.min()) / (hills.max() - hills.min())
    texture = np.clip(1 + 0.4 * cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), 1.2), 0.3, 3)
    out = 10 ** (low + hills * (high - low)) * texture
    for k, share in enumerate((0.5, 1.0, 1.0, 0.7)):
        out[k // 2 :: 2, k % 2 :: 2] *= share
    return out


def photograph(
    radiance: Radiance,
    times: Sequence[Fraction] = TIMES,
    *,
    seed: int = 0,
    gain: float = 3.1,
    read_e: float = 4.0,
    factors: Sequence[float] | None = None,
    blacks: Sequence[float] = (0.0,) * 4,
    clips: Sequence[float] = (WHITE,) * 4,
    changed: dict[int, dict[str, Any]] | None = None,
) -> list[Frame]:
    """Expose a radiance in units of white − black as the file states them; what the file does not know is a fault.

    `factors` multiply the light of each frame, `blacks` are added to the file's black, at `clips` the samples clip.
    `changed` replaces what single frames say of themselves.
    """
    rng = np.random.default_rng(seed)
    frames = []
    for n, time in enumerate(times):
        light = float(time) * (1.0 if factors is None else factors[n])
        expected = np.clip(radiance * light, 0, 2) * (WHITE - BLACK) * gain
        counts = (rng.poisson(expected) + read_e * rng.standard_normal(radiance.shape)) / gain + BLACK
        for k in range(4):
            place = np.s_[k // 2 :: 2, k % 2 :: 2]
            counts[place] = np.minimum(counts[place] + blacks[k], clips[k])
        info = FrameInfo(
            f"{n}.dng", time, 100.0, 8.0, "Maker One", "", radiance.shape[1], radiance.shape[0], "RGGB",
            (BLACK,) * 4, (WHITE,) * 4, 14,
        )  # fmt: skip
        info = replace(info, **(changed or {}).get(n, {}))
        frames.append(Frame(info, np.clip(np.rint(counts), 0, 65535).astype(np.uint16)))
    return frames
