"""What is known beforehand of the lamp: the colour that the camera should see, its size, how far from the chart it stands."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from calibrate.difference import D65_XYZ

Floats = npt.NDArray[np.float64]

# Modules are not quite D65, and cameras see their spectra with other ratios than daylight's. Covariance of (log R/G, log B/G) over
# 54 cameras and modules of four constructions, within 0.004 of D65 in x and y.
MODULE_COVARIANCE: Final = np.array([[0.0008, 0.00046], [0.00046, 0.0012]])


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedColour:
    """The colour of the lamp as the camera should see it.

    `camera_rgb` [3], any scale; `rgb_from_camera` [3, 3] is the chart's matrix to working RGB; `spread` the relative
    standard deviation of each channel of `camera_rgb`, by which cameras differ from what is published or measured of
    their model. `own_spectrum`: the lamp's spectrum is measured, so that it is no module among many.
    """

    camera_rgb: Floats
    rgb_from_camera: Floats
    spread: float
    own_spectrum: bool = False

    def covariance(self) -> Floats:
        """Covariance [2, 2] of (log R/G, log B/G) about those expected."""
        camera = self.spread**2 * np.array([[2.0, 1.0], [1.0, 2.0]])
        return camera if self.own_spectrum else np.asarray(camera + MODULE_COVARIANCE)

    def ratios(self, rgb: Floats) -> Floats:
        """Return (log R/G, log B/G) [..., 2] of working RGB [..., 3] in camera RGB, from those expected of the lamp."""
        camera = rgb @ np.linalg.inv(self.rgb_from_camera).T
        log = np.log(np.maximum(camera, 1e-9 * np.abs(camera).max(axis=-1, keepdims=True)) / self.camera_rgb)
        return np.asarray(log[..., [0, 2]] - log[..., 1:2])


@dataclass(frozen=True, slots=True)
class ExpectedForm:
    """The lamp's short and long side, and the largest distance between it and the chart, all in widths of the chart."""

    size: tuple[float, float] | None = None
    within: float | None = None


def white_rgb(xyz_from_rgb: Floats) -> Floats:
    """Return working RGB [3] of a perfect white in the light on the chart, after the chart's correction."""
    return np.asarray(np.linalg.solve(np.asarray(xyz_from_rgb, np.float64), D65_XYZ))


def student(away: Floats, covariance: Floats, freedom: float = 4.0) -> Floats:
    """Return the density of Student's t in two dimensions at `away` [..., 2] from its middle; `covariance` is its scale.

    Its tails are heavy: a chart under a lamp of three narrow bands makes a matrix that errs more than most.
    """
    squared = np.einsum("...i,ij,...j->...", away, np.linalg.inv(covariance), away)
    scale = 2 * np.pi * np.sqrt(np.linalg.det(covariance))
    return np.asarray((1 + squared / freedom) ** (-freedom / 2 - 1) / scale)
