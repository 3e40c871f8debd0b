"""Drawing a chart's box to the dark gaps between its patches.

Across each gap (38 of a Classic) the picture is read along a line and compared with what a gap may look like there: two levels, a
dark stripe between them, all blurred, on a slope. Where that fits best is the middle of the gap. Slopes take up what glare and
a fall-off of the light add, so unlike the patches' levels or the outlines of their zones the middles stay where they are. The
homography that takes the grid to the middles, gaps that disagree left out, corrects the box to a few hundredths of a patch.
"""

import functools
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from calibrate.chart.geometry import CLASSIC, PITCH, Layout, box_corners, image_from_chart, project
from calibrate.chart.judge import bilinear

Floats = npt.NDArray[np.float64]

# All lengths are in chart units. How far to each side of a gap the picture is read: to a bit more than half of the patch.
_REACH: Final = 1.5
_STEPS: Final = 31
# Where the middle may be, and what the gap may look like: widths of the editions, and the blur's sigma.
_CENTRES: Final = np.linspace(-0.9, 0.9, 25)
# Between a bright and a dark patch a wrong guess of either moves the middle, by the width's error: hence the fine steps.
_WIDTHS: Final = (0.25, 0.31, 0.37, 0.43, 0.49, 0.55, 0.62)
_SIGMAS: Final = (0.05, 0.09, 0.13, 0.17, 0.21, 0.26, 0.32, 0.38, 0.45)
# Lines are read side by side along the middle of each gap, so much of its length, and averaged.
_ALONG: Final = np.linspace(-0.9, 0.9, 11)
_ROUNDS: Final = 4
# At first every third width will do.
_COARSELY: Final = 3
# What a middle is off by when nothing is wrong, and what a middle farther from the grid than three times that counts for.
_SPREAD: Final = 0.03
_ROBUST_ROUNDS: Final = 6
# This part of the gaps of either direction must agree, so well; in the mean a miss counts no more than that.
_FEWEST: Final = 0.44
_AGREED: Final = 0.12
# Half a patch is farther than a detector errs; a box that moved that far has slipped to a neighbour.
_FARTHEST: Final = 1.25


def between_gaps(
    image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64], layout: Layout = CLASSIC
) -> npt.NDArray[np.float64] | None:
    """Return the corners [4, 2] for which the grid lies on the gaps of the picture; None if too few gaps agree."""
    box, at = corners, box_corners(layout)
    for turn in range(_ROUNDS):
        homography = image_from_chart(box, layout)
        # A wrong width moves the middles to and fro, by which side is darker. So the right one is that with which they agree.
        tried = [_moved(*middles, layout) for middles in _middles(image, homography, layout, 1 if turn else _COARSELY)]
        agreeing = [moved for moved in tried if moved is not None]
        if not agreeing:
            return None
        change, used, missed = min(agreeing, key=lambda moved: moved[2])
        corrected = project(homography @ change, at)
        if not np.isfinite(corrected).all():
            return None
        shift = np.abs(
            project(np.asarray(np.linalg.inv(image_from_chart(corners, layout)), dtype=np.float64), corrected) - at
        ).max()
        if not shift < _FARTHEST:
            return None
        box = corrected
        if np.abs(project(change, at) - at).max() < 0.01:
            break
    vertical = np.arange(len(used)) < len(_places(layout)[0])
    enough = used[vertical].mean() >= _FEWEST and used[~vertical].mean() >= _FEWEST
    return box if enough and missed < _AGREED else None


@functools.cache
def _places(layout: Layout) -> tuple[Floats, Floats]:
    """Chart coordinates of the middles of the upright gaps and of the level ones: [20, 2] and [18, 2] of a Classic."""
    first = layout.gap_width + layout.patch_width / 2
    columns, rows = first + PITCH * np.arange(layout.columns), first + PITCH * np.arange(layout.rows)
    upright = [(x + PITCH / 2, y) for x in columns[:-1] for y in rows]
    level = [(x, y + PITCH / 2) for x in columns for y in rows[:-1]]
    return np.array(upright), np.array(level)


@functools.cache
def _shapes() -> tuple[Floats, Floats]:
    """What a gap may look like: orthonormal bases [W, F, C, 4, S], and what gives the two levels from them [W, F, C, 2, 4].

    W widths, F sigmas, C middles, S steps across. Each basis spans a constant, a slope and the two edges.
    """
    x = np.linspace(-_REACH, _REACH, _STEPS)
    bases, levels = [], []
    for width in _WIDTHS:
        for sigma in _SIGMAS:
            for centre in _CENTRES:
                edges = ndtr((centre - width / 2 - x) / sigma), ndtr((x - centre - width / 2) / sigma)
                basis, triangle = np.linalg.qr(np.stack([np.ones_like(x), x, *edges], axis=1))
                bases.append(basis.T)
                levels.append(np.linalg.inv(triangle)[2:])
    shape = (len(_WIDTHS), len(_SIGMAS), len(_CENTRES))
    return np.reshape(bases, (*shape, 4, _STEPS)), np.reshape(levels, (*shape, 2, 4))


