"""From mixtures of eight reflectances to radiance and back to RGB."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from uplift import UpliftError
from uplift.lattice.cube import Cube
from uplift.spectrum import Float64


def spectra_of_lattice(
    cell: npt.NDArray[np.integer],
    position: npt.NDArray[np.floating],
    scale: npt.NDArray[np.floating],
    emission_index: npt.NDArray[np.integer],
    emissions: npt.ArrayLike,
    cube: Cube,
    *,
    wavelengths_nm: npt.ArrayLike | None = None,
    dtype: type[np.float32] | type[np.float64] = np.float64,
) -> npt.NDArray[np.floating]:
    """Return radiance [..., M] of mixtures [...] at `wavelengths_nm` [M] (default: the observer's grid).

    `cell` [...], `position` [..., 3], `scale` [...] and `emission_index` [...] as `LatticeUplift` has them, or any part
    of a map. `emissions` [K, N] are linear between the observer's wavelengths and zero outside. `dtype` is that of the
    result; computed in float64. Raises UpliftError if shapes disagree, or a cell or an emission does not exist.
    """
    grid = cube.observer.wavelengths_nm
    wavelengths = grid if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=np.float64)
    lights, flat = _flat(cell, position, scale, emission_index, emissions, cube)
    sampled = np.stack([np.interp(wavelengths, grid, light, left=0.0, right=0.0) for light in lights])
    t = np.ascontiguousarray((2 * wavelengths - grid[0] - grid[-1]) / (grid[-1] - grid[0]))
    out = np.empty((flat[0].size, wavelengths.size), dtype)
    _radiance(*flat, sampled, t, cube.coefficients, out)
    return out.reshape((*np.shape(cell), wavelengths.size))


def rgb_of_lattice(
    cell: npt.NDArray[np.integer],
    position: npt.NDArray[np.floating],
    scale: npt.NDArray[np.floating],
    emission_index: npt.NDArray[np.integer],
    emissions: npt.ArrayLike,
    cube: Cube,
) -> Float64:
    """Return linear RGB [..., 3] of mixtures [...] by the sum over the observer's grid; arguments as in
    `spectra_of_lattice`.

    The *spectra* are mixed and summed here, the colours of the nodes are not used, so this tests them.
    """
    lights, flat = _flat(cell, position, scale, emission_index, emissions, cube)
    responses = np.ascontiguousarray(lights[:, :, None] * cube.observer.cmfs * cube.observer.step_nm)
    out = np.empty((flat[0].size, 3))
    _sum(*flat, responses, cube.t, cube.coefficients, cube.space.rgb_from_xyz.copy(), out)
    return out.reshape((*np.shape(cell), 3))


_Flat = tuple[npt.NDArray[np.int64], Float64, Float64, npt.NDArray[np.int64]]


def _flat(
    cell: npt.NDArray[np.integer],
    position: npt.NDArray[np.floating],
    scale: npt.NDArray[np.floating],
    emission_index: npt.NDArray[np.integer],
    emissions: npt.ArrayLike,
    cube: Cube,
) -> tuple[Float64, _Flat]:
    """Check what both functions are given; return the lights, and the pixels in a row."""
    lights = np.asarray(emissions, dtype=np.float64)
    shape = np.shape(cell)
    if (np.shape(position), np.shape(scale), np.shape(emission_index)) != ((*shape, 3), shape, shape):
        raise UpliftError(
            f"mixtures: cell {shape}, position {np.shape(position)}, scale {np.shape(scale)} and emission index "
            f"{np.shape(emission_index)} disagree; expected [...], [..., 3], [...] and [...]"
        )
    if lights.ndim != 2 or lights.shape[1] != cube.t.size:
        raise UpliftError(
            f"mixtures: emissions of shape {lights.shape}; expected [K, {cube.t.size}], on the cube's grid"
        )
    index = np.ascontiguousarray(np.reshape(emission_index, -1), dtype=np.int64)
    if index.size and not 0 <= int(index.min()) <= int(index.max()) < len(lights):
        raise UpliftError(
            f"mixtures: emission indices run from {index.min()} to {index.max()}, but there are {len(lights)} emissions"
        )
    cells = np.ascontiguousarray(np.reshape(cell, -1), dtype=np.int64)
    count = (cube.filled.shape[0] - 1) ** 3
    if cells.size and not 0 <= int(cells.min()) <= int(cells.max()) < count:
        raise UpliftError(f"mixtures: cells run from {cells.min()} to {cells.max()}, but the cube has {count} of them")
    return lights, (
        cells,
        np.ascontiguousarray(np.reshape(position, (-1, 3)), dtype=np.float64),
        np.ascontiguousarray(np.reshape(scale, -1), dtype=np.float64),
        index,
    )


@njit(cache=True, error_model="numpy")
def _mixed(coefficients, cell, u, v, w, t):  # type: ignore[no-untyped-def]
    """Return Σ wᵢ S(cᵢ) over the eight corners of a cell."""
    side = coefficients.shape[0] - 1
    i, j, k = cell // (side * side), cell // side % side, cell % side
    total = 0.0
    for corner in range(8):
        di, dj, dk = corner // 4, corner // 2 % 2, corner % 2
        c = coefficients[i + di, j + dj, k + dk]
        x = (c[0] * t + c[1]) * t + c[2]
        weight = (u if di else 1.0 - u) * (v if dj else 1.0 - v) * (w if dk else 1.0 - w)
        total += weight * (0.5 + 0.5 * x / np.sqrt(1.0 + x * x))
    return total


@njit(cache=True, error_model="numpy", parallel=True)
def _radiance(cell, position, scale, index, sampled, t, coefficients, out):  # type: ignore[no-untyped-def]
    for p in prange(cell.size):
        u, v, w = position[p, 0], position[p, 1], position[p, 2]
        for i in range(t.size):
            out[p, i] = scale[p] * sampled[index[p], i] * _mixed(coefficients, cell[p], u, v, w, t[i])


@njit(cache=True, error_model="numpy", parallel=True)
def _sum(cell, position, scale, index, responses, t, coefficients, rgb_from_xyz, out):  # type: ignore[no-untyped-def]
    for p in prange(cell.size):
        u, v, w = position[p, 0], position[p, 1], position[p, 2]
        X = Y = Z = 0.0
        for i in range(t.size):
            s = _mixed(coefficients, cell[p], u, v, w, t[i])
            X += responses[index[p], i, 0] * s
            Y += responses[index[p], i, 1] * s
            Z += responses[index[p], i, 2] * s
        for channel in range(3):
            row = rgb_from_xyz[channel]
            out[p, channel] = scale[p] * (row[0] * X + row[1] * Y + row[2] * Z)
