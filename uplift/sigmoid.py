"""The smooth reflectance of Jakob and Hanika: a sigmoid of a quadratic polynomial in wavelength.

W. Jakob and J. Hanika, "A Low-Dimensional Function Space for Efficient Spectral Upsampling", CGF 38(2), 2019:

    R(λ) = S(c0 λ² + c1 λ + c2),    S(x) = ½ + x / (2 √(1 + x²)),    S'(x) = ½ (1 + x²)^(−3/2).

Coefficients that leave this package are for λ in nm, as rgb2spec, pbrt-v4 and Mitsuba store them. The
solvers use t = (λ − a) · b, which runs from −1 to 1 over the grid: λ in nm would lose four digits of the
polynomial.

Black and white are the limits c2 = −∞ and +∞ (with c0 = c1 = 0); every function here takes them.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from uplift.spectrum import Float64, Observer

# Sums may be reordered, which lets them run in SIMD lanes; NaN and infinity keep their meaning. The order is
# fixed when the code is compiled, so results do not depend on the number of threads.
SUMS: set[str] = {"reassoc", "contract", "arcp", "nsz"}


def normalisation(observer: Observer) -> tuple[float, float]:
    """Return (a, b) of t = (λ − a) · b, with which the observer's grid spans t = −1 … 1."""
    first, last = float(observer.wavelengths_nm[0]), float(observer.wavelengths_nm[-1])
    return (first + last) / 2, 2 / (last - first)


def normalised_wavelengths(observer: Observer) -> Float64:
    """Return t [N] of the observer's wavelengths."""
    a, b = normalisation(observer)
    return np.ascontiguousarray((observer.wavelengths_nm - a) * b)


def coefficients_in_nm(coefficients: npt.ArrayLike, a: float, b: float) -> Float64:
    """Return coefficients [..., 3] for λ in nm from coefficients for t = (λ − a) · b."""
    A, B, C = np.moveaxis(np.asarray(coefficients, dtype=np.float64), -1, 0)
    return np.stack([A * b**2, B * b - 2 * A * a * b**2, C - B * a * b + A * (a * b) ** 2], axis=-1)


def coefficients_in_t(coefficients: npt.ArrayLike, a: float, b: float) -> Float64:
    """Return coefficients [..., 3] for t = (λ − a) · b from coefficients for λ in nm: undoes
    `coefficients_in_nm`.
    """
    c0, c1, c2 = np.moveaxis(np.asarray(coefficients, dtype=np.float64), -1, 0)
    return np.stack([c0 / b**2, (c1 + 2 * a * c0) / b, c2 + a * c1 + a**2 * c0], axis=-1)


def grey(reflectance: npt.ArrayLike) -> Float64:
    """Return coefficients [..., 3] of constant reflectances [...] in 0 … 1 (in nm and in t alike); ±∞ at 0
    and 1.
    """
    v = np.asarray(reflectance, dtype=np.float64)
    with np.errstate(divide="ignore"):
        c2 = (v - 0.5) / np.sqrt(v * (1 - v))
    return np.stack([np.zeros_like(v), np.zeros_like(v), c2], axis=-1)


def sigmoid(x: npt.ArrayLike) -> Float64:
    """Return S(x), in 0 … 1; the limits at ±∞ are exact, and small values keep their relative precision."""
    magnitude = np.abs(np.asarray(x, dtype=np.float64))
    with np.errstate(over="ignore"):
        root = np.hypot(1.0, magnitude)
        # S(−|x|) = 1 / (2 √(1+x²) (√(1+x²) + |x|)), free of the cancellation in ½ − |x|/(2√(1+x²)).
        dark = 0.5 / root / (root + magnitude)
    return np.asarray(np.where(np.asarray(x) < 0, dark, 1 - dark), dtype=np.float64)


def reflectance(coefficients: npt.ArrayLike, wavelengths_nm: npt.ArrayLike) -> Float64:
    """Return R [..., M] of coefficients [..., 3] for λ in nm at wavelengths [M] in nm."""
    c = np.asarray(coefficients, dtype=np.float64)[..., None]
    wavelengths = np.asarray(wavelengths_nm, dtype=np.float64)
    return sigmoid((c[..., 0, :] * wavelengths + c[..., 1, :]) * wavelengths + c[..., 2, :])