def _middles(
    image: npt.NDArray[np.float32], homography: Floats, layout: Layout, every: int
) -> list[tuple[Floats, Floats]]:
    """Return for `every` so-many-th width how far each gap's middle is from where the homography has it [G], and standard errors [G]."""
    across = np.linspace(-_REACH, _REACH, _STEPS)
    bases, levels = _shapes()
    by_axis = []
    for axis, places in enumerate(_places(layout)):
        offsets = np.zeros((_STEPS, len(_ALONG), 2))
        offsets[..., axis], offsets[..., 1 - axis] = across[:, None], _ALONG
        points = project(homography, places[:, None, None] + offsets).astype(np.float32)
        samples = bilinear(image, points.reshape(-1, len(_ALONG), 2)).reshape(*points.shape[:3], 3)
        seen = np.isfinite(samples).all(axis=3)
        values = np.where(seen, samples.sum(axis=3, dtype=np.float64), np.nan)
        # The median along the gap: single pixels do not matter.
        known = seen.sum(axis=2) > len(_ALONG) // 3
        lines = np.zeros(known.shape)
        lines[known] = np.nanmedian(values[known], axis=1)
        lines /= np.maximum(np.abs(lines).mean(axis=1, keepdims=True), 1e-30)
        lines -= lines.mean(axis=1, keepdims=True)
        fitted = [_fitted(lines, *shape) for shape in zip(bases[::every], levels[::every], strict=True)]
        whole = known.all(axis=1)
        by_axis.append([(middle, np.where(whole, error, np.inf)) for middle, error in fitted])
    pairs = zip(*by_axis, strict=True)
    return [tuple(np.concatenate(each) for each in zip(*pair, strict=True)) for pair in pairs]  # type: ignore[misc]


def _fitted(lines: Floats, bases: Floats, levels: Floats) -> tuple[Floats, Floats]:
    """Return the middle and its standard error of lines [G, S] of the mean 0 across gaps, of one width and sigma."""
    # One small product a sigma: a large one would go to several threads, and wait for them.
    parts = (bases.reshape(len(bases), -1, _STEPS) @ lines.T).reshape(*bases.shape[:3], len(lines))
    depth = (levels @ parts).min(axis=2)
    energy = (lines**2).sum(axis=1)
    # What is left; a stripe brighter than a side is no gap.
    left = np.where(depth > 0, np.maximum(energy - (parts**2).sum(axis=2), 0), np.inf)
    least = np.minimum(left.min(axis=1), energy)
    # The likeliest sigma, if each line has a noise of its own.
    kind = int(np.log(least + 1e-6 * energy + 1e-300).sum(axis=1).argmin())
    best = left[kind].argmin(axis=0)
    gaps = np.arange(len(lines))
    inner = np.clip(best, 1, len(_CENTRES) - 2)
    low, middle, high = (left[kind, inner + step, gaps] for step in (-1, 0, 1))
    with np.errstate(invalid="ignore"):
        curvature = low - 2 * middle + high
        shift = np.where(np.isfinite(curvature) & (curvature > 0), 0.5 * (low - high) / curvature, 0.0)
    spacing = _CENTRES[1] - _CENTRES[0]
    offset = _CENTRES[inner] + spacing * np.clip(shift, -1, 1)
    noise = np.sqrt(middle / (_STEPS - 5))
    deep = depth[kind, inner, gaps]
    # The two edges of a gap move the line by its depth over a few steps.
    with np.errstate(invalid="ignore", divide="ignore"):
        error = 0.5 * noise / np.maximum(deep, 1e-9)
    trusted = np.isfinite(middle) & (best > 0) & (best < len(_CENTRES) - 1) & (deep > 0)
    return offset, np.where(trusted, error, np.inf)


def _moved(middles: Floats, errors: Floats, layout: Layout) -> tuple[Floats, npt.NDArray[np.bool_], float] | None:
    """Return the homography in the chart that takes the grid to the middles, which of them agree, and by how much they miss.

    With G = 1 + [[a, b, c], [d, e, f], [g, h, 0]], a gap upright at x with its middle at x + m is met where
    (1 + a) x + b y + c = (x + m)(1 + g x + h y): linear in a … h, and likewise for level gaps.
    """
    width, height = layout.box
    size = width / 2
    to_unit = np.array([[1 / size, 0, -1], [0, 1 / size, -height / width], [0, 0, 1]])
    upright, level = (project(to_unit, places) for places in _places(layout))
    m = middles / size
    zero, one = np.zeros, np.ones
    (x, y), n, at = upright.T, len(upright), upright[:, 0] + m[: len(upright)]
    rows = [np.column_stack([x, y, one(n), zero((n, 3)), -at * x, -at * y])]
    (x, y), n, at = level.T, len(level), level[:, 1] + m[len(upright) :]
    rows.append(np.column_stack([zero((n, 3)), x, y, one(n), -at * x, -at * y]))
    matrix = np.concatenate(rows)
    usable = np.isfinite(errors)
    if usable.mean() < _FEWEST:
        return None
    spread = np.hypot(_SPREAD, np.where(usable, errors, 1.0)) / size
    weight = usable / spread
    # Start from the median: half of the gaps may be none.
    solution: Floats = np.zeros(8)
    for turn in range(_ROBUST_ROUNDS):
        rest = m - matrix @ solution
        if turn:
            scale = np.maximum(3 * spread, 3 * np.median(np.abs(rest[usable])))
            weight = np.where(usable, np.maximum(1 - (rest / scale) ** 2, 0) / spread, 0.0)
        solution = np.asarray(np.linalg.lstsq(matrix * weight[:, None], m * weight, rcond=None)[0], dtype=np.float64)
    rest = np.abs(m - matrix @ solution) * size
    used = weight * spread > 0.1
    if used.mean() < _FEWEST:
        return None
    change = np.eye(3) + np.append(solution, 0.0).reshape(3, 3)
    weight = 1 / spread[usable]
    # Root of the mean square, a miss of a quarter of a gap counting no more than that.
    missed = float(np.sqrt((weight**2 * np.minimum(rest[usable], _AGREED) ** 2).sum() / (weight**2).sum()))
    return np.asarray(np.linalg.inv(to_unit) @ change @ to_unit), used, missed
