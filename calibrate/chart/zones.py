"""Flat zones of a picture: what a chart's patches are, whatever the light, the camera and the exposure.

A patch is a small region of one colour that an edge surrounds. So the logarithm of the picture (in which light and
exposure only shift the levels) is cut where it changes faster than a threshold, and what is left between the cuts falls
into connected zones. Those that are filled like a parallelogram may be patches. Several thresholds serve edges
of different strength and different noise. Only sums over labels are needed, no contours.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

# Largest change of the logarithm within 3×3 pixels, in any channel, that still counts as flat.
_THRESHOLDS: Final = (0.06, 0.12, 0.22, 0.4, 0.7)
# Noise of the floor that is added before the logarithm is taken: this part of the level around.
_FLOOR: Final = 0.04
_LEAST_PIXELS: Final = 9
# Area over the area of the parallelogram of the same second moments: 1 for a parallelogram, 0.955 for an ellipse, much
# less for an angle, a ring or the network of the gaps.
_FILL: Final = (0.78, 1.12)
_LONGEST_ASPECT: Final = 6.0


@dataclass(frozen=True, slots=True)
class Zones:
    """Zones of one threshold: `centres` [N, 2] (x, y), and `areas` [N], in pixels of the picture they were found in."""

    centres: npt.NDArray[np.float64]
    areas: npt.NDArray[np.float64]


def relative_logarithm(image: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return log(image + floor) [H, W, 3], the floor being a small part of the mean level around; lost pixels are bright.

    Multiplying a channel shifts the result and changes nothing else.
    """
    finite = np.isfinite(image)
    whole = bool(finite.all())
    clean = np.maximum(image, np.float32(0))
    if not whole:
        for channel in range(3):  # along the last, short axis numpy is slow
            seen = clean[..., channel][finite[..., channel]]
            clean[..., channel][~finite[..., channel]] = seen.max(initial=0)
    # Single lost or dark pixels would cut a zone in two; a gap of one pixel must stay.
    bad = cv2.min(cv2.min(*cv2.split(image)[:2]), image[..., 2]) <= 0
    if not whole:
        bad |= ~(finite[..., 0] & finite[..., 1] & finite[..., 2])
    if bad.any():
        clean[bad] = cv2.medianBlur(clean, 3)[bad]
    side = max(3, min(image.shape[:2]) // 12)
    # The mean of square roots: a lamp in the neighbourhood must not drown what is beside it.
    level = cv2.blur(cv2.sqrt(clean), (side, side)) ** 2
    # Every fourth pixel: the level is the mean of many, and only its order of magnitude counts.
    smallest = np.maximum(1e-4 * np.median(level[::4, ::4].reshape(-1, 3), axis=0), 1e-30).astype(np.float32)
    level *= np.float32(_FLOOR)
    level += clean
    level += smallest
    return np.asarray(np.log(level, out=level), dtype=np.float32)


def flat_zones(logarithm: npt.NDArray[np.float32], *, smallest: float, largest: float) -> list[Zones]:
    """Return the zones of each threshold whose area is between `smallest` and `largest` pixels, shaped like patches."""
    smooth = cv2.GaussianBlur(logarithm, (0, 0), 0.7)
    cross = np.ones((3, 3), np.uint8)
    red, green, blue = cv2.split(cv2.subtract(cv2.dilate(smooth, cross), cv2.erode(smooth, cross)))
    change = np.asarray(cv2.max(cv2.max(red, green), blue), dtype=np.float32)
    return [_zones(change < threshold, smallest, largest) for threshold in _THRESHOLDS]


def _zones(flat: npt.NDArray[np.bool_], smallest: float, largest: float) -> Zones:
    count, labels, stats, centres = cv2.connectedComponentsWithStats(
        flat.view(np.uint8), connectivity=4, ltype=cv2.CV_32S
    )
    areas = stats[:, cv2.CC_STAT_AREA].astype(np.float64)
    boxes = stats[:, cv2.CC_STAT_WIDTH].astype(np.float64) * stats[:, cv2.CC_STAT_HEIGHT]
    fits = (areas >= max(smallest, _LEAST_PIXELS)) & (areas <= largest) & (areas > 0.25 * boxes)
    fits[0] = False
    chosen = np.flatnonzero(fits)
    if chosen.size == 0:
        return Zones(np.zeros((0, 2)), np.zeros(0))
    rank = np.full(count, -1, dtype=np.int32)
    rank[chosen] = np.arange(chosen.size)
    # A pixel is a square, not a point: its own variance of 1/12 counts.
    moments = _central_moments(labels, rank, centres[chosen]) / areas[chosen, None] + np.array([1 / 12, 1 / 12, 0.0])
    xx, yy, xy = moments.T
    determinant = np.maximum(xx * yy - xy**2, 1e-12)
    filled = areas[chosen] / (12 * np.sqrt(determinant))
    half, root = (xx + yy) / 2, np.sqrt(np.maximum(((xx + yy) / 2) ** 2 - determinant, 0))
    aspect = np.sqrt((half + root) / np.maximum(half - root, 1e-12))
    good = (filled > _FILL[0]) & (filled < _FILL[1]) & (aspect < _LONGEST_ASPECT)
    return Zones(centres[chosen][good].astype(np.float64), areas[chosen][good])


@njit(cache=True, error_model="numpy")
def _central_moments(
    labels: npt.NDArray[np.int32], rank: npt.NDArray[np.int32], centres: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:  # pragma: no cover - compiled
    """Sums of dx², dy², dx dy [M, 3] over the pixels of each label of a rank from 0 to M − 1."""
    sums = np.zeros((len(centres), 3))
    for y in range(labels.shape[0]):
        for x in range(labels.shape[1]):
            own = rank[labels[y, x]]
            if own >= 0:
                dx, dy = x - centres[own, 0], y - centres[own, 1]
                sums[own, 0] += dx * dx
                sums[own, 1] += dy * dy
                sums[own, 2] += dx * dy
    return sums
