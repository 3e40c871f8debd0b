"""Published colours of the ColorChecker Classic 24, adapted from the D50 of the data to D65.

The data are X-Rite's of before and after November 2014 (the pigments changed then), BabelColor's average of 30 charts and
Danny Pascale's of 2005, as colour-science carries them: xyY under ICC D50, CIE 1931 2°.

The adaptation is the linear Bradford transform. It is meant to predict the patches' colours under D65, and of the
transforms at hand it does so best: for the 24 measured reflectances of BabelColor's average, integrated under
D50 and D65, mean CIEDE2000 between adapted and true colour is 0.56 (maximum 1.4) for Bradford, 0.66 for CAT02, 0.81
for CAT16, 1.04 for von Kries and 1.66 for XYZ scaling. (`adapt` has CAT16 as its default for another task: lights much
farther from D65.)
"""

import functools
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.adapt import CONE_FROM_XYZ
from calibrate.difference import D65_XYZ

AFTER_2014: Final = "ColorChecker24 - After November 2014"
REFERENCE_NAMES: Final = (
    AFTER_2014,
    "ColorChecker24 - Before November 2014",
    "BabelColor Average",
    "ColorChecker 2005",
)

# The patch "white 9.5", and the largest Y a patch may have.
_WHITE: Final = 18
_LARGEST_Y: Final = 1.05


@dataclass(frozen=True, slots=True)
class ChartReference:
    """A chart's published colours: `names` (24) row by row from dark skin, and `XYZ` [24, 3] under D65.

    Y of a perfect white diffuser is 1; D65 is the chromaticity (0.3127, 0.3290) of the RGB standards.
    """

    name: str
    names: tuple[str, ...]
    XYZ: npt.NDArray[np.float64]


@functools.cache
def chart_reference(name: str = AFTER_2014) -> ChartReference:
    """Return the published colours of an edition of the ColorChecker Classic 24 (one of `REFERENCE_NAMES`)."""
    if name not in REFERENCE_NAMES:
        raise CalibrateError(
            f"correct.reference: {name!r} is no known edition; expected one of: {'; '.join(REFERENCE_NAMES)}. "
            f"Set `correct.reference: {AFTER_2014}`."
        )
    import colour

    chart = colour.CCS_COLOURCHECKERS[name]
    xyY = np.array([np.asarray(value, dtype=np.float64) for value in chart.data.values()])
    xyz = np.column_stack([xyY[:, 0] / xyY[:, 1], np.ones(24), (1 - xyY[:, 0] - xyY[:, 1]) / xyY[:, 1]]) * xyY[:, 2:]
    x, y = (float(value) for value in chart.illuminant)
    adapted = _under_d65(xyz, np.array([x / y, 1.0, (1 - x - y) / y]))
    return ChartReference(name=name, names=tuple(key.split(" (")[0] for key in chart.data), XYZ=adapted)


def measured_reference(name: str, xyz: npt.NDArray[np.float64], *, white: npt.NDArray[np.float64]) -> ChartReference:
    """Return the reference of a chart whose patches were measured.

    `xyz` [24, 3] row by row from dark skin, Y of a perfect white = 1, under a light of the XYZ `white` [3] (D50 for most
    instruments; D65 leaves them as they are).

    Raises
    ------
    CalibrateError
        If there are not 24 patches, one is no colour, or the white patch (the 19th) is not the brightest.
    """
    measured = np.asarray(xyz, dtype=np.float64)
    if measured.shape != (24, 3) or not np.isfinite(measured).all() or (measured[:, 1] <= 0).any():
        raise CalibrateError(
            f"correct.patches: {name}: values of shape {measured.shape}; expected finite XYZ with positive Y of 24 patches, row by "
            "row from dark skin to black."
        )
    if measured[:, 1].argmax() != _WHITE or measured[:, 1].max() > _LARGEST_Y:
        raise CalibrateError(
            f"correct.patches: {name}: patch {measured[:, 1].argmax() + 1} is the brightest, Y = {measured[:, 1].max():.3f}; expected "
            "the 19th, white, of Y between 0 and 1. Put the patches in order, row by row from dark skin, and give Y of a "
            "perfect white as 100 or 1."
        )
    return ChartReference(name=name, names=chart_reference().names, XYZ=_under_d65(measured, np.asarray(white)))


def _under_d65(xyz: npt.NDArray[np.float64], white: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """XYZ [24, 3] under a light of XYZ `white` [3], adapted to D65 by the linear Bradford transform."""
    bradford = CONE_FROM_XYZ["Bradford"]
    gains = (bradford @ D65_XYZ) / (bradford @ white)
    adapted = np.asarray(xyz @ np.linalg.solve(bradford, gains[:, None] * bradford).T)
    adapted.setflags(write=False)
    return adapted
