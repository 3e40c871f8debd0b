"""Is this the chart, and which way up? A 3×3 fit of what a camera saw of its places against the published colours.

A real chart fits under any light and camera; as many places of anything else do not. The fit allows for a fall-off of the
light across the chart, and is repeated without the patches that fit worst (glare, dirt). The colours also give the sense
of rotation: the order that fits best names the corners, and if these then run anticlockwise, the picture is mirrored.
"""

import functools
from collections.abc import Callable
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate.chart.geometry import CLASSIC, Layout, image_from_chart, patch_quads, project
from calibrate.chart.reference import ChartReference
from calibrate.difference import delta_e_2000, lab_from_xyz

Through = Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]]

LARGEST_SCORE: Final = 16.5
# Patches that are clipped in every exposure say nothing; with this part of them a fit of nine numbers says little.
_MOST_LOST: Final = 0.25
_SAMPLES_PER_SIDE: Final = 7
_COARSE_SAMPLES_PER_SIDE: Final = 3
# Rounds of fit and fall-off; the third changes the score by less than a tenth.
_ROUNDS: Final = 3
# One patch in so many the last round leaves out of fit and score.
_LEFT_OUT: Final = 12

# Neighbours of published colours so far apart (CIEDE2000) that read the same in all channels, but for this part of themselves and
# of the brightest patch, are no patches.
_DIFFERENT: Final = 5.0
_ALIKE, _ALIKE_DARK = 0.06, 0.005

Order = tuple[int, int, int, int]


@functools.cache
def _orders(layout: Layout) -> tuple[tuple[npt.NDArray[np.intp], Order], ...]:
    """For each order of reading the patches: their indices, and the indices of the corners that go with it."""
    grid = np.arange(layout.count).reshape(layout.rows, layout.columns)
    return (
        (grid.ravel(), (0, 1, 2, 3)),
        (grid[::-1, ::-1].ravel(), (2, 3, 0, 1)),
        (grid[:, ::-1].ravel(), (1, 0, 3, 2)),
        (grid[::-1].ravel(), (3, 2, 1, 0)),
    )


def glance(
    image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64], layout: Layout = CLASSIC
) -> npt.NDArray[np.float64]:
    """Return the median of a few bilinear samples in each patch [N, 3]: NaN where most are NaN or outside."""
    return _medians(_samples(image, corners, 0.5, layout))


def glances(
    image: npt.NDArray[np.float32],
    boxes: npt.NDArray[np.float64],
    layout: Layout = CLASSIC,
    *,
    through: Through | None = None,
) -> npt.NDArray[np.float64]:
    """Return what `glance` returns for K boxes [K, 4, 2], more coarsely: [K, N, 3].

    `through` maps the boxes' points [..., 2] to the image's pixels, where they are not the same.
    """
    grid = (np.arange(_COARSE_SAMPLES_PER_SIDE) + 0.5) / _COARSE_SAMPLES_PER_SIDE
    inside = _places_in_patches(grid, 0.5, layout)
    points = np.stack([project(image_from_chart(box, layout), inside) for box in boxes])
    if through is not None:
        points = through(points)
    # One row a patch; a remapped picture has at most 32767 rows.
    flat = points.reshape(-1, len(grid) ** 2, 2).astype(np.float32)
    parts = [bilinear(image, flat[row : row + 30000]) for row in range(0, len(flat), 30000)]
    samples = np.concatenate(parts).reshape(*points.shape[:3], 3)
    return _medians(samples)


