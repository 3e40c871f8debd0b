"""Coefficients in 32 bits: the three of a pixel rounded together.

A narrow peak has coefficients for nm that cancel: 3 nm wide at 530 nm, c2 is −10⁵, whose last place in float32 is 0.008;
rounded one by one they moved such colours by up to ΔE2000 2. Here c1 takes up the rounding of c0, c2 that of both, and
of their neighbours the three are taken that leave least at the summit of the polynomial and on its flanks.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from uplift import UpliftError
from uplift.spectrum import Observer

# Of the polynomial's value, where S has its slope: it moves a colour by a thousandth of a ΔE2000 or so.
_ENOUGH = 2e-6
# Neighbours of c0 to each side, with three of c1 each: the more the larger c2, whose last place is what is left.
_STEPS, _MOST_STEPS, _C2_PER_STEP = 8, 150, 100.0


def stored_coefficients(coefficients: npt.NDArray[np.floating], *, observer: Observer) -> npt.NDArray[np.float32]:
    """Return `coefficients` [..., 3] for λ in nm as float32, such that the polynomial changes least on the observer's grid.

    Black's (0, 0, −∞) stays. Raises UpliftError if the last axis is not 3.
    """
    values = np.asarray(coefficients, dtype=np.float64)
    if values.shape[-1:] != (3,):
        raise UpliftError(f"stored_coefficients: coefficients of shape {values.shape}; expected [..., 3]")
    out = np.empty(values.shape, np.float32)
    grid = observer.wavelengths_nm
    _round(np.ascontiguousarray(values.reshape(-1, 3)), float(grid[0]), float(grid[-1]), out.reshape(-1, 3))
    return out


@njit(cache=True, error_model="numpy", parallel=True)
def _round(coefficients, first, last, out):  # type: ignore[no-untyped-def]
    for p in prange(coefficients.shape[0]):
        c0, c1, c2 = coefficients[p, 0], coefficients[p, 1], coefficients[p, 2]
        out[p, 0], out[p, 1], out[p, 2] = np.float32(c0), np.float32(c1), np.float32(c2)
        if not (np.isfinite(c0) and np.isfinite(c1) and np.isfinite(c2)):
            continue
        summit = 0.5 * (first + last)
        if c0 != 0.0:
            summit = min(last, max(first, -0.5 * c1 / c0))
        value = (c0 * summit + c1) * summit + c2
        reach = min(0.5 * (last - first), 4.0 / np.sqrt(abs(c0) + 1e-12))
        near0 = np.float64(np.float32(c0))
        place0 = abs(c0) * 2.0**-23
        best = np.inf
        steps = int(min(_MOST_STEPS, _STEPS + abs(c2) / _C2_PER_STEP))
        for step in range(2 * steps + 1):
            n0 = np.float64(np.float32(near0 + ((step + 1) // 2 if step % 2 else -(step // 2)) * place0))
            middle1 = c1 + 2.0 * (c0 - n0) * summit
            near1 = np.float64(np.float32(middle1))
            place1 = abs(middle1) * 2.0**-23
            for side in range(3):
                n1 = np.float64(np.float32(near1 + (0.0 if side == 0 else (place1 if side == 1 else -place1))))
                n2 = np.float64(np.float32(value - (n0 * summit + n1) * summit))
                left = (
                    abs(value - ((n0 * summit + n1) * summit + n2))
                    + abs(middle1 - n1) * reach
                    + abs(c0 - n0) * reach * reach
                )
                if left < best:
                    best = left
                    out[p, 0], out[p, 1], out[p, 2] = n0, n1, n2
            if best <= _ENOUGH:
                break
