"""Low sun: the direct beam through the atmosphere, at the height of the sun at which it has the asked CCT.

Method: the direct-normal part of SPECTRL2, R. Bird and C. Riordan, "Simple Solar Spectral Model for Direct and Diffuse
Irradiance", SERI/TR-215-2436 (1984): Rayleigh scattering (eq. 2-4), aerosol by Ångström's law (2-6, 2-7), water vapour
(2-8), ozone (2-9, 2-10) and mixed gases (2-11), with F. Kasten's airmass (1966; eq. 2-5) solved for the CCT. The
extraterrestrial spectrum is that of ASTM G-173 as colour-science ships it; aerosol, ozone and water are those of G-173's
standard atmosphere.

This is the sun's own light, not the sky's: at one CCT the two differ by 0.1 to 0.2 of the mean. The diffuse part of SPECTRL2
stays above 5400 K and has no place here.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

from uplift.illuminants.measured import resampled
from uplift.illuminants.nodes import cct_duv_of, check_range, solved
from uplift.spectrum import Observer, normalised

Floats = npt.NDArray[np.float64]

RANGE_K = (2200.0, 5000.0)

AEROSOL_AT_500_NM = 0.084  # optical depth; with OZONE and WATER the atmosphere of ASTM G-173-03
AEROSOL_EXPONENT = 1.14  # Bird and Riordan's for rural air
OZONE_CM = 0.3438
WATER_CM = 1.416
OZONE_HEIGHT = 22.0 / 6370.0

# Bird and Riordan, table 1: nm; absorption coefficients of ozone (1/cm)
OZONE = (
    (440, 450, 460, 470, 480, 490, 500, 510, 520, 530, 540, 550, 570, 593, 610, 630, 656, 667.6, 690, 710, 718, 724.4,
     740, 752.5, 757.5, 762.5, 767.5, 780),
    (0, 0.003, 0.006, 0.009, 0.014, 0.021, 0.030, 0.040, 0.048, 0.063, 0.075, 0.085, 0.120, 0.119, 0.120, 0.090, 0.065,
     0.051, 0.028, 0.018, 0.015, 0.012, 0.010, 0.008, 0.007, 0.006, 0.005, 0),
)  # fmt: skip
# … of water vapour (1/cm)
WATER = (
    (570, 593, 610, 667.6, 690, 710, 718, 724.4, 740, 752.5, 757.5, 767.5, 780, 800),
    (0, 0.075, 0, 0, 0.016, 0.0125, 1.8, 2.5, 0.061, 0.0008, 0.0001, 1e-5, 0.0006, 0.036),
)
# … and of the mixed gases: the oxygen bands B and A
MIXED = ((667.6, 690, 710, 757.5, 762.5, 767.5, 780), (0, 0.15, 0, 0, 4.0, 0.35, 0))


def sunset(cct: float, observer: Observer) -> Floats:
    """Return the emission [N], Y = 1, of the low sun's direct beam whose CCT is `cct` kelvin, 2200–5000.

    Raises UpliftError outside that range.
    """
    check_range("sunset", cct, *RANGE_K, "Above, daylight is meant; below, no sun is left. Give another type.")
    zenith = solved(lambda z: cct_duv_of(direct_beam(z, observer), observer)[0] - cct, 45.0, 89.5)
    return normalised(direct_beam(zenith, observer), observer)


def airmass(zenith_deg: float) -> float:
    """Return the relative airmass at an apparent zenith angle of 0–90 degrees (Kasten 1966)."""
    return float(1.0 / (np.cos(np.radians(zenith_deg)) + 0.15 * (93.885 - zenith_deg) ** -1.253))


def direct_beam(zenith_deg: float, observer: Observer) -> Floats:
    """Return the sun's direct-normal irradiance [N] in W·m⁻²·nm⁻¹ at an apparent zenith angle, at sea level."""
    um = observer.wavelengths_nm / 1000.0
    mass = airmass(zenith_deg)
    rayleigh = mass / (um**4 * (115.6406 - 1.335 / um**2))
    aerosol = AEROSOL_AT_500_NM * (um / 0.5) ** -AEROSOL_EXPONENT * mass
    through_ozone = (1.0 + OZONE_HEIGHT) / np.sqrt(np.cos(np.radians(zenith_deg)) ** 2 + 2.0 * OZONE_HEIGHT)
    ozone = np.interp(observer.wavelengths_nm, *OZONE) * OZONE_CM * through_ozone
    wet = np.interp(observer.wavelengths_nm, *WATER) * WATER_CM * mass
    water = 0.2385 * wet / (1.0 + 20.07 * wet) ** 0.45
    gas = np.interp(observer.wavelengths_nm, *MIXED) * mass
    mixed = 1.41 * gas / (1.0 + 118.93 * gas) ** 0.45
    out: Floats = _extraterrestrial(observer) * np.exp(-(rayleigh + aerosol + ozone + water + mixed))
    return out


@cache
def _extraterrestrial(observer: Observer) -> Floats:
    """Sunlight outside the atmosphere [N], W·m⁻²·nm⁻¹, averaged over each step of the grid (ASTM G-173-03)."""
    from colour.plotting.datasets.astm_g_173 import DATA_ASTMG173_ETR

    wavelengths = np.array(sorted(DATA_ASTMG173_ETR))
    return resampled(wavelengths, np.array([DATA_ASTMG173_ETR[nm] for nm in wavelengths]), observer)
