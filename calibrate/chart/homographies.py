"""Homographies through the points of a grid, several at once and without those points that do not agree.

By the direct linear transform (R. Hartley and A. Zisserman, *Multiple View Geometry in Computer Vision*, 2004, algorithm
4.2) on normalised coordinates, solved again without the points that the solution before it misses.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]

_ROUNDS: Final = 3
# A point farther than so many median misses from where the homography has it is none of the grid; in steps at least this.
_ASTRAY_MEDIANS: Final = 3.0
_ASTRAY_STEPS: Final = 0.06
# Four points fix a homography, and agree with it whatever they are.
_FEWEST: Final = 6


def agreed_homographies(places: Points, points: Points, inside: npt.NDArray[np.bool_], *, step: float = 1.0) -> Points:
    """Return the homographies [K, 3, 3] from `places` [N, 2] to `points` [N, 2], each through those `inside` [K, N].

    `step` is the distance of neighbouring places.
    """
    shown_middle, shown_size = points.mean(axis=0), max(float(points.std()), 1e-12)
    middle, size = places.mean(axis=0), max(float(places.std()), 1e-12)
    at, seen = (places - middle) / size, (points - shown_middle) / shown_size
    lifted = np.column_stack([at, np.ones(len(at))])
    zero = np.zeros_like(lifted)
    rows = np.stack(
        [np.hstack([lifted, zero, -seen[:, :1] * lifted]), np.hstack([zero, lifted, -seen[:, 1:] * lifted])], axis=1
    )
    products = np.einsum("nri,nrj->nij", rows, rows).reshape(len(rows), 81)
    solved = _solved(inside.astype(np.float64) @ products)
    for _ in range(_ROUNDS - 1):
        mapped = lifted @ np.swapaxes(solved, 1, 2)
        with np.errstate(divide="ignore", invalid="ignore"):
            misses = np.hypot(*np.moveaxis(mapped[..., :2] / mapped[..., 2:] - seen, -1, 0))
        misses = np.where(inside & np.isfinite(misses), misses, np.inf)
        median = np.sort(misses, axis=1)[np.arange(len(misses)), (inside.sum(axis=1) - 1) // 2]
        # Normalised, a step of the points is about as long as one of the places.
        limit = np.maximum(np.where(np.isfinite(median), _ASTRAY_MEDIANS * median, 0.0), _ASTRAY_STEPS * step / size)
        agreeing = misses <= limit[:, None]
        # Too few agree: as it was.
        agreeing = np.where((agreeing.sum(axis=1) >= _FEWEST)[:, None], agreeing, inside)
        solved = _solved(agreeing.astype(np.float64) @ products)
    to_places = np.array([[1 / size, 0, -middle[0] / size], [0, 1 / size, -middle[1] / size], [0, 0, 1]])
    from_points = np.array([[shown_size, 0, shown_middle[0]], [0, shown_size, shown_middle[1]], [0, 0, 1]])
    return np.asarray(from_points @ solved @ to_places)


def _solved(normal: npt.NDArray[np.float64]) -> Points:
    """The homographies [K, 3, 3] that the sums of products [K, 81] of their rows leave least of."""
    return np.asarray(np.linalg.eigh(normal.reshape(-1, 9, 9))[1][..., 0].reshape(-1, 3, 3))
