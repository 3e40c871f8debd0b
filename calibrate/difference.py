"""Colour differences of a few colours: CIELAB and CIEDE2000 in plain numpy.

CIELAB is CIE 15:2004; CIEDE2000 is written from G. Sharma, W. Wu and E. N. Dalal, "The CIEDE2000 Color-Difference
Formula: Implementation Notes, Supplementary Test Data, and Mathematical Observations" (2005), equations 2-22.
It exists so that judging 24 patches does not import a colour library. Whole images are not its business.
"""

import numpy as np
import numpy.typing as npt

D65_XY = (0.3127, 0.3290)
D65_XYZ: npt.NDArray[np.float64] = np.array([D65_XY[0] / D65_XY[1], 1.0, (1.0 - sum(D65_XY)) / D65_XY[1]])
D65_XYZ.setflags(write=False)

_CHROMA_7 = 25.0**7


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
    L1, a1, b1 = np.moveaxis(np.asarray(lab_1, dtype=np.float64), -1, 0)
    L2, a2, b2 = np.moveaxis(np.asarray(lab_2, dtype=np.float64), -1, 0)
    c7 = ((np.hypot(a1, b1) + np.hypot(a2, b2)) / 2) ** 7
    stretch = 1 + 0.5 * (1 - np.sqrt(c7 / (c7 + _CHROMA_7)))
    C1, C2 = np.hypot(stretch * a1, b1), np.hypot(stretch * a2, b2)
    h1 = np.degrees(np.arctan2(b1, stretch * a1)) % 360
    h2 = np.degrees(np.arctan2(b2, stretch * a2)) % 360

    grey = C1 * C2 == 0
    turn = (h2 - h1 + 180) % 360 - 180
    # A difference of exactly 180° counts as +180° (equation 10); the modulo above says −180°.
    turn = np.where(grey, 0.0, np.where((turn == -180) & (h2 > h1), 180.0, turn))
    dL, dC, dH = L2 - L1, C2 - C1, 2 * np.sqrt(C1 * C2) * np.sin(np.radians(turn / 2))

    L, C = (L1 + L2) / 2, (C1 + C2) / 2
    far = np.abs(h1 - h2) > 180
    h = np.where(grey, h1 + h2, (h1 + h2 + np.where(far, np.where(h1 + h2 < 360, 360, -360), 0)) / 2)
    T = (
        1
        - 0.17 * np.cos(np.radians(h - 30))
        + 0.24 * np.cos(np.radians(2 * h))
        + 0.32 * np.cos(np.radians(3 * h + 6))
        - 0.20 * np.cos(np.radians(4 * h - 63))
    )
    rotation = -np.sin(np.radians(60 * np.exp(-(((h - 275) / 25) ** 2)))) * 2 * np.sqrt(C**7 / (C**7 + _CHROMA_7))
    tL = dL / (1 + 0.015 * (L - 50) ** 2 / np.sqrt(20 + (L - 50) ** 2))
    tC = dC / (1 + 0.045 * C)
    tH = dH / (1 + 0.015 * C * T)
    return np.asarray(np.sqrt(np.maximum(tL**2 + tC**2 + tH**2 + rotation * tC * tH, 0)))
