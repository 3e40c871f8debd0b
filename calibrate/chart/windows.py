"""The boxes of 6 × 4 places on a grown lattice, each by the homography through the points it holds."""

from typing import Final

import numpy as np
import numpy.typing as npt

from calibrate.chart.geometry import BOX_HEIGHT, BOX_WIDTH, COLUMNS, GAP_WIDTH, PATCH_WIDTH, ROWS
from calibrate.chart.homographies import agreed_homographies
from calibrate.chart.lattice import LEAST_POINTS, Places, Points

# At a slant a diagonal of the grid may be shorter than a step, and is taken for one: so the places are sheared, too.
_SHEARS: Final = tuple(
    np.array(matrix)
    for matrix in ([[1, 0], [0, 1]], [[1, 1], [0, 1]], [[1, -1], [0, 1]], [[1, 0], [1, 1]], [[1, 0], [-1, 1]])
)
# Windows with so many points fewer than the fullest one are looked at, too.
_FEWER: Final = 2
_PITCH: Final = PATCH_WIDTH + GAP_WIDTH
_FIRST: Final = GAP_WIDTH + PATCH_WIDTH / 2
# The box's corners in steps from the first patch's middle, for a window of 6 × 4 places and for one of 4 × 6.
_LOW: Final = -_FIRST / _PITCH
_LONG, _SHORT = (BOX_WIDTH - _FIRST) / _PITCH, (BOX_HEIGHT - _FIRST) / _PITCH
_CORNERS: Final = {
    (COLUMNS, ROWS): np.array([[_LOW, _LOW], [_LONG, _LOW], [_LONG, _SHORT], [_LOW, _SHORT]]),
    (ROWS, COLUMNS): np.array([[_LOW, _LOW], [_LOW, _LONG], [_SHORT, _LONG], [_SHORT, _LOW]]),
}


def windows(places: Places, points: Points) -> Points:
    """Return the boxes [K, 4, 2] of every window that holds nearly as many of `points` [N, 2] as the fullest one.

    `places` [N, 2] are those of the points on the lattice. Which corner is which is not known: a box may be turned by half a
    turn, or mirrored.
    """
    counted = []
    for shear in _SHEARS:
        sheared = places @ shear
        counted += [(*window, shear, sheared) for window in _counted(sheared)]
    fullest = max((window[0] for window in counted), default=0)
    inside, corners = [], []
    for count, corner, size, shear, sheared in counted:
        local = sheared - corner
        within = ((local >= 0) & (local < size)).all(axis=1)
        if count < max(LEAST_POINTS, fullest - _FEWER) or np.ptp(local[within], axis=0).min() < 1:
            continue
        inside.append(within)
        # Back to the places as they were grown.
        corners.append((_CORNERS[size] + corner) @ np.linalg.inv(shear))
    if not inside:
        return np.zeros((0, 4, 2))
    homographies = agreed_homographies(places.astype(np.float64), points, np.stack(inside))
    at = np.stack(corners)
    mapped = np.concatenate([at, np.ones((*at.shape[:2], 1))], axis=2) @ np.swapaxes(homographies, 1, 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        boxes = mapped[..., :2] / mapped[..., 2:]
    # A horizon between the corners shows the box inside out.
    one_side = (np.sign(mapped[..., 2]) == np.sign(mapped[:, :1, 2])).all(axis=1)
    return np.asarray(boxes[one_side & np.isfinite(boxes).all(axis=(1, 2))])


def _counted(places: Places) -> list[tuple[int, npt.NDArray[np.int64], tuple[int, int]]]:
    """Return count, corner and size of every window over `places` [N, 2] that may hold enough of them."""
    low, high = places.min(axis=0), places.max(axis=0)
    # A border of zeros as wide as a window: windows may reach beyond the places.
    grid = np.zeros(high - low + 1 + 2 * COLUMNS, dtype=np.int64)
    grid[tuple((places - low + COLUMNS).T)] = 1
    total = np.pad(grid.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    found = []
    for wide, tall in ((COLUMNS, ROWS), (ROWS, COLUMNS)):
        counts = total[wide:, tall:] - total[:-wide, tall:] - total[wide:, :-tall] + total[:-wide, :-tall]
        enough = np.argwhere(counts >= max(LEAST_POINTS, counts.max() - _FEWER))
        found += [(int(counts[tuple(at)]), at + low - COLUMNS, (wide, tall)) for at in enough]
    return found
