"""What cameras read of a chart under a lamp: their sensitivities, models without them, noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.spectrometer.lamps import EYES, Float64, Tested
from uplift.spectrometer import Reading, anchored, chart_reflectances, reading_of
from uplift.spectrometer.camera import CameraModel, fitted_model, model_of
from uplift.spectrometer.lamps import lamps
from uplift.spectrometer.prior import Prior, prior_of
from uplift.spectrum import illuminant

NOISE = 0.01


def cameras(folder: Path, count: int) -> tuple[list[int], Float64]:
    """Numbers of `count` cameras spread over the set, and all sensitivities [K, N, 3], anchored to D65."""
    with np.load(folder / "camera_sensitivities.npz") as file:
        curves = np.asarray(file["ssf"], np.float64)
    grid = np.arange(380.0, 781.0, 5.0)
    every = [
        anchored(np.stack([np.interp(EYES.wavelengths_nm, grid, np.maximum(c, 0.0)) for c in one.T], -1), EYES)
        for one in curves
    ]
    return [int(k) for k in np.linspace(0, len(every) - 1, count).round()], np.array(every)


def model_without(curves: Float64, number: int) -> CameraModel:
    """A model of cameras that has not seen one of them; as many directions as the shipped one."""
    from uplift.spectrometer.camera_table import DIRECTIONS

    return model_of(*fitted_model(np.delete(curves, number, 0), EYES.wavelengths_nm, len(DIRECTIONS)), EYES)


def prior_without(lamp: Tested) -> Prior:
    """The prior that does not know a lamp; of those made for one lamp only the last is kept in memory."""
    if lamp.left_out and prior_of.cache_info().currsize > 3:
        prior_of.cache_clear()
        lamps.cache_clear()
    return prior_of(EYES, lamp.left_out)


def read(light: Float64, curves: Float64, seed: int) -> Reading:
    """What a camera reads of the chart under a light, with noise on every value."""
    chance = np.random.default_rng(seed)
    exact = np.einsum("pn,nc,n->pc", chart_reflectances(EYES), curves, light)
    lamp = np.einsum("nc,n->c", curves, illuminant("D65", EYES))
    noisy = exact * (1.0 + NOISE * chance.standard_normal((24, 3)))
    return reading_of(noisy, NOISE * np.abs(noisy), lamp * (1.0 + NOISE * chance.standard_normal(3)))
