"""Pixels that a cell of their light's table answers: nearly all of them.

A cell that is smooth enough answers at once at the coarser precisions. At full precision its bicubic surface starts
so close that mostly one step of Newton's method is enough, and the cell's curvature says so without another look. What
no cell answers is left for `uplift.reach`.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from uplift.newton import newton
from uplift.polynomial import TRIES, about, in_nm, stored
from uplift.reach import EXACT
from uplift.surface import CUBIC, LINEAR, cell_of, cubic, linear

PREVIEW, FLOAT, ALL = 0, 1, 2  # precisions
PENDING = 5  # a status for what is left
BLOCK = 4096  # pixels that one thread takes at a time
_CANCELLING = 64.0  # of c2 for λ in nm: from there on the three coefficients are rounded together


@njit(cache=True, error_model="numpy", parallel=True)
def look_up(  # type: ignore[no-untyped-def]
    rgb,
    cluster,
    precision,
    axes,
    weights,
    t,
    n,
    surfaces,
    coarse,
    grades,
    curvatures,
    luminance_weights,
    a_and_b,
    coefficients,
    scale,
    emission,
    status,
    counts,
):
    """Write the spectra of all pixels of `rgb` that a cell answers, and status PENDING for the others.

    `axes`, `surfaces`, `coarse`, `grades`, `curvatures` and the pixels' arrays are flat; `weights` is [K, 3, N].
    """
    size = scale.size
    nine, three = np.uintp(9), np.uintp(3)
    nodes, cells = np.uintp(3 * n * n), np.uintp(3 * (n - 1) * (n - 1))
    enough = LINEAR if precision == PREVIEW else CUBIC if precision == FLOAT else 0
    for block in prange(counts.shape[0]):
        exact = 0
        for index in range(np.uintp(block * BLOCK), np.uintp(min(size, (block + 1) * BLOCK))):
            at, k = index * three, np.uintp(cluster[index])
            # Not float(): that leaves a float32 one, and the divisions below would round to 24 bits.
            red, green, blue = (
                np.float64(rgb[at]),
                np.float64(rgb[at + np.uintp(1)]),
                np.float64(rgb[at + np.uintp(2)]),
            )
            row = k * nine
            G0 = axes[row] * red + axes[row + np.uintp(1)] * green + axes[row + np.uintp(2)] * blue
            row += three
            G1 = axes[row] * red + axes[row + np.uintp(1)] * green + axes[row + np.uintp(2)] * blue
            row += three
            G2 = axes[row] * red + axes[row + np.uintp(1)] * green + axes[row + np.uintp(2)] * blue
            largest = max(G0, G1, G2)
            kind = PENDING
            c0 = c1 = c2 = dimness = 0.0
            # Their reciprocals are numbers too.
            if 1e-290 < largest < 1e290:
                one = 1.0 / largest
                inside, cell, node, p, q = cell_of(n, G0 * one, G1 * one, G2 * one)
                cell += k * cells
                node += k * nodes
                grade = np.int64(grades[cell]) if inside else 0
                if grade & enough:
                    kind = EXACT
                if precision == PREVIEW and kind == EXACT:
                    c0, c1, c2, dimness = linear(coarse, node, n, p, q)
                elif grade:
                    c0, c1, c2, dimness = cubic(surfaces, node, n, p, q)
                    if kind == PENDING:
                        y = luminance_weights[0] * red + luminance_weights[1] * green + luminance_weights[2] * blue
                        aim = (1e-14 if precision == ALL else 1e-8) * min(1.0, y * one)
                        level = one / dimness
                        kind, c0, c1, c2 = _solved(
                            weights, k, t, level * G0, level * G1, level * G2, c0, c1, c2, curvatures[cell], aim
                        )
                    c0, c1, c2 = _in_nm(c0, c1, c2, a_and_b[0], a_and_b[1], precision == ALL)
            coefficients[at] = c0
            coefficients[at + np.uintp(1)] = c1
            coefficients[at + np.uintp(2)] = c2
            scale[index] = largest * dimness
            emission[index] = k
            status[index] = kind
            exact += kind == EXACT
        counts[block, EXACT] = exact
        counts[block, PENDING] = min(size, (block + 1) * BLOCK) - block * BLOCK - exact


@njit(cache=True, error_model="numpy")
def _solved(weights, k, t, g0, g1, g2, c0, c1, c2, curvature, aim):  # type: ignore[no-untyped-def]
    """Return (status, c0, c1, c2): whole Newton steps, until the next residual is at most `aim`."""
    for _ in range(6):
        c0, c1, c2, error = newton(weights[k], t, g0, g1, g2, c0, c1, c2)
        # The next residual is at most this, so no need to look.
        if curvature * error * error <= aim:
            return EXACT, c0, c1, c2
    return PENDING, c0, c1, c2


@njit(cache=True, error_model="numpy")
def _in_nm(c0, c1, c2, a, b, exact):  # type: ignore[no-untyped-def]
    """Return coefficients for λ in nm, rounded together where they cancel."""
    n1, n2 = c1 * b - 2.0 * c0 * (a * b * b), c2 - c1 * (a * b) + c0 * ((a * b) * (a * b))
    if exact and abs(n2) > _CANCELLING:
        c0, c1, c2, summit = about(c0, c1, c2, 0.0)
        c0, c1, c2, summit = in_nm(c0, c1, c2, summit, a, b)
        return stored(c0, c1, c2, summit, TRIES)
    return c0 * (b * b), n1, n2
