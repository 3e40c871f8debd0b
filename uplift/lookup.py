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
    a, b = a_and_b[0], a_and_b[1]
    size = scale.size
    for block in prange(counts.shape[0]):
        for index in range(block * BLOCK, min(size, (block + 1) * BLOCK)):
            # Not float(): that leaves a float32 one, and the divisions below would round to 24 bits.
            red, green, blue = np.float64(rgb[index, 0]), np.float64(rgb[index, 1]), np.float64(rgb[index, 2])
            k = np.int64(cluster[index])
            kind = PENDING
            G0 = axes[k, 0, 0] * red + axes[k, 0, 1] * green + axes[k, 0, 2] * blue
            G1 = axes[k, 1, 0] * red + axes[k, 1, 1] * green + axes[k, 1, 2] * blue
            G2 = axes[k, 2, 0] * red + axes[k, 2, 1] * green + axes[k, 2, 2] * blue
            largest = max(G0, G1, G2)
            c0 = c1 = c2 = dimness = 0.0
            # Their reciprocals are numbers too.
            if 1e-290 < largest < 1e290:
                one = 1.0 / largest
                m, i, j, p, q, grade = cell_of(grades[k], G0 * one, G1 * one, G2 * one)
                if precision == PREVIEW and grade & LINEAR:
                    c0, c1, c2, dimness = linear(coarse[k], m, i, j, p, q)
                    kind = EXACT
                elif grade:
                    c0, c1, c2, dimness = cubic(surfaces[k], m, i, j, p, q)
                    if precision != ALL and grade & CUBIC:
                        kind = EXACT
                    else:
                        level = 1.0 / dimness
                        y = luminance_weights[0] * red + luminance_weights[1] * green + luminance_weights[2] * blue
                        aim = (1e-14 if precision == ALL else 1e-8) * min(1.0, y * one)
                        g0, g1, g2 = level * one * G0, level * one * G1, level * one * G2
                        curvature = curvatures[k, m, i, j]
                        for _ in range(6):
                            c0, c1, c2, error = newton(weights[k], t, g0, g1, g2, c0, c1, c2)
                            # The next residual is at most this, so no need to look.
                            if curvature * error * error <= aim:
                                kind = EXACT
                                break
                    n1, n2 = c1 * b - 2.0 * c0 * (a * b * b), c2 - c1 * (a * b) + c0 * ((a * b) * (a * b))
                    if precision == ALL and abs(n2) > _CANCELLING:
                        c0, c1, c2, summit = about(c0, c1, c2, 0.0)
                        c0, c1, c2, summit = in_nm(c0, c1, c2, summit, a, b)
                        c0, c1, c2 = stored(c0, c1, c2, summit, TRIES)
                    else:
                        c0, c1, c2 = c0 * (b * b), n1, n2
            coefficients[index, 0] = c0
            coefficients[index, 1] = c1
            coefficients[index, 2] = c2
            scale[index] = largest * dimness
            emission[index] = k
            status[index] = kind
            counts[block, kind] += 1
