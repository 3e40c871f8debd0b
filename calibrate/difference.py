"""Colour differences of a few colours: CIELAB and CIEDE2000.

CIELAB is CIE 15:2004; CIEDE2000 (Sharma, Wu and Dalal, "The CIEDE2000 Color-Difference Formula", 2005) is colour-science's.
Whole images are not its business.
"""

import numpy as np
import numpy.typing as npt

D65_XY = (0.3127, 0.3290)
D65_XYZ: npt.NDArray[np.float64] = np.array([D65_XY[0] / D65_XY[1], 1.0, (1.0 - sum(D65_XY)) / D65_XY[1]])
D65_XYZ.setflags(write=False)


def lab_from_xyz(xyz: npt.NDArray[np.float64], white_xyz: npt.NDArray[np.float64] = D65_XYZ) -> npt.NDArray[np.float64]:
    """Return CIELAB of `xyz` [..., 3] relative to `white_xyz` [3] (both with the same scale of Y).

    Negative values take the linear part of the curve, so a colour outside the spectrum locus keeps its order.
    """
    ratio = np.asarray(xyz, dtype=np.float64) / white_xyz
    curve = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio * (29 / 6) ** 2 / 3 + 4 / 29)
    x, y, z = curve[..., 0], curve[..., 1], curve[..., 2]
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def delta_e_2000(lab_1: npt.NDArray[np.float64], lab_2: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the CIEDE2000 difference [...] of two sets of CIELAB colours [..., 3], kL = kC = kH = 1."""
    from colour.difference import delta_E_CIE2000

    return np.asarray(delta_E_CIE2000(lab_1, lab_2), np.float64)
