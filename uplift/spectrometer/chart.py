"""The chart as an instrument: what each patch gives for a light, and how far that can be wrong.

A reading is m[p, c] = g_c Σ R_p(λ) S_c(λ) E(λ) Δλ (1 + errors). Readings are divided by the camera's reading of a lamp of known
spectrum (D65, unless another is declared), and sensitivities by their response to that spectrum, so that g_c is 1 but for
the error of that anchor. Besides the noise of
the readings there are errors of the model itself, which are what limits a real measurement:

- of every reading: the reflectances of a chart differ from the published mean (production, age): `REFLECTANCE` of the
  reading for the patch as a whole, the same for each channel; a part of the white patch for dark ones, `DARK`;
- of the sensitivities: `SENSITIVITY` of the curve, over `SENSITIVITY_NM`, common to all patches;
- of the anchor: the gain of each channel, `GAIN`;
- of the light: a fall-off across the chart that the correction missed, `FALL_OFF` from the middle to a rim, and a veil of
  light that no patch reflects (gloss, flare of the lens), `VEIL` of the white patch, in the colour of the light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uplift import UpliftError
from uplift.spectrum import Observer, illuminant

Floats = npt.NDArray[np.float64]

REFLECTANCE = 0.015
DARK = 0.0007
SENSITIVITY, SENSITIVITY_NM = 0.01, 25.0
GAIN = 0.02
FALL_OFF = 0.01
VEIL = 0.002

COLUMNS = 6
WHITE = 18


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """A chart as a camera saw it, in units of the reading of the lamp of known spectrum.

    `values` [24, 3]: camera RGB of each patch, black subtracted, divided by that of the lamp channel by channel; `noise`
    [24, 3]: standard errors in the same unit; patches row by row from dark skin to black.
    """

    values: Floats
    noise: Floats

    @property
    def flat(self) -> Floats:
        """The 72 values, channel running fastest."""
        return self.values.reshape(-1)


def reading_of(camera_rgb: npt.ArrayLike, noise: npt.ArrayLike, lamp_rgb: npt.ArrayLike) -> Reading:
    """Return the reading of patches `camera_rgb` [24, 3] with standard errors `noise`, beside a known lamp of `lamp_rgb` [3].

    Raises UpliftError if shapes differ, or a value is not finite or is not positive where light must be.
    """
    values, errors = np.asarray(camera_rgb, np.float64), np.asarray(noise, np.float64)
    lamp = np.asarray(lamp_rgb, np.float64)
    if values.shape != (24, 3) or errors.shape != (24, 3) or lamp.shape != (3,):
        raise UpliftError(
            f"chart reading: patches of shape {values.shape}, noise {errors.shape}, lamp {lamp.shape}; expected (24, 3), "
            "(24, 3) and (3,): the 24 patches of a ColorChecker Classic"
        )
    if not (np.isfinite(values).all() and np.isfinite(errors).all() and np.isfinite(lamp).all()):
        raise UpliftError(
            "chart reading: a value is not finite; measure the chart again, in an exposure without clipping"
        )
    if lamp.min() <= 0 or values[WHITE].min() <= 0 or errors.min() < 0:
        raise UpliftError(
            f"chart reading: lamp {lamp.tolist()}, white patch {values[WHITE].tolist()}; expected positive raw values and "
            "noise that is not negative. Check where the chart and the lamp were found"
        )
    return Reading(values / lamp, errors / lamp)


def anchored(sensitivities: npt.ArrayLike, observer: Observer, lamp: Floats | None = None) -> Floats:
    """Return sensitivities [N, 3] with a response of 1 to the spectrum `lamp` [N] in each channel; None: D65.

    Raises UpliftError if shapes differ, or a channel does not see the lamp.
    """
    curves = np.asarray(sensitivities, np.float64)
    if curves.shape != (observer.wavelengths_nm.size, 3) or not np.isfinite(curves).all() or curves.min() < 0:
        raise UpliftError(
            f"sensitivities of shape {curves.shape}; expected ({observer.wavelengths_nm.size}, 3), finite and not negative, "
            "on the observer's grid"
        )
    response = (illuminant("D65", observer) if lamp is None else lamp) @ curves * observer.step_nm
    if response.min() <= 0:
        raise UpliftError(
            f"sensitivities: a channel does not see {'D65' if lamp is None else 'the lamp of known spectrum'}; expected three "
            "channels of visible light, and a lamp that shines in each"
        )
    return curves / response


def responses(reflectances: Floats, sensitivities: Floats, step_nm: float) -> Floats:
    """Return A [72, N]: the reading of a light E is A @ E."""
    return (reflectances[:, np.newaxis, :] * sensitivities.T * step_nm).reshape(-1, reflectances.shape[1])


def covariance(reading: Reading, A: Floats, light: Floats, observer: Observer) -> Floats:
    """Return the covariance [72, 72] of a reading about A @ light: its noise and the errors of the model."""
    m = A @ light
    patches = m.reshape(24, 3)
    white = patches[WHITE]
    out = np.diag(reading.noise.reshape(-1) ** 2 + (DARK * np.tile(white, 24)) ** 2)
    same_patch = np.kron(np.eye(24), 0.5 * (np.ones((3, 3)) + np.eye(3)))
    out += REFLECTANCE**2 * same_patch * np.outer(m, m)
    out += _sensitivity_errors(A * light, observer)
    for part in nuisances(patches):
        out += np.outer(part, part)
    return out


def nuisances(patches: Floats) -> Floats:
    """Return what may be added to all readings [24, 3] at once, as vectors [6, 72] of one standard deviation."""
    row, column = np.divmod(np.arange(24), COLUMNS)
    across, down = (column - 2.5) / 2.5, (row - 1.5) / 1.5
    parts = [GAIN * patches * np.eye(3)[c] for c in range(3)]
    parts += [FALL_OFF * across[:, np.newaxis] * patches, FALL_OFF * down[:, np.newaxis] * patches]
    parts += [VEIL * np.broadcast_to(patches[WHITE], (24, 3))]
    return np.stack([part.reshape(-1) for part in parts])


def _sensitivity_errors(spectral: Floats, observer: Observer) -> Floats:
    """Errors of each channel's curve, common to all patches; `spectral` [72, N] is what each wavelength gives."""
    nm = observer.wavelengths_nm
    like = SENSITIVITY**2 * np.exp(-0.5 * ((nm[:, np.newaxis] - nm) / SENSITIVITY_NM) ** 2)
    out = np.zeros((72, 72))
    for c in range(3):
        own = spectral[c::3]
        out[c::3, c::3] = own @ like @ own.T
    return out
