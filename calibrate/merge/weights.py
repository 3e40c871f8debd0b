"""Inverse-variance weights, a run of photosites at a time.

A run of photosites of one row is taken out of all frames and sorted by colour; what is computed of it stays in the
processor's cache. Over each colour of a run there are two passes: a first estimate of the radiance from all frames, then the
weights that follow from it. Frames that are clipped throughout a run, as long ones are in bright places, are passed over.

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

# Longer frames have more light than the one they are compared with; sums below this share of it are rounding.
_ROUNDING = np.float32(1e-4)

# Samples of one colour in a run.
_RUN = 512

# Stands for a sample that is left out: above every level that can clip.
_LEFT_OUT = np.float32(131072.0)

# The frames' shares in the result are measured on one row of so many, of each row of the pattern, and there on one sample of
# so many.
_SHARE_ROWS, _SHARE_SAMPLES = 8, 4

_ZERO, _ONE = np.float32(0), np.float32(1)

Skips = npt.NDArray[np.uint8]
Tally = npt.NDArray[np.int64]
Row = npt.NDArray[np.float32]


@njit(cache=True, parallel=True, error_model="numpy")
def weigh(
    raw: Counts,
    skips: Skips,
    first_row: int,
    columns: int,
    black: Plane,
    clip: Plane,
    unit: Plane,
    light: Plane,
    shot: Plane,
    dark: Plane,
    mosaic: Plane,
    weights: Plane,
    clipped: Tally,
    used: Tally,
    shares: Float64,
) -> None:  # pragma: no cover - compiled
    """Write the radiance and its inverse variance of some rows of a bracket; NaN and 0 where every frame clips.

    `raw` (N, rows, W) goes from the shortest to the longest exposure and starts at row `first_row` of the mosaic, `skips`
    (N, ⌈rows/2⌉, ⌈W/2⌉) is 0 where a sample counts, or empty. Levels are (N, P): black and clipping in counts, `unit` that of
    one count, `light`; the variance of a sample of radiance r is `shot` · r + `dark`, in units². `clipped`, `used` and `shares`
    are (rows, N): samples, samples, and sums of the frames' parts in the result.
    """
    frames, height, width = raw.shape
    period = black.shape[1] // columns
    for y in prange(height):
        samples = np.empty((columns, frames, _RUN), np.float32)
        radiance, first, squares = np.empty(_RUN, np.float32), np.empty(_RUN, np.float32), np.empty(_RUN, np.float32)
        means, sums = np.empty((columns, _RUN), np.float32), np.empty((columns, _RUN), np.float32)
        above = np.empty(_RUN, np.float32)
        shorter, its_squares = np.empty(_RUN, np.float32), np.empty(_RUN, np.float32)
        until = np.empty((frames, _RUN), np.float32)
        taken = np.empty(frames, np.int64)
        row = (first_row + y) % period * columns
        shared = (first_row + y) // period % _SHARE_ROWS == 0
        for start in range(0, width, _RUN * columns):
            for k in range(frames):
                _sort(raw[k, y, start : start + _RUN * columns], columns, samples[:, k])
            for column in range(columns):
                p, below = row + column, sums[column]
                n = (min(_RUN * columns, width - start) - column + columns - 1) // columns
                first[:n], squares[:n], above[:n], below[:n] = _ZERO, _ZERO, _ZERO, _ZERO
                shorter[:n], its_squares[:n] = _ZERO, _ZERO
                _gather_all(
                    samples[column], n, skips, y >> 1, start + column, columns, clip[:, p], black[:, p], unit[:, p],
                    light[:, p], first, squares, taken, clipped[y],
                )  # fmt: skip
                brightest = _estimate(first[:n], squares, radiance)
                gathered = 0
                for k in range(frames):
                    top = (clip[k, p] - black[k, p]) * unit[k, p]
                    if taken[k] > 0 and brightest > _FAR_FROM_CLIPPING * top / light[k, p]:
                        for j in range(gathered, k):
                            if taken[j] > 0:
                                _gather(
                                    samples[column, j, :n], clip[j, p], black[j, p], light[j, p] * unit[j, p],
                                    light[j, p] * light[j, p], shorter, its_squares,
                                )  # fmt: skip
                        gathered = k
                        used[y, k] += _weigh_near_clipping(
                            samples[column, k, :n], clip[k, p], black[k, p], unit[k, p], light[k, p], shot[k, p],
                            dark[k, p], radiance, first, squares, shorter, its_squares, above, below,
                        )  # fmt: skip
                    elif taken[k] > 0:
                        used[y, k] += taken[k]
                        _weigh_far_from_clipping(
                            samples[column, k, :n], clip[k, p], black[k, p], unit[k, p], light[k, p], shot[k, p],
                            dark[k, p], radiance, above, below,
                        )  # fmt: skip
                    if shared:
                        until[k, :n] = below[:n]
                _divide(above[:n], below, means[column])
                if shared:
                    _share(until, below[:n], shares[y])
            _join(means, mosaic[y, start : start + _RUN * columns])
            _join(sums, weights[y, start : start + _RUN * columns])


@njit(cache=True, error_model="numpy")
def _sort(row: npt.NDArray[np.uint16], columns: int, samples: Plane) -> None:  # pragma: no cover - compiled
    """Take the samples of a row apart by their column in the pattern."""
    if columns == 2:
        # Written out: a distance that the compiler knows is vectorised.
        even, odd = samples[0], samples[1]
        for i in range(len(row) // 2):
            even[i], odd[i] = row[2 * i], row[2 * i + 1]
        if len(row) % 2:
            even[len(row) // 2] = row[len(row) - 1]
    else:
        for column in range(columns):
            for i in range((len(row) - column + columns - 1) // columns):
                samples[column, i] = row[column + i * columns]


@njit(cache=True, error_model="numpy")
def _gather_all(
    samples: Plane, n: int, skips: Skips, skip_row: int, start: int, step: int, clip: Row, black: Row, unit: Row, light: Row,
    first: Row, squares: Row, taken: Tally, clipped: Tally,
) -> None:  # fmt: skip  # pragma: no cover - compiled
    """Pass 1: sum what is not clipped, from the longest frame to the shortest, and count it."""
    for k in range(len(samples) - 1, -1, -1):
        square = light[k] * light[k]
        if len(skips) == 0:
            taken[k] = _gather(samples[k, :n], clip[k], black[k], light[k] * unit[k], square, first, squares)
            clipped[k] += n - taken[k]
        else:
            clipped[k] += _count_from(samples[k, :n], clip[k])
            _leave_out(skips[k, skip_row], start, step, samples[k, :n])
            taken[k] = _gather(samples[k, :n], clip[k], black[k], light[k] * unit[k], square, first, squares)


@njit(cache=True, error_model="numpy")
def _leave_out(
    skips: npt.NDArray[np.uint8], start: int, step: int, samples: Row
) -> None:  # pragma: no cover - compiled
    for i in range(len(samples)):
        if skips[(start + i * step) >> 1] != 0:
            samples[i] = _LEFT_OUT


@njit(cache=True, error_model="numpy")
def _count_from(samples: Row, level: float) -> np.int32:  # pragma: no cover - compiled
    count = np.int32(0)
    for i in range(len(samples)):
        count = np.int32(count + np.int32(samples[i] >= level))
    return count


@njit(cache=True, error_model="numpy")
def _gather(
    samples: Row, clip: float, black: float, unit: float, square: float, first: Row, squares: Row
) -> np.int32:  # pragma: no cover - compiled
    """Add light × sample and light² of the samples that are not clipped; return how many these are."""
    count = np.int32(0)
    for i in range(len(samples)):
        taken = samples[i] < clip
        first[i] += unit * (samples[i] - black) if taken else _ZERO
        squares[i] += square if taken else _ZERO
        count = np.int32(count + np.int32(taken))
    return count


@njit(cache=True, error_model="numpy")
def _estimate(first: Row, squares: Row, radiance: Row) -> np.float32:  # pragma: no cover - compiled
    for i in range(len(first)):
        radiance[i] = max(first[i] / squares[i], _ZERO) if squares[i] > 0 else _ZERO
    # Bits of numbers that are not negative are in the order of the numbers, and a maximum of integers is vectorised.
    brightest = np.int32(0)
    for i in range(len(first)):
        brightest = max(brightest, np.float32(radiance[i]).view(np.int32))
    return np.int32(brightest).view(np.float32)


@njit(cache=True, error_model="numpy")
def _weigh_far_from_clipping(
    samples: Row, clip: float, black: float, unit: float, light: float, shot: float, dark: float,
    radiance: Row, above: Row, below: Row,
) -> None:  # fmt: skip  # pragma: no cover - compiled
    """Pass 2 where no sample of the run is near clipping."""
    for i in range(len(samples)):
        certainty = light / (radiance[i] * shot + dark) if samples[i] < clip else _ZERO
        above[i] += certainty * ((samples[i] - black) * unit)
        below[i] += certainty * light


@njit(cache=True, error_model="numpy")
def _weigh_near_clipping(
    samples: Row, clip: float, black: float, unit: float, t: float, shot: float, dark: float,
    radiance: Row, first: Row, squares: Row, shorter: Row, its_squares: Row, above: Row, below: Row,
) -> np.int32:  # fmt: skip  # pragma: no cover - compiled
    """Pass 2: add the samples by inverse variance; frames come from the shortest to the longest.

    Whether a sample s near the clipping level is used must not depend on s − r, r being what the other frames expect of
    it: the mean of the result would move by the correlation. Their inverse-variance mean does not correlate with s − r, so
    it decides. It cannot be formed where s is clipped; with s at the clipping level it spreads by
    own·√borrowed/(own + borrowed) around it, so the threshold stands 2 σ of that lower: nearly all that would belong to
    clipped samples is left out. The shortest usable sample has no weight before it, and is always taken.

    The sums of the other frames are those of the shorter ones, and what is left of all for longer ones: the small sums of
    much shorter frames would drown in the rounding of the whole.
    """
    top, square = (clip - black) * unit, t * t
    near = _FAR_FROM_CLIPPING * top / t
    count = np.int32(0)
    for i in range(len(samples)):
        sample = (samples[i] - black) * unit
        own = radiance[i] * shot + dark
        before, every = shorter[i], first[i]
        longer = squares[i] - its_squares[i] - square
        further = longer > _ROUNDING * square
        inverse = _ONE / (its_squares[i] + (longer if further else _ZERO))
        rest = (before + (every - before - t * sample if further else _ZERO)) * inverse * t
        # The longest of the others makes up nearly all of their sum of squares.
        ratio = square * inverse
        borrowed = np.sqrt(ratio) * radiance[i] * shot + ratio * dark
        # The expected level, borrowed · sample + own · rest over own + borrowed, is so far below clipping; and this is 2 σ:
        short, guard = top * (own + borrowed) - borrowed * sample - own * rest, _CLIP_GUARD_SIGMA * own
        expected = (short <= 0) | (short * short <= guard * guard * borrowed)
        lucky = (radiance[i] > near) & (below[i] > 0) & expected
        taken = (samples[i] < clip) & (not lucky)
        certainty = t / own if taken else _ZERO
        above[i] += certainty * sample
        below[i] += certainty * t
        count = np.int32(count + np.int32(taken))
    return count


@njit(cache=True, error_model="numpy")
def _divide(above: Row, below: Row, out: Row) -> None:  # pragma: no cover - compiled
    for i in range(len(above)):
        out[i] = above[i] / below[i] if below[i] > 0 else np.float32(np.nan)


@njit(cache=True, error_model="numpy")
def _join(samples: Plane, row: Row) -> None:  # pragma: no cover - compiled
    """Put the samples of a run back into their row; the inverse of `_sort`."""
    columns = len(samples)
    if columns == 2:
        even, odd = samples[0], samples[1]
        for i in range(len(row) // 2):
            row[2 * i], row[2 * i + 1] = even[i], odd[i]
        if len(row) % 2:
            row[len(row) - 1] = even[len(row) // 2]
    else:
        for column in range(columns):
            for i in range((len(row) - column + columns - 1) // columns):
                row[column + i * columns] = samples[column, i]


@njit(cache=True, error_model="numpy")
def _share(until: Plane, below: Row, shares: Float64) -> None:  # pragma: no cover - compiled
    for k in range(len(until)):
        for i in range(0, len(below), _SHARE_SAMPLES):
            if below[i] > 0:
                added = until[k, i] - (until[k - 1, i] if k > 0 else np.float32(0))
                shares[k] += added / below[i]