@njit(cache=True, error_model="numpy", fastmath=SUMS)
def integrals(weights, t, c0, c1, c2):  # type: ignore[no-untyped-def]
    """Return Σ weights · S and its nine derivatives by c, as twelve numbers (row by row), for coefficients
    in t.

    `weights` is [3, N], `t` is [N]. For compiled code only.
    """
    f0 = f1 = f2 = 0.0
    j00 = j01 = j02 = j10 = j11 = j12 = j20 = j21 = j22 = 0.0
    for k in range(t.size):
        tk = t[k]
        x = (c0 * tk + c1) * tk + c2
        inverse = 1.0 / (1.0 + x * x)
        root = np.sqrt(inverse)
        s = 0.5 + 0.5 * x * root
        d = 0.5 * root * inverse
        w0, w1, w2 = weights[0, k], weights[1, k], weights[2, k]
        f0 += w0 * s
        f1 += w1 * s
        f2 += w2 * s
        d0, d1, d2 = w0 * d, w1 * d, w2 * d
        j02 += d0
        j12 += d1
        j22 += d2
        d0 *= tk
        d1 *= tk
        d2 *= tk
        j01 += d0
        j11 += d1
        j21 += d2
        j00 += d0 * tk
        j10 += d1 * tk
        j20 += d2 * tk
    return f0, f1, f2, j00, j01, j02, j10, j11, j12, j20, j21, j22


@njit(cache=True, error_model="numpy", fastmath=SUMS)
def solve(weights, t, g0, g1, g2, c0, c1, c2, aim, most_steps):  # type: ignore[no-untyped-def]
    """Return (c0, c1, c2, error) with Σ weights · S = (g0, g1, g2), by damped Newton steps from (c0, c1, c2).

    `error` is the largest of the three residuals' magnitudes. Near a solution Newton's error obeys e' ≈ C
    e², so two errors in a row foretell the next one; when that is far below `aim`, the step is taken without
    looking. A step that does not lower the error is halved. For compiled code only; coefficients in t.
    """
    f0, f1, f2, a, b, c, d, e, f, g, h, i = integrals(weights, t, c0, c1, c2)
    r0, r1, r2 = g0 - f0, g1 - f1, g2 - f2
    error = max(abs(r0), abs(r1), abs(r2))
    foretold = 1.0
    for _ in range(most_steps):
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
        before = error
        for _ in range(8):
            n0, n1, n2 = c0 + fraction * s0, c1 + fraction * s1, c2 + fraction * s2
            f0, f1, f2, a, b, c, d, e, f, g, h, i = integrals(weights, t, n0, n1, n2)
            r0, r1, r2 = g0 - f0, g1 - f1, g2 - f2
            error = max(abs(r0), abs(r1), abs(r2))
            # Below 1e-13 rounding, not curvature, keeps the error up: a shorter step would not help.
            if error < before or before < 1e-13:
                break
            fraction *= 0.5
        if not error < before:
            return c0, c1, c2, before
        c0, c1, c2 = n0, n1, n2
        if error < 1e-4 and fraction == 1.0:
            foretold = error * (error / before) ** 2
    return c0, c1, c2, error


@njit(cache=True, error_model="numpy", fastmath=SUMS)
def newton(weights, t, g0, g1, g2, c0, c1, c2):  # type: ignore[no-untyped-def]
    """Return (c0, c1, c2, error): a whole Newton step towards Σ weights · S = (g0, g1, g2), and the largest of the
    residuals' magnitudes before it. For compiled code only; coefficients in t.
    """
    f0, f1, f2, a, b, c, d, e, f, g, h, i = integrals(weights, t, c0, c1, c2)
    r0, r1, r2 = g0 - f0, g1 - f1, g2 - f2
    A, B, C = e * i - f * h, f * g - d * i, d * h - e * g
    inverse = 1.0 / (a * A + b * B + c * C)
    c0 += (A * r0 + (c * h - b * i) * r1 + (b * f - c * e) * r2) * inverse
    c1 += (B * r0 + (a * i - c * g) * r1 + (c * d - a * f) * r2) * inverse
    c2 += (C * r0 + (b * g - a * h) * r1 + (a * e - b * d) * r2) * inverse
    return c0, c1, c2, max(abs(r0), abs(r1), abs(r2))
