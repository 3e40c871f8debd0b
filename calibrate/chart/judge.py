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


def glance(
    image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64], part: float = 0.5
) -> npt.NDArray[np.float64]:
    """Return the median of a few bilinear samples in each patch [24, 3]: NaN where most are NaN or outside."""
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
    seen = np.isfinite(samples).all(axis=2)
    values = np.full((len(quads), 3), np.nan)
    for index in np.flatnonzero(seen.mean(axis=1) > 0.5):
        values[index] = np.median(samples[index, seen[index]], axis=0)
    return values


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
