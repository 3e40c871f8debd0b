"""The measured and modelled spectra of the synthetic capture, on one grid: 380–780 nm by 5 nm.

Reflectances, lamps, camera sensitivities and the observer are those that colour-science ships; each function
names the data. XYZ is the plain sum over the grid, Σ cmf · P · Δλ, as in `uplift.spectrum`.

A spectral radiance is in W·m⁻²·sr⁻¹·nm⁻¹, so that its luminance is 683 lm/W · Σ ȳ · L · Δλ. A lamp spectrum
is a shape whose luminance is 1 cd/m².

Left out: fluorescence (of papers, textiles and of the chart), polarisation, temperature of the lamps.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

Float64 = npt.NDArray[np.float64]

STEP_NM = 5.0
WAVELENGTHS_NM: Float64 = np.arange(380.0, 780.0 + STEP_NM, STEP_NM)
WAVELENGTHS_NM.setflags(write=False)

# Luminous efficacy of monochromatic radiation of 540 THz, lm/W (definition of the candela, SI brochure 2019).
LUMENS_PER_WATT = 683.0

CHART_SPECTRA = "BabelColor Average"

# Shares of luminance of the parts of the D65 module: CIE LED-B4 (phosphor white), and LEDs of 470, 525 and
# 635 nm after Ohno. With the red share set to 0.05, Grassmann's laws leave three linear equations for the
# other three; these are their solution, kept as data.
_MODULE_RED = (635.0, 18.0, 0.05)
_MODULE_GREEN = (525.0, 33.0, 0.171475046308)
_MODULE_BLUE = (470.0, 22.0, 0.034658503723)
_MODULE_WHITE = ("LED-B4", 0.743866449969)


def _on_grid(distribution: Any) -> Float64:
    """Return a distribution of colour-science on this grid; the ends are held constant where data end."""
    import colour

    shape = colour.SpectralShape(WAVELENGTHS_NM[0], WAVELENGTHS_NM[-1], STEP_NM)
    ends = {"method": "Constant", "left": None, "right": None}
    values = distribution.copy().align(shape, extrapolator_kwargs=ends).values
    return _frozen(np.asarray(values, dtype=np.float64))


def _frozen(values: Float64) -> Float64:
    values.setflags(write=False)
    return values


@cache
def cmfs() -> Float64:
    """Return the CIE 1931 2° colour matching functions, shape (81, 3)."""
    import colour

    return _on_grid(colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"])


def xyz_of(spectra: Float64) -> Float64:
    """Return XYZ, shape (..., 3), of spectral radiance, shape (..., 81); Y is luminance in cd/m²."""
    return np.einsum("...n,nc->...c", spectra, cmfs()) * (LUMENS_PER_WATT * STEP_NM)


def xy_of(spectra: Float64) -> Float64:
    """Return the chromaticity (x, y), shape (..., 2), of spectra of shape (..., 81)."""
    xyz = xyz_of(spectra)
    return xyz[..., :2] / xyz.sum(axis=-1, keepdims=True)


def of_luminance_one(spectrum: Float64) -> Float64:
    """Return `spectrum`, shape (81,), scaled to a luminance of 1 cd/m²."""
    return _frozen(spectrum / xyz_of(spectrum)[1])


@cache
def lamp(name: str) -> Float64:
    """Return the spectrum, shape (81,), of an illuminant or light source of colour-science, or "D65 module".

    Its luminance is 1 cd/m². Any key of `colour.SDS_ILLUMINANTS` or `colour.SDS_LIGHT_SOURCES` will do;
    KeyError names the ones there are.
    """
    import colour

    if name == "D65 module":
        return d65_module()
    for known in (colour.SDS_ILLUMINANTS, colour.SDS_LIGHT_SOURCES):
        if name in known:
            return of_luminance_one(np.maximum(_on_grid(known[name]), 0.0))
    names = sorted([*colour.SDS_ILLUMINANTS, *colour.SDS_LIGHT_SOURCES])
    raise KeyError(f"lamp {name!r} is not a spectrum of colour-science; known: {', '.join(names)}")


def led(peak_nm: float, width_nm: float) -> Float64:
    """Return the spectrum, shape (81,), of a narrow LED by the formula of Y. Ohno (2005), of luminance 1.

    (g + 2 g⁵) / 3 with g = exp(−((λ − peak) / width)²).
    """
    gauss = np.exp(-(((WAVELENGTHS_NM - peak_nm) / width_nm) ** 2))
    return of_luminance_one((gauss + 2.0 * gauss**5) / 3.0)


@cache
def d65_module() -> Float64:
    """Return the spectrum, shape (81,), of the D65 LED module: D65 in colour, not in spectrum.

    It stands in for a real strip, whose measured spectrum nobody publishes: the measured phosphor white
    CIE LED-B4 with three modelled narrow LEDs, in the fixed shares above. Its chromaticity is that of D65 to
    1e-9; its spectrum differs from D65's by more than half of the mean. Luminance 1 cd/m².
    """
    white, share = _MODULE_WHITE
    parts = share * lamp(white)
    for peak_nm, width_nm, share in (_MODULE_BLUE, _MODULE_GREEN, _MODULE_RED):
        parts = parts + share * led(peak_nm, width_nm)
    return of_luminance_one(parts)


@cache
def chart_reflectances(name: str = CHART_SPECTRA) -> Float64:
    """Return the reflectances of the 24 patches, shape (24, 81), row by row from dark skin.

    "BabelColor Average" (measured mean of 30 charts, 380–730 nm, held constant beyond), "ISO 17321-1" or
    "ColorChecker N Ohta".
    """
    import colour

    patches = colour.SDS_COLOURCHECKERS[name].values()
    return _frozen(np.stack([_on_grid(patch) for patch in patches]))


@cache
def colour_samples() -> Float64:
    """Return the 99 reflectances of CIE 224:2017, shape (99, 81): measured spectra of real things.

    They are the colour evaluation samples of the CIE 2017 fidelity index and of ANSI/IES TM-30: nature,
    skin, textiles, paints, plastics and prints. Sample CES n is row n − 1.
    """
    import colour
    from colour.quality.cfi2017 import load_TCS_CIE2017

    shape = colour.SpectralShape(WAVELENGTHS_NM[0], WAVELENGTHS_NM[-1], STEP_NM)
    return _frozen(np.ascontiguousarray(np.asarray(load_TCS_CIE2017(shape).values, dtype=np.float64).T))


@cache
def camera_sensitivities(name: str = "Nikon 5100 (NPL)") -> Float64:
    """Return the relative spectral sensitivities R, G, B of a camera, shape (3, 81), zero beyond the data.

    "Nikon 5100 (NPL)" or "Sigma SDMerill (NPL)": measured at the National Physical Laboratory
    (Darrodi, Finlayson, Goodman and Mackiewicz 2015).
    """
    import colour

    measured = colour.MSDS_CAMERA_SENSITIVITIES[name]
    shape = colour.SpectralShape(WAVELENGTHS_NM[0], WAVELENGTHS_NM[-1], STEP_NM)
    ends = {"method": "Constant", "left": 0.0, "right": 0.0}
    values = measured.copy().align(shape, extrapolator_kwargs=ends).values
    return _frozen(np.ascontiguousarray(np.maximum(np.asarray(values, dtype=np.float64), 0.0).T))


def cct_of(spectrum: Float64) -> tuple[float, float]:
    """Return correlated colour temperature in K and Duv of a spectrum, shape (81,), by Ohno's method (2013)."""
    from colour.models import xy_to_UCS_uv
    from colour.temperature import uv_to_CCT

    cct, duv = uv_to_CCT(xy_to_UCS_uv(xy_of(spectrum)), method="Ohno 2013")
    return float(cct), float(duv)
