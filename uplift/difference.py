"""Colour difference CIEDE2000 between two maps of linear RGB.

M. R. Luo, G. Cui and B. Rigg, "The development of the CIE 2000 colour-difference formula: CIEDE2000", Color
Research and Application 26(5), 2001; the formulas as in G. Sharma, W. Wu and E. N. Dalal, same journal,
30(1), 2005.

**What white is, in a map without one.** CIELAB needs a white of luminance 1, and an HDR map has pixels far
above any white. Here the white is the space's white (D65 for BT.2020 and sRGB) at luminance `white`; a pixel
whose *first* colour (the reference) is brighter than that is seen by an eye adapted to it: both colours are
divided by the one luminance, so that the reference has Y = 1. So dark pixels are judged as they appear
beside white, bright ones as a white of their own, differences in brightness count in both, and no pixel goes
unjudged. `white=None` takes that step for every pixel, dark ones too: the strictest reading, under which
scaling both maps changes nothing.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from uplift import UpliftError
from uplift.spectrum import Float64, RGBSpace

_COS6, _SIN6 = math.cos(math.radians(6.0)), math.sin(math.radians(6.0))
_COS30, _SIN30 = math.cos(math.radians(30.0)), math.sin(math.radians(30.0))
_COS63, _SIN63 = math.cos(math.radians(63.0)), math.sin(math.radians(63.0))
# cos² of half the angle between two hues, below which they count as opposite: the quotient loses its digits there, and
# the mean hue jumps.
_OPPOSITE = 1e-4


def delta_e_2000(
    rgb_a: npt.NDArray[np.floating],
    rgb_b: npt.NDArray[np.floating],
    space: RGBSpace,
    *,
    white: float | None = 1.0,
) -> Float64:
    """Return ΔE2000 [...] of two maps of linear RGB [..., 3] in `space`; the first one is the reference.

    `white` is the luminance of white in the maps' unit; above it, and everywhere if it is None, both colours
    are divided by the reference's own luminance (see the module's docstring). Equal to colour-science to
    1e-10. NaN where either colour is NaN or infinite. Where `white` is None and the reference has no
    positive luminance: 0 for equal colours, else NaN. Raises UpliftError if shapes disagree or `white` is
    not positive.
    """
    a, b = np.asarray(rgb_a), np.asarray(rgb_b)
    if a.shape != b.shape or a.shape[-1:] != (3,):
        raise UpliftError(f"delta_e_2000: maps of shapes {a.shape} and {b.shape}; expected two of [..., 3]")
    if white is not None and not 0 < white < np.inf:
        raise UpliftError(f"delta_e_2000: white {white}; expected the luminance of white, above 0, or None")
    out = np.empty(a.size // 3)
    white_xyz = space.xyz_from_rgb.sum(axis=1)
    _differences(
        np.ascontiguousarray(a.reshape(-1, 3), dtype=np.float64),
        np.ascontiguousarray(b.reshape(-1, 3), dtype=np.float64),
        np.ascontiguousarray(space.xyz_from_rgb / white_xyz[:, None]),
        white if white is not None else 0.0,
        out,
    )
    return out.reshape(a.shape[:-1])


@njit(cache=True, error_model="numpy")
def _cielab(relative_from_rgb, r, g, b):  # type: ignore[no-untyped-def]
    """Return L*, a*, b* (CIE 015:2018, section 8.2.1) of a colour relative to white."""
    f0 = _compressed(relative_from_rgb[0, 0] * r + relative_from_rgb[0, 1] * g + relative_from_rgb[0, 2] * b)
    f1 = _compressed(relative_from_rgb[1, 0] * r + relative_from_rgb[1, 1] * g + relative_from_rgb[1, 2] * b)
    f2 = _compressed(relative_from_rgb[2, 0] * r + relative_from_rgb[2, 1] * g + relative_from_rgb[2, 2] * b)
    return 116.0 * f1 - 16.0, 500.0 * (f0 - f1), 200.0 * (f1 - f2)


@njit(cache=True, error_model="numpy")
def _compressed(x):  # type: ignore[no-untyped-def]
    if x > 216.0 / 24389.0:
        return np.cbrt(x)
    return (24389.0 / 27.0 * x + 16.0) / 116.0


@njit(cache=True, error_model="numpy")
def _ciede2000(L1, a1, b1, L2, a2, b2):  # type: ignore[no-untyped-def]
    """Sharma, Wu and Dalal (2005), equations 2 to 22, all weights one, with hues as directions instead of angles.

    A round trip asks for it once a pixel, so what it costs is counted: the hue difference is Sève's quotient (Color Research and Application 16(4), 1991), the
    mean hue the direction half-way, and the cosines of its multiples come from those of itself.
    """
    a_stretch = 1.5 - 0.5 * np.sqrt(_pale(0.5 * (np.sqrt(a1 * a1 + b1 * b1) + np.sqrt(a2 * a2 + b2 * b2))))
    a1, a2 = a1 * a_stretch, a2 * a_stretch
    C1, C2 = np.sqrt(a1 * a1 + b1 * b1), np.sqrt(a2 * a2 + b2 * b2)
    dL, dC = L2 - L1, C2 - C1
    dH, cosine, sine = _hues(a1, b1, C1, a2, b2, C2)
    mean_C = (C1 + C2) / 2.0
    lightness = ((L1 + L2) / 2.0 - 50.0) ** 2
    cosine2, sine2 = cosine * cosine - sine * sine, 2.0 * sine * cosine
    cosine3, sine3 = cosine * cosine2 - sine * sine2, sine * cosine2 + cosine * sine2
    cosine4, sine4 = cosine2 * cosine2 - sine2 * sine2, 2.0 * sine2 * cosine2
    T = (
        1.0
        - 0.17 * (cosine * _COS30 + sine * _SIN30)
        + 0.24 * cosine2
        + 0.32 * (cosine3 * _COS6 - sine3 * _SIN6)
        - 0.20 * (cosine4 * _COS63 + sine4 * _SIN63)
    )
    S_L = 1.0 + 0.015 * lightness / np.sqrt(20.0 + lightness)
    S_C = 1.0 + 0.045 * mean_C
    S_H = 1.0 + 0.015 * mean_C * T
    l, c, h = dL / S_L, dC / S_C, dH / S_H  # noqa: E741 - the formula's own letter
    mean_h = np.degrees(np.arctan2(sine, cosine)) % 360.0
    turn = 60.0 * np.exp(-(((mean_h - 275.0) / 25.0) ** 2))
    R_T = -2.0 * np.sqrt(_pale(mean_C)) * np.sin(np.radians(turn))
    return np.sqrt(max(0.0, l * l + c * c + h * h + R_T * c * h))


@njit(cache=True, error_model="numpy")
def _pale(C):  # type: ignore[no-untyped-def]
    """Return C⁷ / (C⁷ + 25⁷), equations 4 and 21."""
    cube = C * C * C
    power = cube * cube * C
    return power / (power + 25.0**7)


@njit(cache=True, error_model="numpy")
def _hues(a1, b1, C1, a2, b2, C2):  # type: ignore[no-untyped-def]
    """Return the difference ΔH' and the cosine and sine of the mean hue (equations 7 to 11 and 14)."""
    if C1 == 0.0 and C2 == 0.0:
        return 0.0, 1.0, 0.0
    if C1 == 0.0:
        return 0.0, a2 / C2, b2 / C2
    if C2 == 0.0:
        return 0.0, a1 / C1, b1 / C1
    # C1 C2 cos² of half the angle between them
    squared = 0.5 * (C1 * C2 + (a1 * a2 + b1 * b2))
    if squared > _OPPOSITE * C1 * C2:
        x, y = a1 / C1 + a2 / C2, b1 / C1 + b2 / C2
        length = np.sqrt(x * x + y * y)
        return (a1 * b2 - a2 * b1) / np.sqrt(squared), x / length, y / length
    h1 = np.degrees(np.arctan2(b1, a1)) % 360.0
    h2 = np.degrees(np.arctan2(b2, a2)) % 360.0
    dh, mean_h = h2 - h1, (h1 + h2) / 2.0
    if abs(dh) > 180.0:
        mean_h += 180.0 if h1 + h2 < 360.0 else -180.0
        dh += -360.0 if dh > 0.0 else 360.0
    mean_h = np.radians(mean_h)
    return 2.0 * np.sqrt(C1 * C2) * np.sin(np.radians(dh) / 2.0), np.cos(mean_h), np.sin(mean_h)


@njit(cache=True, error_model="numpy", parallel=True)
def _differences(rgb_a, rgb_b, relative_from_rgb, white, out):  # type: ignore[no-untyped-def]
    for p in prange(out.size):
        r, g, b = rgb_a[p, 0], rgb_a[p, 1], rgb_a[p, 2]
        u, v, w = rgb_b[p, 0], rgb_b[p, 1], rgb_b[p, 2]
        Y = relative_from_rgb[1, 0] * r + relative_from_rgb[1, 1] * g + relative_from_rgb[1, 2] * b
        divisor = max(Y, white)
        if not (np.isfinite(r + g + b) and np.isfinite(u + v + w)):
            out[p] = np.nan
        elif not divisor > 0.0:
            out[p] = 0.0 if r == u and g == v and b == w else np.nan
        else:
            L1, a1, b1 = _cielab(relative_from_rgb, r / divisor, g / divisor, b / divisor)
            L2, a2, b2 = _cielab(relative_from_rgb, u / divisor, v / divisor, w / divisor)
            out[p] = _ciede2000(L1, a1, b1, L2, a2, b2)
