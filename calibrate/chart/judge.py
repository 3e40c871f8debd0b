"""Is this the chart, and which way up? A 3×3 fit of what a camera saw of 24 places against the published colours.

A real chart fits under any light and camera; 24 places of anything else do not. On 78 photographs of charts and their
rooms, accepting a mean CIEDE2000 up to 16.5 let no place without a chart pass, and lost no chart. The colours also
give the sense of rotation: the order that fits best names the corners, and if these then run anticlockwise, the
picture is mirrored.
"""

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate.chart.geometry import COLUMNS, ROWS, image_from_chart, patch_quads, project
from calibrate.chart.reference import ChartReference
from calibrate.correct import least_squares
from calibrate.difference import delta_e_2000, lab_from_xyz

LARGEST_SCORE: Final = 16.5
# Patches that are clipped in every exposure say nothing; with this many of them a fit of nine numbers says little.
_MOST_LOST_PATCHES: Final = 6
_SAMPLES_PER_SIDE: Final = 7

_GRID = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
# For each order of reading the patches: their indices, and the indices of the corners that go with it.
_ORDERS: Final = (
    (_GRID.ravel(), (0, 1, 2, 3)),
    (_GRID[::-1, ::-1].ravel(), (2, 3, 0, 1)),
    (_GRID[:, ::-1].ravel(), (1, 0, 3, 2)),
    (_GRID[::-1].ravel(), (3, 2, 1, 0)),
)


def glance(image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the median of a few bilinear samples in each patch [24, 3]: NaN where most are NaN or outside."""
    samples = _samples(image, corners, 0.5)
    values = np.full((len(samples), 3), np.nan)
    for value, patch in zip(values, samples, strict=True):
        seen = patch[np.isfinite(patch).all(axis=1)]
        if len(seen) > len(patch) // 2:
            value[:] = np.median(seen, axis=0)
    return values


def unevenness(image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64]) -> float:
    """Return how much the inner 80 % of a patch (by width) scatters, as the mean relative spread over the patches.

    A box that is off takes in the dark gaps, and scatters more.
    """
    levels = _samples(image, corners, 0.8).sum(axis=2)
    spreads = []
    for patch in levels:
        seen = patch[np.isfinite(patch)]
        if len(seen) > len(patch) // 2 and np.median(seen) > 0:
            # Between two percentiles: hot and dead pixels are none of the box's fault.
            spreads.append(np.subtract(*np.percentile(seen, (90, 10))) / np.median(seen))
    return float(np.mean(spreads)) if spreads else float("inf")


def _samples(image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64], part: float) -> npt.NDArray[np.float32]:
    """A grid of bilinear samples [24, N, 3] in the central `part` of each patch; NaN outside the image."""
    grid = (np.arange(_SAMPLES_PER_SIDE) + 0.5) / _SAMPLES_PER_SIDE
    s, t = np.meshgrid(grid, grid)
    quads = patch_quads(part)
    inside = quads[:, 0, None, :] + np.stack([s.ravel(), t.ravel()], -1) * (quads[:, 2] - quads[:, 0])[:, None, :]
    points = project(image_from_chart(corners), inside).astype(np.float32)
    samples = cv2.remap(
        image,
        np.ascontiguousarray(points[..., 0]),
        np.ascontiguousarray(points[..., 1]),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(np.nan, np.nan, np.nan, np.nan),
    )
    return np.asarray(samples, dtype=np.float32)


def best_order(patches: npt.NDArray[np.float64], reference: ChartReference) -> tuple[float, tuple[int, int, int, int]]:
    """Return the best mean CIEDE2000 over the four orders of reading `patches` [24, 3], and its order of corners.

    The score is infinite if too many patches are NaN.
    """
    best = (float("inf"), (0, 1, 2, 3))
    for indices, corner_order in _ORDERS:
        camera = patches[indices]
        seen = np.isfinite(camera).all(axis=1)
        if (~seen).sum() > _MOST_LOST_PATCHES:
            continue
        xyz = reference.XYZ[seen]
        matrix = least_squares(camera[seen], xyz, xyz[:, 1] ** (-4 / 3), np.zeros(len(xyz), dtype=np.bool_))
        differences = delta_e_2000(lab_from_xyz(camera[seen] @ matrix.T), lab_from_xyz(xyz))
        if differences.mean() < best[0]:
            best = (float(differences.mean()), corner_order)
    return best