def unevenness(image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64], layout: Layout = CLASSIC) -> float:
    """Return how much the inner 80 % of a patch (by width) scatters, as the mean relative spread over the patches.

    A box that is off takes in the dark gaps, and scatters more.
    """
    levels = np.sort(_samples(image, corners, 0.8, layout).sum(axis=2), axis=1)  # NaN comes last
    seen = np.isfinite(levels).sum(axis=1)
    rows = np.arange(len(levels))
    # Between two percentiles: hot and dead pixels are none of the box's fault.
    low, middle, high = (levels[rows, np.round(part * np.maximum(seen - 1, 0)).astype(int)] for part in (0.1, 0.5, 0.9))
    counted = (seen > levels.shape[1] // 2) & (middle > 0)
    return float(((high - low)[counted] / middle[counted]).mean()) if counted.any() else float("inf")


def _samples(
    image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64], part: float, layout: Layout
) -> npt.NDArray[np.float32]:
    """A grid of bilinear samples [N, M, 3] in the central `part` of each patch; NaN outside the image."""
    grid = (np.arange(_SAMPLES_PER_SIDE) + 0.5) / _SAMPLES_PER_SIDE
    places = _places_in_patches(grid, part, layout)
    return bilinear(image, project(image_from_chart(corners, layout), places).astype(np.float32))


def _places_in_patches(grid: npt.NDArray[np.float64], part: float, layout: Layout) -> npt.NDArray[np.float64]:
    """Chart coordinates [N, M², 2] of a grid [M] (0…1 from side to side) in the central `part` of each patch."""
    s, t = np.meshgrid(grid, grid)
    quads = patch_quads(part, layout)
    return np.asarray(quads[:, 0, None] + np.stack([s.ravel(), t.ravel()], -1) * (quads[:, 2] - quads[:, 0])[:, None])


