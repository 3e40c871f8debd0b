"""The boxes of a chart's places (6 × 4 of a Classic) on a grown lattice, each by the homography through the points it holds."""

from typing import Final

import numpy as np
import numpy.typing as npt

from calibrate.chart.geometry import CLASSIC, PITCH, Layout
from calibrate.chart.homographies import agreed_homographies
from calibrate.chart.lattice import LEAST_POINTS, Places, Points

# At a slant a diagonal of the grid may be shorter than a step, and is taken for one: so the places are sheared, too.
_SHEARS: Final = tuple(
    np.array(matrix)
    for matrix in ([[1, 0], [0, 1]], [[1, 1], [0, 1]], [[1, -1], [0, 1]], [[1, 0], [1, 1]], [[1, 0], [-1, 1]])
)
# Windows with so many points fewer than the fullest one are looked at, too.
_FEWER: Final = 2


def windows(places: Places, points: Points, layout: Layout = CLASSIC) -> Points:
    """Return the boxes [K, 4, 2] of every window that holds nearly as many of `points` [N, 2] as the fullest one.

    `places` [N, 2] are those of the points on the lattice. Which corner is which is not known: a box may be turned by half a
    turn, or mirrored.
    """
    counted, at_corners = [], _corners(layout)
    for shear in _SHEARS:
        sheared = places @ shear
        counted += [(*window, shear, sheared) for window in _counted(sheared, layout)]
    fullest = max((window[0] for window in counted), default=0)
    inside, corners = [], []
    for count, corner, size, shear, sheared in counted:
        local = sheared - corner
        within = ((local >= 0) & (local < size)).all(axis=1)
        if count < max(LEAST_POINTS, fullest - _FEWER) or np.ptp(local[within], axis=0).min() < 1:
            continue
        inside.append(within)
        # Back to the places as they were grown.
        corners.append((at_corners[size] + corner) @ np.linalg.inv(shear))
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


def _corners(layout: Layout) -> dict[tuple[int, int], Points]:
    """The box's corners [4, 2] in steps from the first patch's middle, for an upright window and for one on its side."""
    first = layout.gap_width + layout.patch_width / 2
    low, (long, short) = -first / PITCH, ((side - first) / PITCH for side in layout.box)
    return {
        (layout.columns, layout.rows): np.array([[low, low], [long, low], [long, short], [low, short]]),
        (layout.rows, layout.columns): np.array([[low, low], [low, long], [short, long], [short, low]]),
    }


def _counted(places: Places, layout: Layout) -> list[tuple[int, npt.NDArray[np.int64], tuple[int, int]]]:
    """Return count, corner and size of every window over `places` [N, 2] that may hold enough of them."""
    low, high = places.min(axis=0), places.max(axis=0)
    # A border of zeros as wide as a window: windows may reach beyond the places.
    grid = np.zeros(high - low + 1 + 2 * layout.columns, dtype=np.int64)
    grid[tuple((places - low + layout.columns).T)] = 1
    total = np.pad(grid.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    found = []
    for wide, tall in ((layout.columns, layout.rows), (layout.rows, layout.columns)):
        counts = total[wide:, tall:] - total[:-wide, tall:] - total[wide:, :-tall] + total[:-wide, :-tall]
        enough = np.argwhere(counts >= max(LEAST_POINTS, counts.max() - _FEWER))
        found += [(int(counts[tuple(at)]), at + low - layout.columns, (wide, tall)) for at in enough]
    return found
