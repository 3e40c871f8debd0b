"""Hot, stuck and dead photosites: found in the merged mosaic and replaced by their neighbours."""

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from calibrate.reflection import reflected

Plane = npt.NDArray[np.float32]
Row = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]

# How far a defect stands above the largest, or below the smallest, of its eight neighbours.
_FACTOR = np.float32(1.5)

# Photosites around one that are looked at, in each direction.
_REACH = 3


def find_defects(mosaic: Plane, weights: Plane, *, ceiling: float) -> npt.NDArray[np.int32]:
    """Return the rows and columns of single photosites that no optical image can have made.

    The image of a point, however small, is wider than a photosite; so a small lamp lifts its neighbours too, while a
    hot, stuck or dead photosite stands alone. It is one if, compared with its eight neighbours of the same colour,

    - it is above their largest (below their smallest) by a factor of 1.5,
    - by 5 σ of the merged value,
    - and by twice the spread of the eight, which spares texture and noise that is larger than the model says,

    and the direct neighbours, which have the other colours, do not rise (fall) with it against the next ones of their
    own colour: by no more than a twentieth of what the photosite itself rises, relatively, and by no more than a half
    (a deep red lamp is faint in green, not absent), within 3 σ. Two defects that are neighbours are not found.

    Parameters
    ----------
    mosaic
        Shape (H, W), float32, radiance; NaN where clipped in every frame.
    weights
        Shape (H, W), float32: inverse variance of the mosaic, 0 where lost.
    ceiling
        Radiance that a lost pixel has at least.
    """
    height, width = mosaic.shape
    rows, columns = reflected(height, _REACH), reflected(width, _REACH)
    mask = np.zeros(mosaic.shape, np.bool_)
    _mark_defects(mosaic, weights, ceiling, rows, columns, mask)
    return np.argwhere(mask).astype(np.int32)


def replace_defects(mosaic: Plane, lost: npt.NDArray[np.bool_], at: npt.NDArray[np.int32]) -> None:
    """Put the median of the eight neighbours of the same colour in the places `at`, in both arrays."""
    if not len(at):
        return
    rows, columns = reflected(mosaic.shape[0], _REACH), reflected(mosaic.shape[1], _REACH)
    ring = [(dy, dx) for dy in (1, 3, 5) for dx in (1, 3, 5) if (dy, dx) != (3, 3)]
    around = np.stack([mosaic[rows[at[:, 0] + dy], columns[at[:, 1] + dx]] for dy, dx in ring], axis=-1)
    known = ~np.isnan(around).all(axis=-1)
    y, x = at[known].T
    mosaic[y, x] = np.nanmedian(around[known], axis=-1)
    lost[y, x] = False


@njit(cache=True, error_model="numpy")
def _level(mosaic: Plane, y: int, x: int, ceiling: float) -> float:  # pragma: no cover - compiled
    value = np.float64(mosaic[y, x])
    return ceiling if np.isnan(value) else value


@njit(cache=True, error_model="numpy")
def _stands_alone(
    mosaic: Plane,
    weights: Plane,
    ceiling: float,
    rows: Indices,
    columns: Indices,
    y: int,
    x: int,
    sign: float,
    rise: float,
) -> bool:  # pragma: no cover - compiled
    """Whether the direct neighbours keep to the level of the next ones of their colour, in all three groups."""
    for group in range(3):  # beside, above and below, diagonal: one colour each in a Bayer pattern
        inner, outer, weight = -np.inf, -np.inf, np.inf
        for dy in range(-3, 4):
            for dx in range(-3, 4):
                odd_y, odd_x = dy & 1, dx & 1
                if (group == 0 and (odd_y or not odd_x)) or (group == 1 and (odd_x or not odd_y)):
                    continue
                if group == 2 and not (odd_y and odd_x):
                    continue
                reach = abs(dy) + abs(dx)
                if reach > 4:
                    continue
                j, i = rows[y + dy + 3], columns[x + dx + 3]
                value = sign * _level(mosaic, j, i, ceiling)
                if abs(dy) <= 1 and abs(dx) <= 1:
                    inner = max(inner, value)
                    if weights[j, i] > 0:
                        weight = min(weight, np.float64(weights[j, i]))
                else:
                    outer = max(outer, value)
        if inner - outer > rise * abs(outer) + 3.0 / np.sqrt(weight):
            return False
    return True


@njit(cache=True, error_model="numpy")
def _known(value: float, ceiling: float) -> float:  # pragma: no cover - compiled
    return value if value == value else ceiling  # noqa: PLR0124 - false of NaN, in a form that can be vectorised


@njit(cache=True, error_model="numpy")
def _suspect(above: Row, row: Row, below: Row, ceiling: float, out: Mask) -> None:  # pragma: no cover - compiled
    """Mark what is brighter than all eight by the factor, or darker: a short loop that leaves few to look at closely."""
    # Indices that cannot be negative, or the compiler must ask for each whether it counts from the end.
    for x in range(len(row) - 4):
        value = _known(row[x + 2], ceiling)
        smallest, largest = np.float32(np.inf), np.float32(-np.inf)
        for d in range(0, 5, 2):
            up, down = _known(above[x + d], ceiling), _known(below[x + d], ceiling)
            beside = _known(row[x + d], ceiling) if d != 2 else up
            smallest, largest = min(smallest, up, down, beside), max(largest, up, down, beside)
        out[x + 2] = (value > _FACTOR * largest) | (_FACTOR * value < smallest)


@njit(cache=True, parallel=True, error_model="numpy")
def _mark_defects(
    mosaic: Plane,
    weights: Plane,
    ceiling: float,
    rows: Indices,
    columns: Indices,
    mask: Mask,
) -> None:  # pragma: no cover - compiled
    height, width = mosaic.shape
    for y in prange(height):
        suspect = np.ones(width, np.bool_)
        _suspect(mosaic[rows[y + 1]], mosaic[y], mosaic[rows[y + 5]], np.float32(ceiling), suspect)
        for x in range(width):
            if not suspect[x]:
                continue
            value = _level(mosaic, y, x, ceiling)
            smallest, largest = np.inf, -np.inf
            weight = np.float64(weights[y, x]) if weights[y, x] > 0 else np.inf
            for dy in (-2, 0, 2):
                for dx in (-2, 0, 2):
                    if dy == 0 and dx == 0:
                        continue
                    j, i = rows[y + dy + 3], columns[x + dx + 3]
                    other = _level(mosaic, j, i, ceiling)
                    smallest = min(smallest, other)
                    largest = max(largest, other)
                    if weights[j, i] > 0:
                        weight = min(weight, np.float64(weights[j, i]))
            if value > largest:
                excess = value - largest
                far = value > _FACTOR * largest
                rise = min(0.02 * (value / largest - 1.0), 0.2) if largest > 0 else 0.2
                sign = 1.0
            elif value < smallest:
                excess = smallest - value
                far = _FACTOR * value < smallest
                rise = min(0.02 * (1.0 - value / smallest), 0.2) if smallest > 0 else 0.0
                sign = -1.0
            else:
                continue
            if far and excess > 2.0 * (largest - smallest) and excess * np.sqrt(weight) > 5.0:
                mask[y, x] = _stands_alone(mosaic, weights, ceiling, rows, columns, y, x, sign, rise)
