"""Published colours of the ColorChecker Classic and Digital SG, adapted from the D50 of the data to D65.

The data are X-Rite's of before and after November 2014 (the pigments changed then), and for the Classic BabelColor's average of 30
charts and Danny Pascale's of 2005, as colour-science carries them: xyY under ICC D50, CIE 1931 2°. Passport, Mini and Nano
have the pigments of the Classic.

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
from calibrate.chart.geometry import CLASSIC, SG, Layout
from calibrate.difference import D65_XYZ

AFTER_2014: Final = "ColorChecker24 - After November 2014"
SG_AFTER_2014: Final = "ColorCheckerSG - After November 2014"
REFERENCE_NAMES: Final = (
    AFTER_2014,
    "ColorChecker24 - Before November 2014",
    "BabelColor Average",
    "ColorChecker 2005",
    SG_AFTER_2014,
    "ColorCheckerSG - Before November 2014",
)

# The largest Y a patch may have, and what part of the white patch's others have that are as white: an SG has seventeen.
_LARGEST_Y: Final = 1.05
_AS_WHITE: Final = 0.97


_LAYOUTS: Final = {layout.count: layout for layout in (CLASSIC, SG)}


@dataclass(frozen=True, slots=True)
class ChartReference:
    """A chart's colours: `names` [N] row by row (of a Classic from dark skin), and `XYZ` [N, 3] under D65.

    Y of a perfect white diffuser is 1; D65 is the chromaticity (0.3127, 0.3290) of the RGB standards. `published` if they are not
    those of this very chart. `wavelengths_nm` [W] and `reflectances` [N, W] where they were measured.
    """

    name: str
    names: tuple[str, ...]
    XYZ: npt.NDArray[np.float64]
    layout: Layout = CLASSIC
    published: bool = False
    wavelengths_nm: npt.NDArray[np.float64] | None = None
    reflectances: npt.NDArray[np.float64] | None = None


@functools.cache
def chart_reference(name: str = AFTER_2014) -> ChartReference:
    """Return the published colours of a chart (one of `REFERENCE_NAMES`)."""
    if name not in REFERENCE_NAMES:
        raise CalibrateError(
            f"correct.reference: {name!r} is no known chart; expected one of: {'; '.join(REFERENCE_NAMES)}. "
            f"Set `correct.reference: {AFTER_2014}`."
        )
    import colour

    chart = colour.CCS_COLOURCHECKERS[name]
    xyY = np.array([np.asarray(value, dtype=np.float64) for value in chart.data.values()])
    xyz = (
        np.column_stack([xyY[:, 0] / xyY[:, 1], np.ones(len(xyY)), (1 - xyY[:, 0] - xyY[:, 1]) / xyY[:, 1]])
        * xyY[:, 2:]
    )
    x, y = (float(value) for value in chart.illuminant)
    adapted = _under_d65(xyz, np.array([x / y, 1.0, (1 - x - y) / y]))
    names = tuple(key.split(" (")[0] for key in chart.data)
    return ChartReference(name=name, names=names, XYZ=adapted, layout=_LAYOUTS[len(names)], published=True)


def measured_reference(
    name: str,
    xyz: npt.NDArray[np.float64],
    *,
    white: npt.NDArray[np.float64],
    reflectances: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]] | None = None,
) -> ChartReference:
    """Return the reference of a chart whose patches were measured.

    `xyz` [24, 3] of a Classic row by row from dark skin, or [140, 3] of an SG from A1, B1 …; Y of a perfect white = 1, under a light of
    the XYZ `white` [3] (D50 for most instruments; D65 leaves them as they are). `reflectances`: wavelengths [W] in nm and values
    [N, W] that the XYZ were integrated from, to be kept with them.

    Raises
    ------
    CalibrateError
        If there are neither 24 nor 140 patches, one is no colour, or the white patch is not the brightest.
    """
    measured = np.asarray(xyz, dtype=np.float64)
    layout = _LAYOUTS.get(len(measured))
    if layout is None or measured.shape[1:] != (3,) or not np.isfinite(measured).all() or (measured[:, 1] <= 0).any():
        raise CalibrateError(
            f"correct.patches: {name}: values of shape {measured.shape}; expected finite XYZ with positive Y of 24 patches, row by "
            "row from dark skin to black, or of the 140 of an SG from A1, B1 to N10."
        )
    published = chart_reference(AFTER_2014 if layout is CLASSIC else SG_AFTER_2014)
    whites = published.XYZ[:, 1] > _AS_WHITE * published.XYZ[layout.white_patch, 1]
    brightest = int(measured[:, 1].argmax())
    if not whites[brightest] or measured[brightest, 1] > _LARGEST_Y:
        raise CalibrateError(
            f"correct.patches: {name}: patch {brightest + 1} is the brightest, Y = {measured[brightest, 1]:.3f}; expected "
            f"the {layout.white_patch + 1}th, {layout.white}, of Y between 0 and 1. Put the patches in order, row by row from "
            f"{layout.first}, and give Y of a perfect white as 100 or 1."
        )
    at, values = (None, None) if reflectances is None else reflectances
    return ChartReference(
        name=name,
        names=published.names,
        XYZ=_under_d65(measured, np.asarray(white)),
        layout=layout,
        wavelengths_nm=at,
        reflectances=values,
    )


def _under_d65(xyz: npt.NDArray[np.float64], white: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """XYZ [N, 3] under a light of XYZ `white` [3], adapted to D65 by the linear Bradford transform."""
    bradford = CONE_FROM_XYZ["Bradford"]
    gains = (bradford @ D65_XYZ) / (bradford @ white)
    adapted = np.asarray(xyz @ np.linalg.solve(bradford, gains[:, None] * bradford).T)
    adapted.setflags(write=False)
    return adapted
