"""Light that was clipped in every frame: how much of the sphere it covers, and what may be put in its place.

A colour is never invented silently: the fill is asked for, and what it did is told.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError

# The pixels around a lost region that lend their colour: those up to this far, without the first row, where demosaicing
# has mixed in what was lost.
_INNER, _OUTER = 1, 4


@dataclass(frozen=True, slots=True, eq=False)
class Filled:
    """An image (H, W, 3) without holes, and how many pixels were filled; `left` have no neighbour that is known."""

    image: npt.NDArray[np.float32]
    filled: int
    left: int


def lost_share(lost: npt.NDArray[np.bool_]) -> float:
    """Return the share of a mask, shape (H, W): of the sphere if it is twice as wide as high, else of the pixels."""
    height, width = lost.shape
    if width != 2 * height:
        return float(lost.mean())
    weight = np.sin(np.pi * (np.arange(height) + 0.5) / height)
    return float((lost.mean(axis=1) * weight).sum() / weight.sum())


def fill_lost(
    image: npt.NDArray[np.float32],
    fill: Literal["neighbour"] | tuple[float, float, float],
    *,
    ceiling: tuple[float, float, float],
) -> Filled:
    """Return the image with its lost pixels filled.

    `neighbour`: each connected region takes the median colour of the pixels around it, so bright that no channel that
    was lost lies below what it has at least (the clipping level of the shortest frame), and that channels that were not
    lost are met where there are any. This is the smallest light that explains the clipping, so a lower bound: the true
    sun may be thousands of times brighter. A colour (r, g, b): every lost pixel takes it.

    Parameters
    ----------
    image
        Shape (H, W, 3), camera RGB, NaN where lost.
    ceiling
        Radiance that a lost sample of each colour has at least.
    """
    missing = np.isnan(image)
    lost: npt.NDArray[np.bool_] = missing[..., 0] | missing[..., 1] | missing[..., 2]
    count = int(lost.sum())
    out = image.copy()
    if not isinstance(fill, str):
        if not all(np.isfinite(v) and v >= 0 for v in fill):
            raise CalibrateError(
                f"merge.lost: the colour {fill}; three finite numbers from 0 on are expected. Give camera RGB per second."
            )
        out[lost] = np.asarray(fill, np.float32)
        return Filled(out, count, 0)
    if not count:
        return Filled(out, 0, 0)
    reach = 2 * _OUTER + 1
    joined = cv2.dilate(lost.astype(np.uint8), np.ones((3, 3), np.uint8))
    regions, labels, boxes, _ = cv2.connectedComponentsWithStats(joined, connectivity=8)
    left = 0
    for k in range(1, regions):
        x, y, w, h, _ = boxes[k]
        window = np.s_[max(y - reach, 0) : y + h + reach, max(x - reach, 0) : x + w + reach]
        mine = np.logical_and(lost[window], labels[window] == k)
        near = cv2.dilate(mine.astype(np.uint8), np.ones((2 * _INNER + 1,) * 2, np.uint8)) > 0
        around = cv2.dilate(mine.astype(np.uint8), np.ones((2 * _OUTER + 1,) * 2, np.uint8)) > 0
        known_here = np.logical_not(lost[window])
        ring = around & ~near & known_here
        pixels = image[window][ring if ring.any() else around & known_here]
        pixels = pixels[(pixels > 0).all(axis=1)]
        if not len(pixels):
            left += int(mine.sum())
            continue
        colour = np.median(pixels / pixels.max(axis=1, keepdims=True), axis=0)
        values = image[window][mine]
        hole = missing[window][mine]
        least = np.where(hole, np.asarray(ceiling) / colour, 0.0).max(axis=1)
        with np.errstate(invalid="ignore"):
            kept = np.where(hole, np.nan, values / colour)
        known = np.where(hole.all(axis=1), 0.0, np.nan_to_num(kept, nan=0.0).max(axis=1))
        filled = np.maximum(least, known)[:, None] * colour
        view = out[window]
        view[mine] = np.where(hole, filled, values)
    return Filled(out, count - left, left)
