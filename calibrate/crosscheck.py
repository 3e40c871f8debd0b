"""What a second chart says of a fit to the first: a test on patches that the fit has not seen.

The second chart is taken through the matrix of the first. A chart in the same light, of the same kind, then reads its
published colours, but for how bright the light on it is and how that falls off. If another light falls on it, its greys have
the colour of that light, seen from the first one's. Both are estimated and taken out in turn: what is left tells whether
the charts agree.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.adapt import CONE_FROM_XYZ
from calibrate.correct import ColourFit, root_terms
from calibrate.difference import D65_XYZ, delta_e_2000, lab_from_xyz

if TYPE_CHECKING:
    from calibrate.chart.reference import ChartReference

# Distance in u'v' from which on two lights are two: 300 K at 6500 K. Greys of charts differ by a third of it.
_ANOTHER_LIGHT: Final = 0.004
# By so much (CIEDE2000) may the second chart read worse than the first, which the matrix was fitted to.
_DISAGREES: Final = 3.0
# Darker patches say little of the light.
_DARKEST: Final = 0.05


@dataclass(frozen=True, slots=True)
class ChartCheck:
    """A second chart under the fit of the first.

    `delta_e`: mean CIEDE2000 of its patches, the brightness of its light and the fall-off taken out; `delta_e_balanced`: the
    colour of its light, too. `level`: how bright its light is relative to the first chart's; `light_uv`: how far apart the two
    are in u'v'. `another_light`, `disagrees`: the verdicts.
    """

    delta_e: float
    delta_e_balanced: float
    level: float
    light_uv: float
    another_light: bool
    disagrees: bool


def check_chart(
    camera_rgb: npt.NDArray[np.float64],
    fit: ColourFit,
    reference: "ChartReference",
    *,
    rgb_from_xyz: npt.NDArray[np.float64],
) -> ChartCheck:
    """Return what another chart's patches `camera_rgb` [N, 3], in the units of those fitted, say of a `fit`.

    Raises
    ------
    CalibrateError
        If the patches are not those of the reference, are not finite, or its greys are dark under the fit.
    """
    camera = np.asarray(camera_rgb, dtype=np.float64)
    published = np.asarray(reference.XYZ, dtype=np.float64)
    if camera.shape != published.shape or not np.isfinite(camera).all():
        raise CalibrateError(
            f"correct.chart: a further chart of shape {camera.shape}; expected finite camera RGB {published.shape}, one row a "
            "patch. Measure all its patches."
        )
    terms = camera if fit.model == "linear" else root_terms(camera)
    seen = terms @ np.linalg.solve(np.asarray(rgb_from_xyz, dtype=np.float64), fit.matrix).T
    greys = [k for k in reference.layout.neutrals if published[k, 1] > _DARKEST]
    if (seen[greys] <= 0).any():
        raise CalibrateError(
            "correct.chart: the greys of a further chart are not positive under the matrix of the first one; expected a chart in "
            "the same picture. Give the corners of the right one in `correct.chart`."
        )
    # Geometric means: a fall-off that is symmetric about the middle changes nothing.
    light = D65_XYZ * np.exp(np.log(seen[greys] / published[greys]).mean(axis=0))
    level = float(light[1])
    apart = float(np.linalg.norm(_uv(light) - _uv(D65_XYZ)))
    lab = lab_from_xyz(published)
    differences = []
    bradford = CONE_FROM_XYZ["Bradford"]
    gains = (bradford @ D65_XYZ) / (bradford @ light)
    balanced = seen @ np.linalg.solve(bradford, gains[:, None] * bradford).T
    for xyz in (seen / level, balanced):
        even = xyz / _fall_off(xyz, published, reference.layout.places)[:, None]
        differences.append(float(delta_e_2000(lab_from_xyz(even), lab).mean()))
    return ChartCheck(
        delta_e=differences[0],
        delta_e_balanced=differences[1],
        level=level,
        light_uv=apart,
        another_light=apart > _ANOTHER_LIGHT,
        disagrees=differences[1] > float(fit.delta_e.mean()) + _DISAGREES,
    )


def _fall_off(
    xyz: npt.NDArray[np.float64], published: npt.NDArray[np.float64], places: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """The light on each patch [N] as exp of a plane in the logarithm of the luminance."""
    used = (published[:, 1] > _DARKEST) & (xyz[:, 1] > 0)
    terms = np.column_stack([np.ones(len(places)), places])
    ratio = np.log(xyz[used, 1] / published[used, 1])
    weight = np.ones(len(ratio))
    plane = np.zeros(3)
    for _ in range(5):  # towards least absolute differences: a spot of glare is no fall-off
        plane = np.linalg.lstsq(terms[used] * weight[:, None], ratio * weight, rcond=None)[0]
        weight = 1 / np.sqrt(np.maximum(np.abs(ratio - terms[used] @ plane), 0.01))
    return np.asarray(np.exp(terms @ plane))


def _uv(xyz: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """CIE 1976 u', v'."""
    x, y, z = xyz
    return np.asarray(np.array([4 * x, 9 * y]) / (x + 15 * y + 3 * z))
