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

from uplift.spectrum import Float64, Observer

# Of compiled sums: they may be reordered, which lets them run in SIMD lanes; NaN and infinity keep their meaning. The
# order is fixed when the code is compiled, so results do not depend on the number of threads.
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
