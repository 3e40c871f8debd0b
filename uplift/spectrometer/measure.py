"""From a chart's raw values to the spectrum of the light on it, with what can be said against it.

A spectrum that is not sure is followed only in part (`safety`), and what no single light explains is refused (`refusal`). An unknown
camera is fitted twice, the second time with more freedom; where that explains the reading better, the first is not believed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
import numpy.typing as npt

from uplift import UpliftError
from uplift.illuminants import cct_duv_of
from uplift.spectrometer.camera import CameraModel, typical_camera
from uplift.spectrometer.chart import Reading, anchored
from uplift.spectrometer.fit import Fit, fit
from uplift.spectrometer.lamps import FAMILIES
from uplift.spectrometer.posterior import Floats, posterior
from uplift.spectrometer.prior import Prior, prior_of
from uplift.spectrometer.refusal import believed, refusal
from uplift.spectrometer.safety import HARDLY, MOST_UNKNOWN, trusted
from uplift.spectrum import Observer, normalised, xyz_of

_BASE = "BabelColor Average"


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLight:
    """The light on a chart.

    `emission` [N], Y = 1, and its standard deviation `sigma` [N] in the same unit; `cct` in K, `duv` and their standard
    deviations; the probability of each family; `chi2` per degree of freedom; `refused`: why it must not be used, or "";
    `camera_loss`: how many times larger the standard deviation is for not knowing the camera (1: it is known);
    `trusted`: the share in `emission` of `measured` [N], Y = 1, the rest being a smooth one of its colour (`safety`), whose
    distance `sigma` then includes; `explained` [24, 3]: what the fit says that the patches should have read; `camera` [N, 3]: its
    sensitivities, given or found with the light, each channel's response to the lamp 1, and `camera_unlikely` how far those found are from
    what cameras are like (mean square of standard deviations; 1 is common).
    """

    emission: Floats
    measured: Floats
    sigma: Floats
    cct: float
    duv: float
    cct_sigma: float
    duv_sigma: float
    families: Mapping[str, float]
    chi2: float
    refused: str
    camera_loss: float
    trusted: float
    explained: Floats
    camera: Floats
    camera_unlikely: float

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
    lamp: npt.ArrayLike | None = None,
) -> MeasuredLight:
    """Return the light on a colour chart.

    Parameters
    ----------
    reading
        The chart's 24 patches, relative to the lamp of known spectrum (`reading_of`).
    camera
        Sensitivities [N, 3] on the observer's grid in any unit, or None: unknown; it is then fitted together with the light.
        (Or a model of cameras to use instead of the built-in one, anchored to D65.)
    reflectances
        Shape [24, N]. Default: `chart_reflectances`.
    prior
        Default: `prior_of(observer)`.
    lamp
        Spectrum [N] of the lamp of known spectrum, in any unit. Default: D65.

    Raises
    ------
    UpliftError
        If shapes differ, or the lamp is no light that each channel sees. A reading that no light explains is no error: see `refused`.
    """
    surfaces = chart_reflectances(observer) if reflectances is None else np.asarray(reflectances, np.float64)
    if surfaces.shape != (24, observer.wavelengths_nm.size):
        raise UpliftError(
            f"chart: reflectances of shape {surfaces.shape}; expected (24, {observer.wavelengths_nm.size}), on the observer's grid"
        )
    known = prior if prior is not None else prior_of(observer)
    anchor = None if lamp is None else normalised(lamp, observer)
    model = camera if isinstance(camera, CameraModel) else typical_camera(observer)
    if anchor is not None:
        model = model.anchored_to(anchor, observer)
    unknown = camera is None or isinstance(camera, CameraModel)
    instrument = model if unknown else anchored(np.asarray(camera, np.float64), observer, anchor)
    again = partial(fit, reading, surfaces, prior=known, observer=observer)
    usual = again(instrument)
    wide = again(model, unusual=True) if unknown else None
    found = believed(usual, wide)
    light = found.posterior.light
    if light @ observer.cmfs[:, 1] <= 0:
        raise UpliftError("chart: no light explains the patches' values; check where the chart was found")
    unit = 1.0 / (light @ observer.cmfs[:, 1] * observer.step_nm)
    emission = normalised(light, observer)
    spread = found.posterior.covariance * unit**2
    cct, duv, cct_sigma, duv_sigma = _colour(emission, spread, observer)
    most = 1.0 if not unknown else MOST_UNKNOWN if found is usual else HARDLY
    used, share = trusted(emission, spread, surfaces, observer, most=most)
    return MeasuredLight(
        emission=used,
        measured=emission,
        sigma=np.sqrt(np.maximum(np.diag(spread), 0.0) + (used - emission) ** 2),
        cct=cct,
        duv=duv,
        cct_sigma=cct_sigma,
        duv_sigma=duv_sigma,
        families={name: float(found.posterior.families[k]) for k, name in enumerate(FAMILIES)},
        chi2=found.chi2,
        refused=refusal(usual, others=model, wide=wide, again=again),
        camera_loss=_loss(found, known),
        trusted=share,
        explained=found.explained.reshape(24, 3),
        camera=found.curves,
        camera_unlikely=found.unlikely,
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
