"""The light on a chart, with a camera that is known, or fitted together with the light.

For an unknown camera the reading is bilinear in light and camera. It is solved by linearising about the last estimate of
both (Gauss–Newton): the camera's deviations from its mean are then Gaussian errors of known directions, which the
posterior of the light integrates over, so that the light's variance holds what is lost by not knowing the camera.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from uplift.spectrometer.camera import CameraModel
from uplift.spectrometer.chart import Reading, covariance, responses
from uplift.spectrometer.posterior import Floats, Posterior, posterior
from uplift.spectrometer.prior import Prior
from uplift.spectrum import Observer, illuminant

KNOWN_ROUNDS, UNKNOWN_ROUNDS = 2, 7
DAMPING = 0.7
#: How many times what the model of cameras misses may be larger for a camera unlike those of the model.
UNUSUAL = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A posterior with the reading it explains: `A` [72, N], `covariance` [72, 72] of all errors.

    `residual` [72] is what the light leaves, seen by the camera that was last linearised about; `explained` [72] what the
    light reads with the camera that was found; `camera` is as given. `curves` [N, 3] are the camera's sensitivities, given or found, and
    `unlikely` is how far those found lie from the mean of the model: the square of standard deviations over the number of directions.
    """

    posterior: Posterior
    camera: Floats | CameraModel
    A: Floats
    covariance: Floats
    residual: Floats
    explained: Floats
    chi2: float  # per degree of freedom
    curves: Floats
    fixed_camera: Floats | None = None  # [72, 72] of the errors if the camera were known to be what was found
    unlikely: float = 0.0


#: What else may be in the readings, as vectors [J, 72] of one standard deviation, from A [72, N] and the light [N].
More = Callable[[Floats, Floats, Observer], Floats]


def fit(
    reading: Reading,
    reflectances: Floats,
    camera: Floats | CameraModel,
    prior: Prior,
    observer: Observer,
    *,
    unusual: bool = False,
    more: More | None = None,
) -> Fit:
    """Return the light on a chart of `reflectances` [24, N], seen by `camera`: sensitivities [N, 3] or a model, anchored.

    `unusual` lets the model of cameras miss `UNUSUAL` times as much as it says.
    """
    if isinstance(camera, CameraModel):
        return _unknown(reading, reflectances, camera, prior, observer, UNUSUAL if unusual else 1.0, more)
    A = responses(reflectances, camera, observer.step_nm)
    light = _start(reading, A, observer)
    for turn in range(KNOWN_ROUNDS):
        errors = covariance(reading, A, light, observer) + _errors_of(more, A, light, observer)
        found = posterior(reading.flat, A, errors, prior, positive=turn == KNOWN_ROUNDS - 1)
        light = found.light
    return _judged(reading.flat, A, errors, found, camera, camera)


def _unknown(
    reading: Reading,
    reflectances: Floats,
    model: CameraModel,
    prior: Prior,
    observer: Observer,
    times: float,
    more: More | None,
) -> Fit:
    """`times`: by how much what the model misses is taken larger."""
    amounts = np.zeros(len(model.directions))
    A = responses(reflectances, model.mean, observer.step_nm)
    light = _start(reading, A, observer)
    for turn in range(UNKNOWN_ROUNDS):
        curves = model.curves(amounts)
        A = responses(reflectances, curves, observer.step_nm)
        J = np.stack([responses(reflectances, d, observer.step_nm) @ light for d in model.directions], axis=1)
        fixed = covariance(reading, A, light, observer) + _errors_of(more, A, light, observer)
        errors = fixed + times**2 * _left_over(reflectances, light, curves, model, observer) + J @ J.T
        seen = reading.flat + J @ amounts
        found = posterior(seen, A, errors, prior, positive=turn == UNKNOWN_ROUNDS - 1)
        light = found.light if turn == 0 else DAMPING * found.light + (1 - DAMPING) * light
        off = J.T @ np.linalg.solve(errors, seen - A @ found.light) - amounts
        amounts, explained = amounts + DAMPING * off, A @ found.light + J @ off
    judged = _judged(seen, A, errors, found, model, model.curves(amounts))
    return replace(judged, explained=explained, fixed_camera=fixed, unlikely=float(amounts @ amounts) / len(amounts))


def _errors_of(more: More | None, A: Floats, light: Floats, observer: Observer) -> Floats | float:
    if more is None:
        return 0.0
    parts = more(A, light, observer)
    return np.asarray(parts.T @ parts)


def _left_over(reflectances: Floats, light: Floats, curves: Floats, model: CameraModel, observer: Observer) -> Floats:
    sigma, like = model.left_over(curves, observer)
    out: Floats = np.zeros((72, 72))
    for c in range(3):
        own = reflectances * light * sigma[:, c] * observer.step_nm
        out[c::3, c::3] = own @ like @ own.T
    return out


def _start(reading: Reading, A: Floats, observer: Observer) -> Floats:
    day = illuminant("D65", observer)
    return np.asarray(day * (reading.flat.mean() / (A @ day).mean()))


def _judged(
    m: Floats, A: Floats, errors: Floats, found: Posterior, camera: Floats | CameraModel, curves: Floats
) -> Fit:
    explained = A @ found.light
    residual = m - explained
    chi2 = float(residual @ np.linalg.solve(errors, residual)) / max(m.size - found.freedom, 1.0)
    return Fit(found, camera, A, errors, residual, explained, chi2, curves)
