"""Newton's method on the spectral sums of the sigmoid, for compiled code only.

The polynomial of the sigmoid is taken about a `middle`: x = (c0 d + c1) d + c2 with d = t − middle, for wavelengths
`t` in any unit. About the middle of the grid that is how tables are made. A narrow peak far from the middle cancels
there (a peak of 3 nm at 530 nm costs five digits); about its own summit it keeps them all.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from uplift.sigmoid import SUMS


@njit(cache=True, error_model="numpy", fastmath=SUMS)
def integrals(weights, t, middle, c0, c1, c2):  # type: ignore[no-untyped-def]
    """Return Σ weights · S and its nine derivatives by c, as twelve numbers (row by row).

    `weights` is [3, N], `t` is [N].
    """
    f0 = f1 = f2 = 0.0
    j00 = j01 = j02 = j10 = j11 = j12 = j20 = j21 = j22 = 0.0
    for k in range(t.size):
        tk = t[k] - middle
        x = (c0 * tk + c1) * tk + c2
        inverse = 1.0 / (1.0 + x * x)
        root = np.sqrt(inverse)
        half = 0.5 * root
        s, d = 0.5 + x * half, half * inverse
        dt = d * tk
        dtt = dt * tk
        w0, w1, w2 = weights[0, k], weights[1, k], weights[2, k]
        f0 += w0 * s
        f1 += w1 * s
        f2 += w2 * s
        j00 += w0 * dtt
        j01 += w0 * dt
        j02 += w0 * d
        j10 += w1 * dtt
        j11 += w1 * dt
        j12 += w1 * d
        j20 += w2 * dtt
        j21 += w2 * dt
        j22 += w2 * d
    return f0, f1, f2, j00, j01, j02, j10, j11, j12, j20, j21, j22


@njit(cache=True, error_model="numpy", fastmath=SUMS)
def solve(weights, t, middle, g0, g1, g2, c0, c1, c2, aim, most_looks):  # type: ignore[no-untyped-def]
    """Return (c0, c1, c2, error) with Σ weights · S = (g0, g1, g2), by damped Newton steps from (c0, c1, c2).

    `error` is the largest of the three residuals' magnitudes, infinite if the start was none. Near a solution
    Newton's error obeys e' ≈ C e², so two errors in a row foretell the next one; when that is far below `aim`, the
    step is taken without looking. A step that does not lower the error is shortened, except where rounding, not
    curvature, keeps the error up.
    """
    error = np.inf
    n0, n1, n2 = c0, c1, c2
    s0 = s1 = s2 = 0.0
    fraction = 1.0
    for _ in range(most_looks):
        f0, f1, f2, a, b, c, d, e, f, g, h, i = integrals(weights, t, middle, n0, n1, n2)
        r0, r1, r2 = g0 - f0, g1 - f1, g2 - f2
        found = max(abs(r0), abs(r1), abs(r2))
        # NaN is no less either.
        if not found < error:
            fraction *= 0.4
            if error <= 64.0 * aim or fraction < 0.005:
                break
        else:
            foretold = found * (found / error) ** 2 if error < 1e-4 and fraction == 1.0 else 1.0
            c0, c1, c2, error = n0, n1, n2, found
            if error <= aim:
                break
            # Cramer's rule; the cofactors of a 3 × 3 matrix are cheaper than any factorisation.
            A, B, C = e * i - f * h, f * g - d * i, d * h - e * g
            determinant = a * A + b * B + c * C
            if determinant == 0.0 or not np.isfinite(determinant):
                break
            s0 = (A * r0 + (c * h - b * i) * r1 + (b * f - c * e) * r2) / determinant
            s1 = (B * r0 + (a * i - c * g) * r1 + (c * d - a * f) * r2) / determinant
            s2 = (C * r0 + (b * g - a * h) * r1 + (a * e - b * d) * r2) / determinant
            if foretold <= 0.01 * aim:
                return c0 + s0, c1 + s1, c2 + s2, foretold
            fraction = 1.0
        n0, n1, n2 = c0 + fraction * s0, c1 + fraction * s1, c2 + fraction * s2
    return c0, c1, c2, error


@njit(cache=True, error_model="numpy", fastmath=SUMS)
def newton(weights, t, g0, g1, g2, c0, c1, c2):  # type: ignore[no-untyped-def]
    """Return (c0, c1, c2, error): a whole Newton step towards Σ weights · S = (g0, g1, g2) about 0, and the largest
    of the residuals' magnitudes before it.
    """
    f0, f1, f2, a, b, c, d, e, f, g, h, i = integrals(weights, t, 0.0, c0, c1, c2)
    r0, r1, r2 = g0 - f0, g1 - f1, g2 - f2
    A, B, C = e * i - f * h, f * g - d * i, d * h - e * g
    inverse = 1.0 / (a * A + b * B + c * C)
    c0 += (A * r0 + (c * h - b * i) * r1 + (b * f - c * e) * r2) * inverse
    c1 += (B * r0 + (a * i - c * g) * r1 + (c * d - a * f) * r2) * inverse
    c2 += (C * r0 + (b * g - a * h) * r1 + (a * e - b * d) * r2) * inverse
    return c0, c1, c2, max(abs(r0), abs(r1), abs(r2))
