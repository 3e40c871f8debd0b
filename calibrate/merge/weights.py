"""Inverse-variance weights, a run of photosites at a time.

The samples of one colour in one row are taken out of all frames in runs that stay in the processor's cache. Over each run
there are two passes: a first estimate of the radiance from all frames, then the weights that follow from it. Sums of the
first are float64, as the guard against clipping takes differences of them; the rest is float32, like the result.

Arrays with one entry a position of the pattern are indexed by row % period × columns of the period + column % period.
"""

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from calibrate.merge.records import Counts, Float64, Plane

# A clipped sample cannot tell how far it would have gone; what it and the others together say is then at least the
# clipping level less this many σ of the part of the others. See `_weigh_near_clipping`.
_CLIP_GUARD_SIGMA = np.float32(2.0)

# Radiances below this share of clipping are never near it, whatever the noise.
_FAR_FROM_CLIPPING = np.float32(0.5)

_RUN = 512

# Stands for a sample that is left out: above every level that can clip.
_LEFT_OUT = np.float32(131072.0)

# The frames' shares in the result are measured on one row of so many, of each row of the pattern.
_SHARE_ROWS = 8

Skips = npt.NDArray[np.uint8]
Tally = npt.NDArray[np.int64]


@njit(cache=True, parallel=True, error_model="numpy")
def weigh(
    raw: Counts,
    skips: Skips,
    first_row: int,
    columns: int,
    black: Float64,
    clip: Float64,
    span: Float64,
    light: Float64,
    electrons: Float64,
    read: Float64,
    mosaic: Plane,
    weights: Plane,
    clipped: Tally,
    used: Tally,
    shares: Float64,
) -> None:  # pragma: no cover - compiled
    """Write the radiance and its inverse variance of some rows of a bracket; NaN and 0 where every frame clips.

    `raw` (N, rows, W) goes from the shortest to the longest exposure and starts at row `first_row` of the mosaic, `skips`
    (N, ⌈rows/2⌉, ⌈W/2⌉) is 0 where a sample counts, or empty. Levels are (N, P); `electrons` those of one unit, `read` the
    variance of the read noise in units². `clipped`, `used` and `shares` are (rows, N): samples, samples, and sums of the
    frames' parts in the result.
    """
    frames, height, width = raw.shape
    period = black.shape[1] // columns
    some = skips.shape[0] > 0
    for y in prange(height):
        samples, radiance = np.empty(_RUN, np.float32), np.empty(_RUN, np.float32)
        first, squares = np.empty(_RUN), np.empty(_RUN)
        above, below = np.empty(_RUN, np.float32), np.empty(_RUN, np.float32)
        until = np.empty((frames, _RUN), np.float32)
        shared = (first_row + y) // period % _SHARE_ROWS == 0
        for column in range(columns):
            p = (first_row + y) % period * columns + column
            for start in range(column, width, _RUN * columns):
                n = min(_RUN, (width - start + columns - 1) // columns)
                first[:n], squares[:n], above[:n], below[:n] = 0.0, 0.0, 0.0, 0.0
                for k in range(frames - 1, -1, -1):
                    _take(raw[k, y, start::columns], samples[:n])
                    clipped[y, k] += _count_from(samples[:n], np.float32(clip[k, p]))
                    if some:
                        _leave_out(skips[k, y >> 1], start, columns, samples[:n])
                    _gather(samples[:n], clip[k, p], black[k, p], span[k, p], light[k, p], first, squares)
                brightest = _estimate(first[:n], squares, radiance)
                for k in range(frames):
                    _take(raw[k, y, start::columns], samples[:n])
                    if some:
                        _leave_out(skips[k, y >> 1], start, columns, samples[:n])
                    top = (clip[k, p] - black[k, p]) / span[k, p]
                    shot, dark = np.float32(light[k, p] / electrons[k, p]), np.float32(read[k, p])
                    if brightest > _FAR_FROM_CLIPPING * top / light[k, p]:
                        used[y, k] += _weigh_near_clipping(
                            samples[:n], clip[k, p], black[k, p], span[k, p], light[k, p], shot, dark,
                            radiance, first, squares, above, below,
                        )  # fmt: skip
                    else:
                        used[y, k] += _weigh_far_from_clipping(
                            samples[:n], np.float32(clip[k, p]), np.float32(black[k, p]), np.float32(1.0 / span[k, p]),
                            np.float32(light[k, p]), shot, dark, radiance, above, below,
                        )  # fmt: skip
                    if shared:
                        until[k, :n] = below[:n]
                for i in range(n):
                    x = start + i * columns
                    mosaic[y, x] = above[i] / below[i] if below[i] > 0 else np.float32(np.nan)
                    weights[y, x] = below[i]
                if shared:
                    _share(until, below[:n], shares[y])


@njit(cache=True, error_model="numpy")
def _take(row: npt.NDArray[np.uint16], samples: Plane) -> None:  # pragma: no cover - compiled
    for i in range(len(samples)):
        samples[i] = row[i]


@njit(cache=True, error_model="numpy")
def _leave_out(
    skips: npt.NDArray[np.uint8], start: int, step: int, samples: Plane
) -> None:  # pragma: no cover - compiled
    for i in range(len(samples)):
        if skips[(start + i * step) >> 1] != 0:
            samples[i] = _LEFT_OUT


@njit(cache=True, error_model="numpy")
def _count_from(samples: Plane, level: float) -> np.int32:  # pragma: no cover - compiled
    count = np.int32(0)
    for i in range(len(samples)):
        count += np.int32(samples[i] >= level)
    return count


@njit(cache=True, error_model="numpy")
def _gather(
    samples: Plane, clip: float, black: float, span: float, light: float, first: Float64, squares: Float64
) -> None:  # pragma: no cover - compiled
    """Pass 1: add light × sample and light² of the samples that are not clipped."""
    unit, square = light / span, light * light
    for i in range(len(samples)):
        value = np.float64(samples[i])
        first[i] += unit * (value - black) if value < clip else 0.0
        squares[i] += square if value < clip else 0.0


@njit(cache=True, error_model="numpy")
def _estimate(first: Float64, squares: Float64, radiance: Plane) -> np.float32:  # pragma: no cover - compiled
    for i in range(len(first)):
        radiance[i] = max(first[i] / squares[i], 0.0) if squares[i] > 0 else 0.0
    # Bits of numbers that are not negative are in the order of the numbers, and a maximum of integers is vectorised.
    brightest = np.int32(0)
    for i in range(len(first)):
        brightest = max(brightest, np.float32(radiance[i]).view(np.int32))
    return np.int32(brightest).view(np.float32)


@njit(cache=True, error_model="numpy")
def _weigh_far_from_clipping(
    samples: Plane, clip: float, black: float, unit: float, light: float, shot: float, dark: float,
    radiance: Plane, above: Plane, below: Plane,
) -> np.int32:  # fmt: skip  # pragma: no cover - compiled
    """Pass 2 where no sample of the run is near clipping."""
    count = np.int32(0)
    for i in range(len(samples)):
        taken = samples[i] < clip
        certainty = light / (radiance[i] * shot + dark) if taken else np.float32(0)
        above[i] += certainty * ((samples[i] - black) * unit)
        below[i] += certainty * light
        count += np.int32(taken)
    return count


@njit(cache=True, error_model="numpy")
def _weigh_near_clipping(
    samples: Plane, clip: float, black: float, span: float, light: float, shot: float, dark: float,
    radiance: Plane, first: Float64, squares: Float64, above: Plane, below: Plane,
) -> np.int32:  # fmt: skip  # pragma: no cover - compiled
    """Pass 2: add the samples by inverse variance; frames come from the shortest to the longest.

    Whether a sample s near the clipping level is used must not depend on s − r, r being what the other frames expect of
    it: the mean of the result would move by the correlation. Their inverse-variance mean does not correlate with s − r, so
    it decides. It cannot be formed where s is clipped; with s at the clipping level it spreads by
    own·√borrowed/(own + borrowed) around it, so the threshold stands 2 σ of that lower: nearly all that would belong to
    clipped samples is left out. The shortest usable sample has no weight before it, and is always taken.
    """
    unit, square = 1.0 / span, light * light
    top, t = np.float32((clip - black) * unit), np.float32(light)
    near = _FAR_FROM_CLIPPING * top / t
    count = np.int32(0)
    for i in range(len(samples)):
        value = np.float64(samples[i])
        exact = (value - black) * unit
        sample = np.float32(exact)
        own = radiance[i] * shot + dark
        others = np.float32(squares[i] - square)
        rest = np.float32(first[i] - light * exact) / others * t
        # The longest of the others makes up nearly all of their sum of squares.
        ratio = t * t / others
        borrowed = np.sqrt(ratio) * radiance[i] * shot + ratio * dark
        most = borrowed * sample + own * rest + _CLIP_GUARD_SIGMA * own * np.sqrt(borrowed)
        lucky = (radiance[i] > near) & (below[i] > 0) & (most >= top * (own + borrowed))
        taken = (value < clip) & (not lucky)
        certainty = t / own if taken else np.float32(0)
        above[i] += certainty * sample
        below[i] += certainty * t
        count += np.int32(taken)
    return count


@njit(cache=True, error_model="numpy")
def _share(until: Plane, below: Plane, shares: Float64) -> None:  # pragma: no cover - compiled
    for k in range(len(until)):
        for i in range(len(below)):
            if below[i] > 0:
                added = until[k, i] - (until[k - 1, i] if k > 0 else np.float32(0))
                shares[k] += added / below[i]
