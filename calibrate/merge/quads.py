"""Means of 2×2 photosites, on which frames are compared: they hold all colours of a Bayer mosaic."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calibrate.merge.records import Counts, Exposure, Plane

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Quads:
    """Arrays of (⌈H/2⌉, ⌈W/2⌉); at an odd border, the last row or column is there twice.

    Attributes
    ----------
    mean
        float32, radiance; where samples clip, of the counts as they are, so a lower bound.
    clipped
        uint8: samples of the four that clip.
    scale
        Raw counts, of all four together, of one unit of radiance.
    """

    mean: Plane
    clipped: npt.NDArray[np.uint8]
    scale: float


def quads_of(mosaic: Counts, exposure: Exposure) -> Quads:
    """Return the means of a Bayer or monochrome mosaic, (H, W) raw counts."""
    height, width = mosaic.shape
    if height % 2 or width % 2:
        mosaic = np.pad(mosaic, ((0, height % 2), (0, width % 2)), mode="edge")
    total = np.zeros((mosaic.shape[0] // 2, mosaic.shape[1] // 2), np.float32)
    clipped = np.zeros(total.shape, np.uint8)
    scale = 0.0
    for k in range(4):
        p = k % len(exposure.clip)
        part = mosaic[k // 2 :: 2, k % 2 :: 2]
        total += part.astype(np.float32) - np.float32(exposure.black[p])
        clipped += part >= exposure.clip[p]
        scale += float(exposure.light[p] * exposure.span[p])
    total /= np.float32(scale)
    return Quads(total, clipped, scale)
