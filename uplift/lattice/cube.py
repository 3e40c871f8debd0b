"""The cube of reflectances fitted under D65, and what becomes of its colours under another light.

Reflectances are the sigmoids of Jakob and Hanika (2019), in the coordinate t that runs from −1 to 1 over the grid.
Fitting goes from the centre outwards, each node from a neighbour that is solved already (Tódová, Wilkie and Fascione
2021 do so for moments, the 2024 paper for sigmoids). In a wide space many nodes have no reflectance: they
stay empty, as in Tódová et al. 2022, and so do the cells that touch them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from uplift import UpliftError
from uplift.spectrum import Float64, Observer, RGBSpace, illuminant, normalised, rgb_weights

# Largest residual of a node's colour that counts as solved. Where the node lies is measured afterwards, so this says
# what is empty, not how exact an uplift is.
_SOLVED = 1e-10
# Black and white are the limits c2 = ∓∞. This is as good: S(−1e9) = 2.5e-19.
_LIMIT = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class Cube:
    """Reflectances of evenly spaced colours under D65.

    `coefficients` [n, n, n, 3] for `t` [N]: node (i, j, k) has the RGB (i, j, k)/(n − 1) in `space`. `filled` [n, n,
    n] is False where no reflectance was found. `t` = (λ − a) · b.
    """

    observer: Observer
    space: RGBSpace
    t: Float64
    coefficients: Float64
    filled: npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """A cube seen under one light.

    `emission` [N] has Y = 1. `rgb` [n, n, n, 3] are the colours of the cube's reflectances under it. `boxes` [(n −
    1)³, 6] are each cell's lowest and highest r, g, b: (+∞, −∞) for cells with an empty corner. `rows` [(n − 1)², 6]
    are those of n − 1 cells in a row.
    """

    emission: Float64
    cube: Cube
    rgb: Float64
    boxes: Float64
    rows: Float64


def build_cube(*, observer: Observer, space: RGBSpace, size: int = 32) -> Cube:
    """Return the cube of `size`³ reflectances in `space`, fitted under D65 from the centre outwards.

    It serves every light. Raises UpliftError if `size` is out of range.
    """
    if not 3 <= size <= 128:
        raise UpliftError(f"build_cube: {size} nodes an axis; expected 3 to 128, 32 as in the paper")
    first, last = observer.wavelengths_nm[0], observer.wavelengths_nm[-1]
    t = np.ascontiguousarray((2 * observer.wavelengths_nm - first - last) / (last - first))
    weights = rgb_weights(illuminant("D65", observer), observer, space)
    coefficients, filled = _fill(weights, t, size)
    return Cube(observer, space, t, coefficients, filled)


def build_lattice(emission: npt.ArrayLike, cube: Cube) -> Lattice:
    """Return `cube` seen under `emission` [N], of any scale, on the cube's grid.

    Raises UpliftError if `emission` is no visible light.
    """
    light = normalised(emission, cube.observer)
    weights = rgb_weights(light, cube.observer, cube.space)
    rgb = np.empty(cube.coefficients.shape)
    _skew(weights, cube.t, cube.coefficients, cube.filled, rgb)
    side = cube.filled.shape[0] - 1
    corners = [
        rgb[i : i + side, j : j + side, k : k + side].reshape(-1, 3) for i in (0, 1) for j in (0, 1) for k in (0, 1)
    ]
    low, high = np.minimum.reduce(corners), np.maximum.reduce(corners)  # empty nodes are NaN, and so is what has one
    empty = np.isnan(low).any(axis=1)
    low[empty], high[empty] = np.inf, -np.inf
    rows = [low.reshape(-1, side, 3).min(axis=1), high.reshape(-1, side, 3).max(axis=1)]
    return Lattice(light, cube, rgb, np.concatenate([low, high], axis=1), np.concatenate(rows, axis=1))


@njit(cache=True, error_model="numpy")
def _colour_and_slopes(weights, t, c, colour, slopes):  # type: ignore[no-untyped-def]
    """Write Σ weights · S to `colour` [3] and its derivatives by c to `slopes` [3, 3]."""
    colour[:] = 0.0
    slopes[:] = 0.0
    for k in range(t.size):
        x = (c[0] * t[k] + c[1]) * t[k] + c[2]
        root = np.sqrt(1.0 + x * x)
        s, d = 0.5 + 0.5 * x / root, 0.5 / (root * root * root)
        for channel in range(3):
            colour[channel] += weights[channel, k] * s
            slope = weights[channel, k] * d
            slopes[channel, 2] += slope
            slopes[channel, 1] += slope * t[k]
            slopes[channel, 0] += slope * t[k] * t[k]


@njit(cache=True, error_model="numpy")
def _eliminate(slopes, rest, step):  # type: ignore[no-untyped-def]
    """Solve slopes · step = rest by elimination with row pivots, in place; False if singular."""
    for column in range(3):
        pivot = column
        for row in range(column + 1, 3):
            if abs(slopes[row, column]) > abs(slopes[pivot, column]):
                pivot = row
        if not abs(slopes[pivot, column]) > 0.0:
            return False
        if pivot != column:
            for k in range(3):
                slopes[column, k], slopes[pivot, k] = slopes[pivot, k], slopes[column, k]
            rest[column], rest[pivot] = rest[pivot], rest[column]
        for row in range(column + 1, 3):
            ratio = slopes[row, column] / slopes[column, column]
            for k in range(column, 3):
                slopes[row, k] -= ratio * slopes[column, k]
            rest[row] -= ratio * rest[column]
    step[2] = rest[2] / slopes[2, 2]
    step[1] = (rest[1] - slopes[1, 2] * step[2]) / slopes[1, 1]
    step[0] = (rest[0] - slopes[0, 1] * step[1] - slopes[0, 2] * step[2]) / slopes[0, 0]
    return True


@njit(cache=True, error_model="numpy")
def _fit(weights, t, goal, c):  # type: ignore[no-untyped-def]
    """Move the coefficients `c` [3] in place until Σ weights · S is `goal` [3]; return the largest residual left.

    Gauss–Newton, a step halved until it lowers the error.
    """
    colour, slopes, rest, step, tried = np.empty(3), np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    _colour_and_slopes(weights, t, c, colour, slopes)
    rest[:] = goal - colour
    error = np.abs(rest).max()
    for _ in range(30):
        if error < 1e-15 or not _eliminate(slopes, rest, step):
            break
        before, fraction = error, 1.0
        for _ in range(12):
            tried[:] = c + fraction * step
            _colour_and_slopes(weights, t, tried, colour, slopes)
            rest[:] = goal - colour
            error = np.abs(rest).max()
            if error < before:
                break
            fraction *= 0.5
        if not error < before:
            return before
        c[:] = tried
    return error


@njit(cache=True, error_model="numpy")
def _fill(weights, t, n):  # type: ignore[no-untyped-def]
    """Return coefficients [n, n, n, 3] and filled [n, n, n]: a flood from the node at the centre."""
    coefficients = np.zeros((n, n, n, 3))
    filled = np.zeros((n, n, n), np.bool_)
    queue = np.empty((n * n * n, 3), np.int64)
    goal, c = np.empty(3), np.zeros(3)
    queue[0] = n // 2
    goal[:] = (n // 2) / (n - 1)
    _fit(weights, t, goal, c)  # from c = 0, the reflectance ½ of the cube's centre
    coefficients[n // 2, n // 2, n // 2] = c
    filled[n // 2, n // 2, n // 2] = True
    coefficients[0, 0, 0, 2], coefficients[n - 1, n - 1, n - 1, 2] = -_LIMIT, _LIMIT
    filled[0, 0, 0] = filled[n - 1, n - 1, n - 1] = True
    first, last = 0, 1
    while first < last:
        i, j, k = queue[first]
        first += 1
        for side in range(6):
            step = 2 * (side % 2) - 1
            u = i + step if side // 2 == 0 else i
            v = j + step if side // 2 == 1 else j
            w = k + step if side // 2 == 2 else k
            if min(u, v, w) < 0 or max(u, v, w) >= n or filled[u, v, w]:
                continue
            goal[0], goal[1], goal[2] = u / (n - 1), v / (n - 1), w / (n - 1)
            c[:] = coefficients[i, j, k]
            if _fit(weights, t, goal, c) <= _SOLVED:
                coefficients[u, v, w] = c
                filled[u, v, w] = True
                queue[last, 0], queue[last, 1], queue[last, 2] = u, v, w
                last += 1
    return coefficients, filled


@njit(cache=True, error_model="numpy", parallel=True)
def _skew(weights, t, coefficients, filled, rgb):  # type: ignore[no-untyped-def]
    n = filled.shape[0]
    for index in prange(n * n * n):
        i, j, k = index // (n * n), index // n % n, index % n
        c0, c1, c2 = coefficients[i, j, k, 0], coefficients[i, j, k, 1], coefficients[i, j, k, 2]
        r = g = b = 0.0 if filled[i, j, k] else np.nan
        for sample in range(t.size):
            x = (c0 * t[sample] + c1) * t[sample] + c2
            s = 0.5 + 0.5 * x / np.sqrt(1.0 + x * x)
            r += weights[0, sample] * s
            g += weights[1, sample] * s
            b += weights[2, sample] * s
        rgb[i, j, k, 0], rgb[i, j, k, 1], rgb[i, j, k, 2] = r, g, b
