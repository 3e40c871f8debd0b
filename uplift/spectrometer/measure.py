"""From a chart's raw values to the spectrum of the light on it, with what can be said against it.

A fit is refused where it does not explain the reading: chi² per degree of freedom above `MOST_CHI2`. Then likely reasons are
tried one after the other, each as some more freedom in the model, and the one that explains the reading best is named.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from uplift import UpliftError
from uplift.illuminants import cct_duv_of
from uplift.spectrometer.camera import CameraModel, typical_camera
from uplift.spectrometer.chart import COLUMNS, WHITE, Reading
from uplift.spectrometer.fit import Fit, fit
from uplift.spectrometer.lamps import FAMILIES
from uplift.spectrometer.posterior import Floats, posterior
from uplift.spectrometer.prior import Prior, prior_of
from uplift.spectrometer.safety import trusted
from uplift.spectrum import Observer, normalised, xyz_of

#: Over 320 lamps unknown to the prior and 10 cameras at 1 % noise the largest was 1.02 with a known camera, over fewer 1.2
#: with an unknown one (the errors assumed are larger than those simulated); a veil of 4 % of white gives 5 and more, other
#: cameras' sensitivities 0.9 to 18 (median 5).
MOST_CHI2 = 1.5
#: Two lights of like colours leave a small chi²; what betrays them is that the misfit is ordered across the chart. F ratio
#: of the colour's slopes to the rest (4 and some 60 degrees of freedom: 5.3 is met once in a thousand), and the least
#: slope that matters: of a channel against green, from the middle to a rim.
UNEVEN_F, UNEVEN_LEAST = 5.5, 0.01
#: Of the white patch, or of a channel from one side of the chart to the other: how far the likely reasons may go.
_MUCH = 0.3
_BASE = "BabelColor Average"


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLight:
    """The light on a chart.

    `emission` [N], Y = 1, and its standard deviation `sigma` [N] in the same unit; `cct` in K, `duv` and their standard
    deviations; the probability of each family; `chi2` per degree of freedom; `refused`: why it must not be used, or "";
    `camera_loss`: how many times larger the standard deviation is for not knowing the camera (1: it is known);
    `trusted`: the share of the measured spectrum in `emission`, the rest being a smooth one of its colour (`safety`), whose
    distance `sigma` then includes.
    """

    emission: Floats
    sigma: Floats
    cct: float
    duv: float
    cct_sigma: float
    duv_sigma: float
    families: Mapping[str, float]
    chi2: float
    refused: str
    camera_known: bool
    camera_loss: float
    trusted: float = 1.0

    @property
    def family(self) -> str:
        """The most probable family."""
        return max(self.families, key=lambda name: self.families[name])


@cache
def chart_reflectances(observer: Observer) -> Floats:
    """Return the reflectances [24, N] of the ColorChecker Classic: the mean of 30 charts that BabelColor measured.

    380–730 nm; held constant beyond.
    """
    from colour.characterisation import SDS_COLOURCHECKERS

    patches = SDS_COLOURCHECKERS[_BASE].values()
    out = np.array([np.interp(observer.wavelengths_nm, patch.wavelengths, patch.values) for patch in patches])
    out.flags.writeable = False
    return out


def measure_light(
    reading: Reading,
    *,
    camera: npt.ArrayLike | CameraModel | None,
    observer: Observer,
    reflectances: Floats | None = None,
    prior: Prior | None = None,
) -> MeasuredLight:
    """Return the light on a colour chart.

    Parameters
    ----------
    reading
        The chart's 24 patches, relative to the D65 lamp (`reading_of`).
    camera
        Sensitivities [N, 3] on the observer's grid in any unit, or None: unknown; it is then fitted together with the light.
        (Or a model of cameras to use instead of the built-in one.)
    reflectances
        Shape [24, N]. Default: `chart_reflectances`.
    prior
        Default: `prior_of(observer)`.

    Raises
    ------
    UpliftError
        If shapes differ. A reading that no light explains is no error: see `refused`.
    """
    surfaces = chart_reflectances(observer) if reflectances is None else np.asarray(reflectances, np.float64)
    if surfaces.shape != (24, observer.wavelengths_nm.size):
        raise UpliftError(
            f"chart: reflectances of shape {surfaces.shape}; expected (24, {observer.wavelengths_nm.size}), on the observer's grid"
        )
    known = prior if prior is not None else prior_of(observer)
    instrument = typical_camera(observer) if camera is None else camera
    if not isinstance(instrument, CameraModel):
        instrument = np.asarray(instrument, np.float64)
    found = fit(reading, surfaces, instrument, known, observer)
    light = found.posterior.light
    if light @ observer.cmfs[:, 1] <= 0:
        raise UpliftError("chart: no light explains the patches' values; check where the chart was found")
    unit = 1.0 / (light @ observer.cmfs[:, 1] * observer.step_nm)
    emission = normalised(light, observer)
    spread = found.posterior.covariance * unit**2
    cct, duv, cct_sigma, duv_sigma = _colour(emission, spread, observer)
    used, share = trusted(emission, spread, surfaces, observer)
    refused = _uneven(found)
    if found.unusual_camera:
        refused = _UNUSUAL
    if found.chi2 > MOST_CHI2:
        refused = _reason(reading, surfaces, found, known, observer, instrument)
    return MeasuredLight(
        emission=used,
        sigma=np.sqrt(np.maximum(np.diag(spread), 0.0) + (used - emission) ** 2),
        cct=cct,
        duv=duv,
        cct_sigma=cct_sigma,
        duv_sigma=duv_sigma,
        families={name: float(found.posterior.families[k]) for k, name in enumerate(FAMILIES)},
        chi2=found.chi2,
        refused=refused,
        camera_known=not isinstance(instrument, CameraModel),
        camera_loss=_loss(found, known),
        trusted=share,
    )


def _colour(emission: Floats, spread: Floats, observer: Observer) -> tuple[float, float, float, float]:
    """CCT, Duv and their standard deviations, by differences along the axes of the colour's own spread."""
    cct, duv = cct_duv_of(emission, observer)
    seen = xyz_of(spread, observer).T @ observer.cmfs * observer.step_nm
    values, axes = np.linalg.eigh(0.5 * (seen + seen.T))
    off = []
    xyz = xyz_of(emission, observer)
    for value, axis in zip(values, axes.T, strict=True):
        moved = xyz + np.sqrt(max(value, 0.0)) * axis
        other = _of_xyz(moved)
        off.append((other[0] - cct, other[1] - duv) if np.isfinite(other).all() else (0.0, 0.0))
    sigma = np.sqrt((np.array(off) ** 2).sum(axis=0))
    return float(cct), float(duv), float(sigma[0]), float(sigma[1])


