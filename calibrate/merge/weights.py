"""The two passes over the frames: a first estimate of the radiance, then inverse-variance weights from it.

Arrays with one entry a position of the pattern are indexed by row % period × columns of the period + column % period.
"""

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from calibrate.merge.records import Counts, Float64, Plane

# A clipped sample cannot tell how far it would have gone; what it and the others together say is then at least the
# clipping level less this many σ of the part of the others. See `weigh`.
_CLIP_GUARD_SIGMA = 2.0

# Radiances below this share of clipping are never near it, whatever the noise.
_FAR_FROM_CLIPPING = 0.5


@njit(cache=True, parallel=True, error_model="numpy")
def gather(
    raw: Counts,
    columns: int,
    black: Float64,
    clip: Float64,
    span: Float64,
    light: Float64,
    skip: npt.NDArray[np.uint8],
    first: Plane,
    squares: Plane,
    clipped: npt.NDArray[np.int64],
) -> None:  # pragma: no cover - compiled
    """Pass 1: add light × sample and light² of the samples that are not clipped; `skip` is 0 where a sample counts."""
    height, width = raw.shape
    period = len(black) // columns
    some = skip.shape[0] > 0
    for y in prange(height):
        # Position by position, so that its constants stay in registers.
        for column in range(columns):
            p = (y % period) * columns + column
            top, low, t, unit = clip[p], black[p], light[p], light[p] / span[p]
            count = 0
            for x in range(column, width, columns):
                value = np.float64(raw[y, x])
                if value >= top:
                    count += 1
                elif not some or skip[y >> 1, x >> 1] == 0:
                    first[y, x] += unit * (value - low)
                    squares[y, x] += t * t
            clipped[y] += count


@njit(cache=True, parallel=True, error_model="numpy")
def weigh(
    raw: Counts,
    columns: int,
    black: Float64,
    clip: Float64,
    span: Float64,
    light: Float64,
    electrons: Float64,
    read: Float64,
    skip: npt.NDArray[np.uint8],
    first: Plane,
    squares: Plane,
    weighted: Plane,
    weights: Plane,
    used: npt.NDArray[np.int64],
) -> None:  # pragma: no cover - compiled
    """Pass 2: add the samples by inverse variance; frames come from the shortest to the longest.

    `electrons` is those of one unit, `read` the variance of the read noise in units².

    Whether a sample s near the clipping level is used must not depend on s − r, r being what the other frames expect of
    it: the mean of the result would move by the correlation. Their inverse-variance mean does not correlate with s − r, so
    it decides. It cannot be formed where s is clipped; with s at the clipping level it spreads by
    own·√borrowed/(own + borrowed) around it, so the threshold stands 2 σ of that lower: nearly all that would belong to
    clipped samples is left out.
    """
    height, width = raw.shape
    period = len(black) // columns
    some = skip.shape[0] > 0
    for y in prange(height):
        for column in range(columns):
            p = (y % period) * columns + column
            t, full, low, unit, shot, dark = (
                light[p],
                clip[p],
                black[p],
                1.0 / span[p],
                light[p] / electrons[p],
                read[p],
            )
            top = (full - low) * unit
            near = _FAR_FROM_CLIPPING * top / t
            count = 0
            for x in range(column, width, columns):
                value = np.float64(raw[y, x])
                if value >= full or (some and skip[y >> 1, x >> 1] != 0):
                    continue
                sample = (value - low) * unit
                radiance = max(first[y, x] / np.float64(squares[y, x]), 0.0)
                own = radiance * shot + dark
                # The shortest usable sample has no weight before it, and is always taken. Far below clipping the roots
                # can be spared.
                if radiance > near and weights[y, x] > 0:
                    rest_square = squares[y, x] - t * t
                    rest = (first[y, x] - t * sample) / rest_square * t
                    # The longest of the others makes up nearly all of their sum of squares.
                    ratio = t / np.sqrt(rest_square)
                    borrowed = ratio * radiance * shot + ratio * ratio * dark
                    both = (borrowed * sample + own * rest) / (own + borrowed)
                    if both + _CLIP_GUARD_SIGMA * own * np.sqrt(borrowed) / (own + borrowed) >= top:
                        continue
                certainty = t / own
                weighted[y, x] += certainty * sample
                weights[y, x] += certainty * t
                count += 1
            used[y] += count