def bilinear(image: npt.NDArray[np.float32], points: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Bilinear samples of an image [H, W, 3] at points [M, N, 2], NaN outside."""
    samples = cv2.remap(
        image,
        np.ascontiguousarray(points[..., 0]),
        np.ascontiguousarray(points[..., 1]),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(np.nan, np.nan, np.nan, np.nan),
    )
    return np.asarray(samples, dtype=np.float32)


def _medians(samples: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
    """Medians [..., 3] of samples [..., N, 3] that have all channels; NaN where half of them or more have not."""
    whole = np.asarray(np.isfinite(samples).all(axis=-1))
    ordered = np.sort(np.where(whole[..., None], samples, np.float32(np.nan)), axis=-2)  # NaN comes last
    count = whole.sum(axis=-1)
    low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, samples.shape[-2] - 1)
    pick = [np.take_along_axis(ordered, at[..., None, None], axis=-2)[..., 0, :] for at in (low, high)]
    values = 0.5 * (pick[0].astype(np.float64) + pick[1])
    values[count <= samples.shape[-2] // 2] = np.nan
    return np.asarray(values, dtype=np.float64)


def best_order(patches: npt.NDArray[np.float64], reference: ChartReference) -> tuple[float, Order]:
    """Return the best score over the four orders of reading `patches` [N, 3], and its order of corners.

    The score is the mean CIEDE2000 of the patches without the worst (a twelfth); infinite if too many patches are NaN.
    """
    return best_orders(patches[None], reference)[0]


def best_orders(patches: npt.NDArray[np.float64], reference: ChartReference) -> list[tuple[float, Order]]:
    """Return for each of K sets of patches [K, N, 3] what `best_order` returns for one."""
    ways = _orders(reference.layout)
    scores = np.full((len(patches), len(ways)), np.inf)
    enough = (~np.isfinite(patches).all(axis=2)).mean(axis=1) <= _MOST_LOST
    if enough.any():
        orders = np.stack([patches[enough][:, indices] for indices, _ in ways], axis=1)
        scores[enough] = _differences(orders.reshape(-1, *patches.shape[1:]), reference)[1].reshape(-1, len(ways))
    best = scores.argmin(axis=1)
    return [(float(row[k]), ways[k][1]) for row, k in zip(scores, best, strict=True)]


def covered(patches: npt.NDArray[np.float64], reference: ChartReference) -> int:
    """Return the size of the largest group of neighbouring patches [N, 3] that read the same though their colours differ.

    A hand or a sheet over a corner of the chart makes one. Of a chart in full view, of any camera under any lamp, two neighbours
    may look alike, rarely three (measured over 2 cameras, 11 lamps and falls-off up to e: 2 in 5 % of the charts, never 3).
    """
    layout = reference.layout
    grid = np.arange(layout.count).reshape(layout.rows, layout.columns)
    beside = [(grid[:, :-1], grid[:, 1:]), (grid[:-1], grid[1:])]
    first, second = (np.concatenate([pair[k].ravel() for pair in beside]) for k in (0, 1))
    lab = lab_from_xyz(reference.XYZ)
    differ = delta_e_2000(lab[first], lab[second]) > _DIFFERENT
    one, other = patches[first], patches[second]
    brightest = np.max(patches, axis=0, where=np.isfinite(patches), initial=0.0)
    with np.errstate(invalid="ignore"):
        alike = np.abs(one - other) < _ALIKE * np.maximum(one, other) + _ALIKE_DARK * brightest
    same = alike.all(axis=1) & differ
    group = np.arange(layout.count)
    for _ in range(layout.count):
        lowest = group.copy()
        np.minimum.at(lowest, first[same], group[second[same]])
        np.minimum.at(lowest, second[same], group[first[same]])
        if (lowest == group).all():
            break
        group = lowest
    return int(np.bincount(group).max())


def _differences(
    patches: npt.NDArray[np.float64], reference: ChartReference
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return CIEDE2000 [K, N] of K sets of patches [K, N, 3] after a fit each, and the scores [K]."""
    xyz, places = reference.XYZ, reference.layout.places
    count = len(places)
    most_left_out = count // _LEFT_OUT
    seen = np.asarray(np.isfinite(patches).all(axis=2))
    camera = np.where(seen[..., None], patches, 0.0)
    camera = camera / np.maximum(camera.mean(axis=(1, 2), keepdims=True), 1e-300)
    # As CIELAB counts errors: its cube root has the slope Y^(−2/3).
    weight = seen * xyz[:, 1] ** (-4 / 3)
    lab = lab_from_xyz(xyz)
    light = np.zeros((len(patches), count))
    terms = np.column_stack([np.ones(count), places])
    differences = np.zeros((len(patches), count))
    for turn in range(_ROUNDS):
        even = camera * np.exp(-light)[..., None]
        fitted = even @ _solved(even, xyz, weight)
        differences = np.where(seen, delta_e_2000(lab_from_xyz(fitted), lab), np.nan)
        if turn == _ROUNDS - 1:
            break
        # What is left of the luminance is a plane's fall-off in the logarithm, as far as it is one.
        ratio = np.log(np.clip(fitted[..., 1], 1e-3 * xyz[:, 1], 1e3 * xyz[:, 1]) / xyz[:, 1])
        # Glare makes a patch brighter, never darker: what stands out most is left out from the second round on.
        rank = np.argsort(np.argsort(np.where(seen, -differences, 0.0), axis=1), axis=1)
        kept = seen & (rank >= most_left_out)
        root = np.sqrt(xyz[:, 1]) * kept
        normal = np.einsum("kn,na,nb->kab", root**2, terms, terms) + 1e-9 * np.eye(3)
        plane = np.linalg.solve(normal, np.einsum("kn,na,kn->ka", root**2, terms, ratio)[..., None])[..., 0]
        light = np.clip(light + plane[:, 1:] @ places.T, -1.2, 1.2)
        weight = kept * xyz[:, 1] ** (-4 / 3)
    ordered = np.sort(np.where(seen, differences, np.inf), axis=1)
    ordered = np.where(np.isfinite(ordered), ordered, 0.0)[:, : count - most_left_out]
    counted = np.minimum(seen.sum(axis=1), count - most_left_out)
    return differences, ordered.sum(axis=1) / np.maximum(counted, 1)


def _solved(
    even: npt.NDArray[np.float64], xyz: npt.NDArray[np.float64], weight: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """The matrices [K, 3, 3] for which even @ matrix is nearest to xyz under the weights."""
    normal = np.einsum("kni,kn,knj->kij", even, weight, even)
    trace = np.trace(normal, axis1=1, axis2=2)[:, None, None]
    right = np.einsum("kni,kn,nj->kij", even, weight, xyz)
    return np.asarray(np.linalg.solve(normal + 1e-9 * trace * np.eye(3) + 1e-300 * np.eye(3), right))