def _of_xyz(xyz: Floats) -> tuple[float, float]:
    from uplift.cct import cct_duv

    cct, duv = cct_duv(xyz[:2] / xyz.sum())
    return float(cct), float(duv)


def _loss(found: Fit, prior: Prior) -> float:
    """How much larger the light's standard deviation is for the camera's uncertainty."""
    if found.fixed_camera is None:
        return 1.0
    sure = posterior(found.A @ found.posterior.light, found.A, found.fixed_camera, prior, positive=False)
    return float(np.sqrt(np.trace(found.posterior.covariance) / max(np.trace(sure.covariance), 1e-300)))


_TWO_LIGHTS = (
    "the colour of the light changes across the chart: several lights reach it. Photograph it where one of them is much the "
    "brightest"
)


_UNUSUAL = (
    "the camera's sensitivities are unlike those of the cameras known here, and cannot be told from the light. Give them "
    "(`balance.camera`)."
)


def _slopes(found: Fit, channels: tuple[int, ...]) -> Floats:
    """Readings [2 per channel, 72] that grow by their own amount from the middle of the chart to its rims."""
    patches = (found.A @ found.posterior.light).reshape(24, 3)
    row, column = np.divmod(np.arange(24), COLUMNS)
    sides = ((column - 2.5) / 2.5, (row - 1.5) / 1.5)
    return np.stack([(side[:, np.newaxis] * patches * np.eye(3)[c]).reshape(-1) for c in channels for side in sides])


def _uneven(found: Fit) -> str:
    """Why the light's colour cannot be the same all over the chart, or ""."""
    V = _slopes(found, (0, 2)).T
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


def _reason(
    reading: Reading,
    reflectances: Floats,
    found: Fit,
    prior: Prior,
    observer: Observer,
    instrument: Floats | CameraModel,
) -> str:
    """The most likely of the usual reasons why no light explains a reading, and what to do."""
    patches = (found.A @ found.posterior.light).reshape(24, 3)
    veil = [_MUCH * np.tile(np.eye(3)[c] * patches[WHITE], 24) for c in range(3)]
    tried = {
        "a veil of light lies over all patches (gloss, or light that shines into the lens). Turn the chart until no lamp "
        "mirrors in it, and shade the lens": _freed(reading, found, np.stack(veil), prior),
        _TWO_LIGHTS: _freed(reading, found, _MUCH * _slopes(found, (0, 1, 2)), prior),
    }
    if not isinstance(instrument, CameraModel):
        other = fit(reading, reflectances, typical_camera(observer), prior, observer)
        tried["the sensitivities are those of another camera. Give this camera's, or none"] = other.chi2
    best = min(tried, key=lambda text: tried[text])
    told = (
        f"no light explains the patches (chi² per degree of freedom {found.chi2:.1f}; expected {MOST_CHI2:g} at most): "
    )
    if tried[best] <= MOST_CHI2:
        return told + "most likely " + best + "."
    return told + (
        "none of the usual reasons (glare, several lights, another camera) accounts for it either. Check that the chart is a "
        "ColorChecker Classic, was found the right way up, and is neither dirty nor faded."
    )


def _freed(reading: Reading, found: Fit, more: Floats, prior: Prior) -> float:
    """Chi² per degree of freedom if the readings may deviate along `more` [J, 72] besides."""
    errors = found.covariance + more.T @ more
    m = found.A @ found.posterior.light + found.residual
    again = posterior(m, found.A, errors, prior, positive=False)
    residual = m - found.A @ again.light
    freedom = max(reading.flat.size - again.freedom - len(more), 1.0)
    return float(residual @ np.linalg.solve(errors, residual)) / freedom
