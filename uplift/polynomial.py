"""The sigmoid's polynomial about its summit, and how to round it to three coefficients for λ in nm.

A narrow peak has coefficients for nm that cancel: 3 nm wide at 530 nm, c2 is −2 · 10⁵, and half a unit in its last
place moves the colour by ΔE2000 10⁻⁹. But rounding the three together leaves little of that: each coefficient takes
up the error of those before it, and of a few neighbours of c0 the one is taken that leaves least at the summit.
Within 20 nm of 512 nm, a power of two, and near 640 and 680 nm all neighbours may leave the same, up to half a unit of c2.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_SPLIT = 134217729.0  # 2²⁷ + 1, after Dekker (1971): the halves of a float64
_ENOUGH = 1e-13  # of x, at the summit and on its flanks; it moves a colour by ΔE2000 10⁻¹¹ at most
TRIES = 600  # a peak of one wavelength takes a few hundred, most others one


@njit(cache=True, error_model="numpy")
def about(c0, c1, c2, middle):  # type: ignore[no-untyped-def]
    """Return (c0, c1, c2, middle) of the same polynomial about its own summit, or about the end of −1 … 1 next to it;
    about 0 where it has hardly a summit. For compiled code only.
    """
    summit = 0.0
    if abs(c0) >= 2.0:
        summit = min(1.0, max(-1.0, middle - 0.5 * c1 / c0))
    d = summit - middle
    return c0, c1 + 2.0 * c0 * d, (c0 * d + c1) * d + c2, summit


@njit(cache=True, error_model="numpy")
def in_nm(c0, c1, c2, middle, a, b):  # type: ignore[no-untyped-def]
    """Return (c0, c1, c2, middle) for λ − middle in nm, of coefficients for t − middle with t = (λ − a) · b.

    The new middle is the old one rounded to an odd number of quarters of a nanometre: products with it are exact, and
    unlike 512 it gives `stored` something to choose from. For compiled code only.
    """
    nm = np.floor((a + middle / b) * 2.0) * 0.5 + 0.25
    d = (nm - a) * b - middle
    return c0 * (b * b), (2.0 * c0 * d + c1) * b, (c0 * d + c1) * d + c2, nm


@njit(cache=True, error_model="numpy")
def stored(c0, c1, c2, middle, tries):  # type: ignore[no-untyped-def]
    """Return coefficients for λ in nm, of coefficients for λ − `middle` as `in_nm` returns them, from as many
    `tries` as it takes. For compiled code only.
    """
    width = min(100.0, 4.0 / np.sqrt(abs(c0) + 1e-12))
    last_place = abs(c0) * 2.0**-52
    best, s0, s1, s2 = np.inf, c0, c1, c2
    square = middle * middle
    for attempt in range(tries):
        n0 = c0 + (attempt // 2 if attempt % 2 == 0 else -1 - attempt // 2) * last_place
        h = n0 * _SPLIT
        high = h - (h - n0)
        low = n0 - high
        # c1 − 2 n0 middle, exactly, then rounded.
        p = -2.0 * high * middle
        s = c1 + p
        v = s - c1
        e = ((c1 - (s - v)) + (p - v)) - 2.0 * low * middle
        n1 = s + e
        slope = (n1 - s) - e
        # c2 − n1 middle − n0 middle², the same way.
        h = n1 * _SPLIT
        high1 = h - (h - n1)
        low1 = n1 - high1
        q, p = -high1 * middle, -high * square
        s = q + p
        v = s - q
        e = (q - (s - v)) + (p - v)
        z = s + c2
        v = z - s
        e += (s - (z - v)) + (c2 - v)
        e -= low1 * middle + low * square
        n2 = z + e
        left = abs((n2 - z) - e) + abs(slope) * width
        if left < best:
            best, s0, s1, s2 = left, n0, n1, n2
        if best <= _ENOUGH:
            break
    return s0, s1, s2
