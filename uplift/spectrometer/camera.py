"""Cameras whose sensitivities nobody measured: a mean curve and a few directions in which cameras differ.

J. Jiang, D. Liu, J. Gu and S. Süsstrunk ("What is the space of spectral sensitivity functions for digital color cameras?",
WACV 2013) found that few principal components describe them. Here the three channels are taken together, each scaled
so that D65 gives 1, which is what a picture of the D65 lamp fixes. The table in `camera_table` holds the mean and the
principal directions over 52 cameras (those of the Academy's rawtoaces project, measured by several laboratories), at nodes
15 nm apart; between them natural cubic splines. It is a summary of how cameras vary, not the data of any of them.

A camera outside of this variety (a filter in front of the lens, a modified sensor) is not described; the fit then shows it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from uplift.spectrometer.chart import anchored
from uplift.spectrometer.posterior import Floats
from uplift.spectrum import Observer

#: What the directions leave: a part of each channel's largest value, and of the value itself; smooth over some nm. Medians
#: over the 52 cameras, each left out of the model that describes it.
LEFT_OF_PEAK, LEFT_OF_VALUE, LEFT_NM = 0.012, 0.03, 15.0


@dataclass(frozen=True, slots=True, eq=False)
class CameraModel:
    """`mean` [N, 3] and `directions` [J, N, 3], each one standard deviation, in units of the response to D65."""

    mean: Floats
    directions: Floats

    def curves(self, amounts: Floats) -> Floats:
        """Sensitivities [N, 3] of the camera that lies `amounts` [J] standard deviations along the directions."""
        return np.asarray(np.maximum(self.mean + np.tensordot(amounts, self.directions, 1), 0.0))

    def anchored_to(self, lamp: Floats, observer: Observer) -> CameraModel:
        """Return the model whose cameras respond with 1 to the spectrum `lamp` [N] instead of D65.

        Of the first order in the amounts; cameras differ by some per cent in their response to a lamp, so what is left out
        is some tenths of a per cent.
        """
        mean = anchored(self.mean, observer, lamp)
        response = lamp @ self.mean * observer.step_nm
        along = self.directions / response
        return CameraModel(mean, along - mean * (lamp @ along * observer.step_nm)[:, np.newaxis, :])

    def left_over(self, curves: Floats, observer: Observer) -> tuple[Floats, Floats]:
        """What curves [N, 3] may miss: standard deviations [N, 3], and their correlation [N, N] over wavelengths."""
        nm = observer.wavelengths_nm
        sigma = LEFT_OF_PEAK * curves.max(axis=0) * (curves > 0) + LEFT_OF_VALUE * curves
        return sigma, np.exp(-0.5 * ((nm[:, np.newaxis] - nm) / LEFT_NM) ** 2)


def model_of(
    nodes_nm: npt.ArrayLike, mean: npt.ArrayLike, directions: npt.ArrayLike, observer: Observer
) -> CameraModel:
    """Return a model on the observer's grid from its values at nodes: mean [M, 3], directions [J, M, 3].

    Beyond the nodes by one of their distances and more it is zero.
    """
    from scipy.interpolate import CubicSpline

    nodes = np.asarray(nodes_nm, np.float64)
    step = nodes[1] - nodes[0]
    at = np.concatenate([[nodes[0] - step], nodes, [nodes[-1] + step]])

    def on_grid(values: Floats) -> Floats:
        ends = np.zeros((1, 3))
        curve = CubicSpline(at, np.concatenate([ends, values, ends]), bc_type="natural")(observer.wavelengths_nm)
        inside = (observer.wavelengths_nm >= at[0]) & (observer.wavelengths_nm <= at[-1])
        return np.asarray(np.where(inside[:, np.newaxis], curve, 0.0))

    middle = anchored(np.maximum(on_grid(np.asarray(mean, np.float64)), 0.0), observer)
    return CameraModel(middle, np.stack([on_grid(np.asarray(d, np.float64)) for d in np.asarray(directions)]))


@cache
def typical_camera(observer: Observer) -> CameraModel:
    """Return the model of the table."""
    from uplift.spectrometer.camera_table import DIRECTIONS, MEAN, NODES_NM, UNIT

    return model_of(NODES_NM, np.array(MEAN).T * UNIT, np.swapaxes(np.array(DIRECTIONS), 1, 2) * UNIT, observer)


def fitted_model(curves: Floats, wavelengths_nm: Floats, directions: int) -> tuple[Floats, Floats, Floats]:
    """Return nodes [M], mean [M, 3] and directions [J, M, 3] of cameras `curves` [K, L, 3], each channel's response to D65 1.

    Values at the nodes are least-squares fits of the splines to the curves; directions are principal components, scaled
    to one standard deviation.
    """
    from scipy.interpolate import CubicSpline

    nodes = np.arange(390.0, 721.0, 15.0)
    at = np.concatenate([[375.0], nodes, [735.0]])
    spline = CubicSpline(at, np.eye(at.size), bc_type="natural")(np.clip(wavelengths_nm, at[0], at[-1]))[:, 1:-1]
    spline[(wavelengths_nm < at[0]) | (wavelengths_nm > at[-1])] = 0.0
    stacked = np.moveaxis(curves, 1, 0).reshape(wavelengths_nm.size, -1)
    values = np.linalg.lstsq(spline, stacked, rcond=None)[0].reshape(nodes.size, len(curves), 3).swapaxes(0, 1)
    mean = values.mean(axis=0)
    _, sigma, vectors = np.linalg.svd((values - mean).reshape(len(curves), -1), full_matrices=False)
    scaled = vectors[:directions] * sigma[:directions, np.newaxis] / np.sqrt(len(curves) - 1)
    return nodes, mean, scaled.reshape(directions, nodes.size, 3)
