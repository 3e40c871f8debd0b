"""Correlated colour temperature of a chromaticity, and its distance from the Planckian locus.

Method: Y. Ohno, "Practical Use and Calculation of CCT and Duv", LEUKOS 10 (2014), with a Planckian table so dense
(0.1 % a step) that no correction factor is needed. McCamy (1992) is kept to reproduce results that were made with it;
do not use it for anything else: it is 118 K low at 10 000 K and 8650 K low at 30 000 K.

Left out: CCT under any other observer than the CIE 1931 2° one, on which CCT is defined.
"""

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

PLANCK_C2_M_K = 1.4388e-2  # second radiation constant as CIE 15 and Ohno use it
MIN_CCT = 1000.0
MAX_CCT = 100_000.0
MAX_DUV = 0.05  # CIE 15: beyond 5e-2 from the locus a correlated colour temperature means nothing
LOCUS_STEP = 1.001
COARSE_STRIDE = 20


def planck(wavelengths_nm: npt.ArrayLike, cct: npt.ArrayLike) -> Floats:
    """Return the relative spectral radiance of black bodies by Planck's law.

    Parameters
    ----------
    wavelengths_nm
        Shape [N].
    cct
        Shape [...]. Kelvin, > 0.

    Returns
    -------
    Shape [..., N]. λ⁻⁵ / (exp(c₂/λT) − 1), divided by its value at 560 nm, with c₂ = 1.4388e-2 m·K.
    """
    wavelength_m = np.asarray(wavelengths_nm, np.float64) * 1e-9
    temperature = np.asarray(cct, np.float64)[..., np.newaxis]
    at_560 = np.expm1(PLANCK_C2_M_K / (560e-9 * temperature)) * (560e-9) ** 5
    spectrum: Floats = at_560 / (wavelength_m**5 * np.expm1(PLANCK_C2_M_K / (wavelength_m * temperature)))
    return spectrum


