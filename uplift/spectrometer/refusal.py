"""What speaks against a measured light: why no single light, seen by a camera that is known, explains the patches.

A fit is refused where it does not explain the reading: chi² per degree of freedom above `MOST_CHI2`. Then likely reasons are
tried one after the other, each as some more freedom in the model, and the most probable of those that explain the reading
is named. Below that limit two things still betray themselves: a light that changes across the chart, by a misfit that is ordered
across it, and a camera unlike all others, by a model of cameras that is more probable if it may miss more: clearly so, and the
light is refused; less clearly, and it is that of the model that may miss more, and hardly followed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from uplift.spectrometer.camera import CameraModel
from uplift.spectrometer.chart import COLUMNS, WHITE
from uplift.spectrometer.fit import Fit
from uplift.spectrometer.posterior import Floats
from uplift.spectrum import Observer

#: 15 of 3820 readings of 382 lamps unknown to the prior by 10 known cameras at 1 % noise are above it, and of 148 of 74 lamps by
#: 11 unknown cameras none (the errors assumed are larger than those simulated); a veil of 4 % of white gives 5 and more, other
#: cameras' sensitivities 0.9 to 18 (median 5).
MOST_CHI2 = 1.5
#: Two lights of like colours leave a small chi²; what betrays them is that the misfit is ordered across the chart. F ratio
#: of the colour's slopes to the rest (4 and some 60 degrees of freedom: 5.3 is met once in a thousand), and the least
#: slope that matters: of a channel against green, from the middle to a rim.
UNEVEN_F, UNEVEN_LEAST = 5.5, 0.01
#: Log evidence by which a model of cameras that may miss more must explain a reading better to raise a doubt, and to refuse the light. Over
#: 300 readings of 30 cameras, each left out of the model, 29 cameras stayed below 5.0, and all but one of these, a compact
#: of 2009 (Canon S90), below 1.6. The thirtieth is a cinema camera (ARRI D21): 2.6 to 12.6. Of 55 more of a Nikon D850 one had 7.2, the
#: others less than 3. Sensitivities narrowed to 25 nm have 2.1 to 15: spectra of theirs must not be followed.
DOUBTFUL, UNUSUAL_EVIDENCE = 2.0, 5.5
#: How far the likely reasons may go: a veil, of the white patch; a second light, of the first at every wavelength, from the
#: middle of the chart to a rim.
_MUCH = 0.3
#: Bands in which two lights may differ.
_BANDS_NM, _BAND_WIDTH_NM = (400.0, 450.0, 500.0, 550.0, 600.0, 650.0, 700.0), 25.0

_VEIL = (
    "a veil of light lies over all patches (gloss, or light that shines into the lens). Turn the chart until no lamp mirrors "
    "in it, and shade the lens"
)
_TWO_LIGHTS = (
    "the colour of the light changes across the chart: several lights reach it. Photograph it where one of them is much the "
    "brightest"
)
_ANOTHER = "the sensitivities are those of another camera. Give this camera's, or none"
_UNUSUAL = (
    "the camera's sensitivities are unlike those of the cameras known here, and cannot be told from the light. Give them "
    "(`balance.camera`)"
)


def refusal(found: Fit, *, others: CameraModel, wide: Fit | None, again: Callable[..., Fit]) -> str:
    """Return why the light of a fit must not be used and what to do, or "".

    `others` is the model of cameras, `wide` the fit in which it may miss more; None if the camera was given. `again`(camera, …)
    fits the same reading with a camera, and with what `fit` takes besides.
    """
    if found.chi2 > MOST_CHI2:
        return _no_light(found, others=others, wide=wide, again=again)
    if wide is not None and _gain(wide, found) > UNUSUAL_EVIDENCE:
        return f"{_UNUSUAL}."
    return _uneven(believed(found, wide))


def believed(usual: Fit, wide: Fit | None) -> Fit:
    """Return which fit of a camera to believe: `wide` where there is doubt that the camera is like the known ones.

    `usual` if the camera was given, or nothing explains the reading.
    """
    return wide if wide is not None and usual.chi2 <= MOST_CHI2 and _gain(wide, usual) > DOUBTFUL else usual


def _gain(one: Fit, other: Fit) -> float:
    return one.posterior.log_evidence - other.posterior.log_evidence


def _no_light(found: Fit, *, others: CameraModel, wide: Fit | None, again: Callable[..., Fit]) -> str:
    tried = {_VEIL: again(found.camera, more=_veil), _TWO_LIGHTS: again(found.camera, more=_second_light)}
    if wide is None:
        tried[_ANOTHER] = again(others, unusual=True)
    else:
        tried[_UNUSUAL] = wide
    told = (
        f"no light explains the patches (chi² per degree of freedom {found.chi2:.1f}; expected {MOST_CHI2:g} at most): "
    )
    explaining = [text for text in tried if tried[text].chi2 <= MOST_CHI2]
    if explaining:
        return f"{told}most likely {max(explaining, key=lambda text: tried[text].posterior.log_evidence)}."
    return told + (
        "none of the usual reasons (glare, several lights, the camera's sensitivities) accounts for it either. Check that the "
        "chart is a ColorChecker Classic, was found the right way up, and is neither dirty nor faded."
    )


def _veil(A: Floats, light: Floats, _: Observer) -> Floats:
    white = (A @ light).reshape(24, 3)[WHITE]
    return np.stack([_MUCH * np.tile(np.eye(3)[c] * white, 24) for c in range(3)])


def _second_light(A: Floats, light: Floats, observer: Observer) -> Floats:
    bands = np.exp(-0.5 * ((observer.wavelengths_nm - np.array(_BANDS_NM)[:, np.newaxis]) / _BAND_WIDTH_NM) ** 2)
    return np.stack([_MUCH * side * (A @ (band * light)) for band in bands for side in _sides()])


def _sides() -> tuple[Floats, Floats]:
    """Weights [72] of the readings that go from -1 to 1 across the chart, and down it."""
    row, column = np.divmod(np.arange(24), COLUMNS)
    return np.repeat((column - 2.5) / 2.5, 3), np.repeat((row - 1.5) / 1.5, 3)


def _uneven(found: Fit) -> str:
    """Why the light's colour cannot be the same all over the chart, or ""."""
    seen = found.A @ found.posterior.light
    channel = np.tile(np.arange(3), 24)
    V = np.stack([side * seen * (channel == c) for c in (0, 2) for side in _sides()], axis=1)
    explained = np.linalg.solve(found.covariance, V)
    precision = V.T @ explained
    slopes = np.linalg.solve(precision, explained.T @ found.residual)
    rest = found.residual - V @ slopes
    free = max(found.residual.size - found.posterior.freedom - len(slopes), 1.0)
    noise = float(rest @ np.linalg.solve(found.covariance, rest)) / free
    ratio = float(slopes @ precision @ slopes) / len(slopes) / max(noise, 1e-300)
    if ratio <= UNEVEN_F or np.abs(slopes).max() < UNEVEN_LEAST:
        return ""
    return f"by {np.abs(slopes).max():.1%} from its middle to a rim (F {ratio:.0f}) {_TWO_LIGHTS}."
