"""The colours a D65 lamp can have in a picture that was balanced for another light."""

import functools

import numpy as np
import numpy.typing as npt

from calibrate.adapt import CONE_FROM_XYZ
from calibrate.difference import D65_XYZ


@functools.cache
def adapted_d65_curve() -> npt.NDArray[np.float64]:
    """Return u'v' [N, 2] of D65 as it looks after a light of 1800–12000 K has been adapted to D65.

    Planckian radiators below 4000 K (B. Kim et al., US patent 7024034, cubic fits), CIE daylight above; the
    adaptation is CAT16. Spaced by 10 mired.
    """
    mired = np.arange(1e6 / 12000, 1e6 / 1800, 10.0)
    t = 1e6 / mired
    planck_x = -0.2661239e9 / t**3 - 0.2343589e6 / t**2 + 0.8776956e3 / t + 0.179910
    warm, x2, x3 = t < 2222, planck_x**2, planck_x**3
    planck_y = np.where(
        warm,
        -1.1063814 * x3 - 1.34811020 * x2 + 2.18555832 * planck_x - 0.20219683,
        -0.9549476 * x3 - 1.37418593 * x2 + 2.09137015 * planck_x - 0.16748867,
    )
    low = 0.244063 + 0.09911e3 / t + 2.9678e6 / t**2 - 4.6070e9 / t**3
    high = 0.237040 + 0.24748e3 / t + 1.9018e6 / t**2 - 2.0064e9 / t**3
    day_x = np.where(t <= 7000, low, high)
    day_y = -3.0 * day_x**2 + 2.870 * day_x - 0.275
    x, y = np.where(t < 4000, planck_x, day_x), np.where(t < 4000, planck_y, day_y)
    lights = np.stack([x / y, np.ones_like(x), (1 - x - y) / y], axis=-1)
    cones = CONE_FROM_XYZ["CAT16"]
    white = cones @ D65_XYZ
    seen = (white**2 / (lights @ cones.T)) @ np.linalg.inv(cones).T
    curve = uv_from_xyz(seen)
    curve.setflags(write=False)
    return curve


def uv_from_xyz(xyz: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return CIE 1976 u'v' [..., 2] of XYZ [..., 3]."""
    x, y, z = np.moveaxis(xyz, -1, 0)
    total = np.maximum(x + 15 * y + 3 * z, 1e-12)
    return np.stack([4 * x / total, 9 * y / total], axis=-1)
