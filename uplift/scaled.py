"""The scaled reflectance uplift, the baseline: what renderers do with an RGB environment map today.

As Mitsuba 3's spectral `envmap` does it, after W. Jakob and J. Hanika (2019): rgb / scale with scale = 2 ·
max(rgb) is taken for a reflectance seen under D65, and the radiance is scale · D65(λ) · R(λ), whatever light there
was.

Mitsuba looks R up in a table that is fitted beforehand; here every pixel is fitted by itself, by Levenberg–Marquardt
from grey, so the baseline is free of interpolation error. No table and no step is shared with the exact path of
`pixels.py`, so the two cannot agree by accident. As in Mitsuba negative components count as zero. Where the
colour cannot be had at that brightness, as near the corners of wide spaces, the nearest in linear RGB is taken; such
pixels have the status CLOSEST, like negative ones.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from uplift import UpliftError
from uplift.pixels import Status, Uplifted, recorded
from uplift.spectrum import Observer, RGBSpace, illuminant, rgb_weights

_EXACT, _BLACK, _CLOSEST, _MISSING = (
    int(kind) for kind in (Status.EXACT, Status.BLACK, Status.CLOSEST, Status.MISSING)
)


def uplift_scaled(
    rgb: npt.NDArray[np.floating], *, observer: Observer, space: RGBSpace, factor: float = 2.0
) -> Uplifted:
    """Return the spectra of a map by the scaled reflectance uplift; scale = `factor` · max(rgb), 2 in Mitsuba.

    `rgb` has shape (H, W, 3): linear RGB in `space`, any unit. The one emission is D65. Raises UpliftError if
    `rgb` is no map of floats, or `factor` is not above 1.
    """
    rgb = np.asarray(rgb)
    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype.kind != "f":
        raise UpliftError(f"uplift_scaled: rgb has shape {rgb.shape} of {rgb.dtype}; expected floats [H, W, 3]")
    if not factor > 1:
        raise UpliftError(f"uplift_scaled: factor {factor}; expected more than 1, since R stays below one")
    d65 = illuminant("D65", observer)
    # rgb2spec's own coordinate, 0 … 1 over the grid.
    first, span = observer.wavelengths_nm[0], observer.wavelengths_nm[-1] - observer.wavelengths_nm[0]
    coefficients = np.empty(rgb.shape)
    scale = np.empty(rgb.shape[:2])
    status = np.empty(rgb.shape[:2], np.uint8)
    weights = rgb_weights(d65, observer, space)
    u = np.ascontiguousarray((observer.wavelengths_nm - first) / span)
    _fit(np.ascontiguousarray(rgb, dtype=np.float64), weights, u, factor, coefficients, scale, status)
    # From u = (λ − first) / span to λ in nm.
    A, B, C = np.moveaxis(coefficients, -1, 0)
    in_nm = np.stack(
        [A / span**2, B / span - 2 * A * first / span**2, C - B * first / span + A * (first / span) ** 2], -1
    )
    emission = np.zeros(scale.shape, np.uint32)
    return recorded(rgb, in_nm, scale, emission, status, d65[None, :].copy(), observer=observer, space=space)


# Sums may be reordered, so that they vectorise; infinities and NaN keep their meaning.
_REORDERED = {"reassoc", "contract", "arcp", "nsz"}


@njit(cache=True, error_model="numpy", fastmath=_REORDERED)
def _normal_equations(weights, u, c0, c1, c2, g0, g1, g2):  # type: ignore[no-untyped-def]
    """Return half the squared residual, the gradient Jᵀr and the six different elements of JᵀJ."""
    r0, r1, r2 = g0, g1, g2
    a0 = a1 = a2 = b0 = b1 = b2 = e0 = e1 = e2 = 0.0
    for k in range(u.size):
        x = (c0 * u[k] + c1) * u[k] + c2
        hypotenuse = np.sqrt(1.0 + x * x)
        s = 0.5 + x / (2.0 * hypotenuse)
        slope = 0.5 / (hypotenuse * hypotenuse * hypotenuse)
        w0, w1, w2 = weights[0, k], weights[1, k], weights[2, k]
        r0, r1, r2 = r0 - w0 * s, r1 - w1 * s, r2 - w2 * s
        w0, w1, w2 = w0 * slope, w1 * slope, w2 * slope
        e0, e1, e2 = e0 + w0, e1 + w1, e2 + w2
        w0, w1, w2 = w0 * u[k], w1 * u[k], w2 * u[k]
        b0, b1, b2 = b0 + w0, b1 + w1, b2 + w2
        a0, a1, a2 = a0 + w0 * u[k], a1 + w1 * u[k], a2 + w2 * u[k]
    half = 0.5 * (r0 * r0 + r1 * r1 + r2 * r2)
    p = a0 * r0 + a1 * r1 + a2 * r2
    q = b0 * r0 + b1 * r1 + b2 * r2
    v = e0 * r0 + e1 * r1 + e2 * r2
    aa, ab, ae = a0 * a0 + a1 * a1 + a2 * a2, a0 * b0 + a1 * b1 + a2 * b2, a0 * e0 + a1 * e1 + a2 * e2
    bb, be, ee = b0 * b0 + b1 * b1 + b2 * b2, b0 * e0 + b1 * e1 + b2 * e2, e0 * e0 + e1 * e1 + e2 * e2
    return half, p, q, v, aa, ab, ae, bb, be, ee


@njit(cache=True, error_model="numpy")
def _marquardt(weights, u, g0, g1, g2):  # type: ignore[no-untyped-def]
    """Return (c0, c1, c2, residual) of the least-squares fit from grey ½, the norm of its RGB residual last."""
    c0 = c1 = c2 = 0.0
    half, p, q, v, aa, ab, ae, bb, be, ee = _normal_equations(weights, u, c0, c1, c2, g0, g1, g2)
    damping = 1e-3
    for _ in range(200):
        if half < 1e-29 or damping > 1e12:
            break
        d0, d1, d2 = aa * (1.0 + damping), bb * (1.0 + damping), ee * (1.0 + damping)
        determinant = d0 * (d1 * d2 - be * be) - ab * (ab * d2 - be * ae) + ae * (ab * be - d1 * ae)
        s0 = (p * (d1 * d2 - be * be) - ab * (q * d2 - be * v) + ae * (q * be - d1 * v)) / determinant
        s1 = (d0 * (q * d2 - be * v) - p * (ab * d2 - be * ae) + ae * (ab * v - q * ae)) / determinant
        s2 = (d0 * (d1 * v - q * be) - ab * (ab * v - q * ae) + p * (ab * be - d1 * ae)) / determinant
        n_half, n_p, n_q, n_v, n_aa, n_ab, n_ae, n_bb, n_be, n_ee = _normal_equations(
            weights, u, c0 + s0, c1 + s1, c2 + s2, g0, g1, g2
        )
        if n_half < half:
            c0, c1, c2 = c0 + s0, c1 + s1, c2 + s2
            half, p, q, v, aa, ab, ae, bb, be, ee = n_half, n_p, n_q, n_v, n_aa, n_ab, n_ae, n_bb, n_be, n_ee
            damping *= 0.03
        else:
            damping = max(damping, 1e-12) * 10.0
    return c0, c1, c2, np.sqrt(2.0 * half)


@njit(cache=True, error_model="numpy", parallel=True)
def _fit(rgb, weights, u, factor, coefficients, scale, status):  # type: ignore[no-untyped-def]
    width = rgb.shape[1]
    for index in prange(rgb.shape[0] * width):
        row, column = index // width, index % width
        red, green, blue = rgb[row, column, 0], rgb[row, column, 1], rgb[row, column, 2]
        kind = _EXACT
        c0, c1, c2, brightness = 0.0, 0.0, -np.inf, 0.0
        if not np.isfinite(red + green + blue):
            kind = _MISSING
        elif red == 0.0 and green == 0.0 and blue == 0.0:
            kind = _BLACK
        else:
            if min(red, green, blue) < 0.0:
                kind = _CLOSEST
            red, green, blue = max(red, 0.0), max(green, 0.0), max(blue, 0.0)
            largest = max(red, green, blue)
            if largest > 0.0:
                brightness = factor * largest
                c0, c1, c2, residual = _marquardt(
                    weights, u, red / largest / factor, green / largest / factor, blue / largest / factor
                )
                if residual > 1e-11:
                    kind = _CLOSEST
        coefficients[row, column, 0] = c0
        coefficients[row, column, 1] = c1
        coefficients[row, column, 2] = c2
        scale[row, column] = brightness
        status[row, column] = kind