def uv_of_xy(xy: npt.ArrayLike) -> Floats:
    """Return CIE 1960 (u, v) of CIE 1931 (x, y); shape [..., 2] in and out."""
    xy = np.asarray(xy, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / (-2.0 * xy[..., 0] + 12.0 * xy[..., 1] + 3.0)
        return np.stack([4.0 * xy[..., 0] * scale, 6.0 * xy[..., 1] * scale], axis=-1)


def xy_of_rgb(rgb: npt.ArrayLike, xyz_from_rgb: npt.ArrayLike) -> Floats:
    """Return CIE 1931 (x, y) of linear RGB; NaN where X + Y + Z is not above zero.

    Parameters
    ----------
    rgb
        Shape [..., 3], linear; NaN passes through.
    xyz_from_rgb
        Shape [3, 3].
    """
    xyz = np.asarray(rgb, np.float64) @ np.asarray(xyz_from_rgb, np.float64).T
    total = xyz.sum(axis=-1, keepdims=True)
    total = np.where(total > 0, total, np.nan)
    xy: Floats = xyz[..., :2] / total
    return xy


@cache
def _locus() -> tuple[Floats, Floats]:
    """Temperatures [T] in steps of 0.1 % from 1000 K to 100 000 K (a little beyond), and their (u, v) [T, 2]."""
    import colour

    cmfs: Any = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    steps = int(np.ceil(np.log(MAX_CCT / MIN_CCT) / np.log(LOCUS_STEP)))
    temperatures = MIN_CCT * LOCUS_STEP ** np.arange(-2.0, steps + 3.0)
    visible = (cmfs.wavelengths >= 360) & (cmfs.wavelengths <= 780)  # the range of Ohno's published figures
    xyz = planck(cmfs.wavelengths[visible], temperatures) @ np.asarray(cmfs.values, np.float64)[visible]
    return temperatures, uv_of_xy(xyz[:, :2] / xyz.sum(axis=1, keepdims=True))


def planckian_uv(cct: npt.ArrayLike) -> Floats:
    """Return CIE 1960 (u, v) [..., 2] of black bodies at `cct` [...] kelvin, 1000–100 000 K (clamped outside)."""
    temperatures, uv = _locus()
    where = np.log(np.asarray(cct, np.float64))
    logs = np.log(temperatures)
    return np.stack([np.interp(where, logs, uv[:, 0]), np.interp(where, logs, uv[:, 1])], axis=-1)


def cct_duv(xy: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Return correlated colour temperature and Duv of chromaticities (Ohno 2013/2014).

    Agrees with colour-science's implementation within 0.1 K from 1000 to 30 000 K for |Duv| ≤ 0.03.

    Parameters
    ----------
    xy
        Shape [..., 2], CIE 1931 2° chromaticity.

    Returns
    -------
    cct
        Shape [...]. Kelvin, 1000–100 000. **NaN** where it is not defined: beyond either end of that range, farther
        than 0.05 from the Planckian locus, or where the chromaticity itself is not finite.
    duv
        Shape [...]. Signed distance from the locus in CIE 1960 (u, v), positive on the green side, negative on the
        pink side; NaN exactly where `cct` is.
    """
    uv = uv_of_xy(xy)
    shape = uv.shape[:-1]
    uv = uv.reshape(-1, 2)
    cct = np.full(len(uv), np.nan)
    duv = np.full(len(uv), np.nan)
    finite = np.isfinite(uv).all(axis=1)
    chunk = 65536  # bounds the [chunk, candidates] distance table to some 120 MB
    places = np.flatnonzero(finite)
    for start in range(0, len(places), chunk):
        part = places[start : start + chunk]
        cct[part], duv[part] = _ohno(uv[part])
    return cct.reshape(shape), duv.reshape(shape)


def _ohno(uv: Floats) -> tuple[Floats, Floats]:
    temperatures, locus = _locus()
    coarse = locus[::COARSE_STRIDE]
    nearest = COARSE_STRIDE * np.argmin((uv[:, :1] - coarse[:, 0]) ** 2 + (uv[:, 1:] - coarse[:, 1]) ** 2, axis=1)
    window = np.clip(nearest[:, np.newaxis] + np.arange(-COARSE_STRIDE - 1, COARSE_STRIDE + 2), 0, len(locus) - 1)
    distance2 = np.sum((uv[:, np.newaxis] - locus[window]) ** 2, axis=-1)
    m = np.take_along_axis(window, np.argmin(distance2, axis=1)[:, np.newaxis], axis=1)[:, 0]
    inside = (m > 0) & (m < len(locus) - 1)
    m = np.clip(m, 1, len(locus) - 2)

    # Ohno fits a triangle near the locus and a parabola to the distance farther out, as the distance has a kink on
    # the locus itself. Its square has none: one parabola, over log T, serves both cases.
    before, here, after = (np.sum((uv - locus[m + i]) ** 2, axis=1) for i in (-1, 0, 1))
    curvature = (after - 2.0 * here + before) / 2.0
    step = -(after - before) / (4.0 * curvature)
    cct = temperatures[m] * LOCUS_STEP**step

    foot = (  # on the parabola through the three entries of the locus
        locus[m]
        + (locus[m + 1] - locus[m - 1]) * (step / 2)[:, np.newaxis]
        + (locus[m + 1] - 2 * locus[m] + locus[m - 1]) * (step**2 / 2)[:, np.newaxis]
    )
    distance = np.hypot(*(uv - foot).T)
    duv = np.where(uv[:, 1] >= foot[:, 1], distance, -distance)
    # a black body at either end must not drop out by rounding, so the ends reach 0.1 % farther
    inside &= (cct >= MIN_CCT / LOCUS_STEP) & (cct <= MAX_CCT * LOCUS_STEP) & (np.abs(duv) <= MAX_DUV)
    return np.where(inside, cct, np.nan), np.where(inside, duv, np.nan)


def mccamy(xy: npt.ArrayLike) -> Floats:
    """Return CCT by McCamy's cubic (C. S. McCamy, Color Res. Appl. 17, 1992), for reproduction.

    `xy` has shape [..., 2]; the result [...] is in kelvin. Good to a few kelvin between 2856 and 6500 K, and off by
    −2883 K at 20 000 K, +1422 K at 1000 K. Nothing is refused: far from daylight and Planck the number means nothing.
    """
    xy = np.asarray(xy, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        n = (xy[..., 0] - 0.3320) / (xy[..., 1] - 0.1858)
    cct: Floats = -449.0 * n**3 + 3525.0 * n**2 - 6823.3 * n + 5520.33
    return cct


def mired(cct: npt.ArrayLike) -> Floats:
    """Return reciprocal temperature in mired (10⁶/K): equal steps look about equally different."""
    with np.errstate(divide="ignore"):
        result: Floats = 1e6 / np.asarray(cct, np.float64)
    return result


def nearest_cct(xy: npt.ArrayLike) -> tuple[float, float]:
    """Return the temperature (K) and signed distance of the nearest point of the locus to one chromaticity [2].

    Unlike `cct_duv` this always answers, for colours far from the locus and beyond its ends too (NaN only for NaN); there
    the temperature is a name for the colour and no more.
    """
    cct, duv = cct_duv(xy)
    if np.isfinite(cct):
        return float(cct), float(duv)
    uv = uv_of_xy(xy)
    if not np.isfinite(uv).all():
        return float("nan"), float("nan")
    temperatures, locus = _locus()
    nearest = int(np.argmin(((locus - uv) ** 2).sum(axis=1)))
    distance = float(np.hypot(*(uv - locus[nearest])))
    sign = 1.0 if uv[1] >= locus[nearest, 1] else -1.0
    return float(np.clip(temperatures[nearest], MIN_CCT, MAX_CCT)), sign * distance
