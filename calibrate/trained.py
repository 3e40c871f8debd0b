"""A camera matrix from the camera's own spectral sensitivities, with the lamp balanced first, in camera RGB.

Where the sensitivities are known, nothing has to be learned from a chart in one light: the matrix is fitted to the products
of measured reflectances and lights of many colour temperatures, and the lamp's reading fixes the gain of each channel before
the matrix. So a light whose kind does not fall on the chart is as good as one that does. Measured, mean error of the CCT of the
chart's light in %, 52 cameras, ideal D65 lamp, chart and CAT16 / this: illuminant A 2.2 / 0.5, 2000 K 1.6 / 0.1, LED-B3 1.6 /
1.7, LED-B5 4.1 / 3.9, FL2 3.0 / 2.4.

Reflectances are those colour-science carries: the 99 samples of CIE 224:2017, and four measured sets of charts. Lights are
D65 and Planckian radiators of 2000, 2856 and 4000 K; lamps with lines would buy FL2 with A.
"""

import functools
from typing import Final

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.correct.model import least_squares

Floats = npt.NDArray[np.float64]

_CHARTS: Final = ("BabelColor Average", "ColorChecker N Ohta", "ISO 17321-1", "PMC")
_PLANCKIAN_K: Final = (2000.0, 2856.0, 4000.0)
_SECOND_RADIATION_CONSTANT: Final = 1.438776877e-2


@functools.cache
def _reflectances(wavelengths_nm: tuple[float, ...]) -> Floats:
    """Measured reflectances [M, N], held constant beyond their ends."""
    import colour
    from colour.quality.cfi2017 import load_TCS_CIE2017

    at = np.array(wavelengths_nm)
    samples = [sd for chart in _CHARTS for sd in colour.SDS_COLOURCHECKERS[chart].values()]
    rows = [np.interp(at, sd.wavelengths, sd.values) for sd in samples]
    measured = load_TCS_CIE2017(colour.SpectralShape(380, 780, 5))
    rows += [np.interp(at, measured.wavelengths, column) for column in np.asarray(measured.values).T]
    out = np.clip(np.array(rows, dtype=np.float64), 0.0, None)
    out.setflags(write=False)
    return out


def training_reflectances(wavelengths_nm: Floats) -> Floats:
    """Return the reflectances [201, N] the matrix is trained on, at `wavelengths_nm` [N]."""
    return _reflectances(tuple(float(v) for v in wavelengths_nm))


def matrix_of_sensitivities(
    lamp_camera_rgb: Floats,
    sensitivities: Floats,
    *,
    lamp: Floats,
    daylight: Floats,
    observer: Floats,
    wavelengths_nm: Floats,
) -> Floats:
    """Return XYZ_from_camera [3, 3] that gives the lamp its own XYZ, of luminance 1, exactly.

    Parameters
    ----------
    lamp_camera_rgb
        Shape (3,). What the camera read of the lamp, any scale.
    sensitivities
        Shape (N, 3). R, G, B of the camera; the scale of each channel does not matter.
    lamp, daylight
        Shape (N,). The spectrum of the lamp, and that of D65 as one of the lights of the training.
    observer
        Shape (N, 3). Colour matching functions.
    wavelengths_nm
        Shape (N,). Even steps.

    Raises
    ------
    CalibrateError
        If the lamp's reading is not positive, or the sensitivities do not see the lamp in every channel.
    """
    reading = np.asarray(lamp_camera_rgb, dtype=np.float64)
    if reading.shape != (3,) or not np.isfinite(reading).all() or (reading <= 0).any():
        raise CalibrateError(
            f"balance.camera: the lamp reads {np.round(reading, 5).tolist()} in camera RGB; all three must be positive. Point "
            "`balance.lamp` at the lamp, or leave `balance.camera` out."
        )
    spectral = np.asarray(sensitivities, dtype=np.float64)
    expected = np.asarray(lamp, dtype=np.float64) @ spectral
    if spectral.shape != (len(wavelengths_nm), 3) or not (expected > 0).all():
        raise CalibrateError(
            f"balance.camera: sensitivities of shape {spectral.shape} see the lamp as {np.round(expected, 5).tolist()}; "
            f"expected ({len(wavelengths_nm)}, 3) with every channel positive. Give the sensitivities of R, G and B in nm."
        )
    metres = np.asarray(wavelengths_nm, dtype=np.float64) * 1e-9
    planckian = [metres**-5 / np.expm1(_SECOND_RADIATION_CONSTANT / (metres * kelvin)) for kelvin in _PLANCKIAN_K]
    lights = [np.asarray(daylight, dtype=np.float64), *planckian]
    reflectances = training_reflectances(wavelengths_nm)
    spectra = np.vstack([reflectances * (light / (light @ observer[:, 1])) for light in lights])
    own = np.asarray(lamp, dtype=np.float64) / (lamp @ observer[:, 1])
    spectra = np.vstack([spectra, own])
    camera, xyz = spectra @ spectral / (own @ spectral), spectra @ observer
    held = np.arange(len(spectra)) == len(spectra) - 1
    matrix = least_squares(camera, xyz, np.ones(len(spectra)), held)
    return np.asarray(matrix / reading)
