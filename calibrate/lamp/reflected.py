"""How much of what a lamp shows may be light of the scene that its surface reflects, and what that does to its colour."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from calibrate.difference import D65_XYZ
from calibrate.lamp.curve import uv_from_xyz
from calibrate.lamp.expected import ExpectedColour, student, white_rgb
from calibrate.lamp.reading import MOST_REFLECTED, Lamp

# Error of u'v' by reflected light. 0.01 is a tenth of the way from D65 to the colour of tungsten light; the rest is left to
# the reading's own error.
_MIXED: Final = 0.008
# The bound holds with this probability, if the camera is as stated and every reflectance as likely as another.
_CONFIDENCE: Final = 0.99


@dataclass(frozen=True, slots=True)
class Reflected:
    """Bounds: the `share` of a lamp's luminance that may be reflected, and its u'v' `shift` (infinite if all may be)."""

    share: float
    shift: float


def most_reflected(
    rgb: npt.NDArray[np.float64], xyz_from_rgb: npt.NDArray[np.float64], expected: ExpectedColour | None
) -> Reflected:
    """Return how much of working RGB [3] of a lamp, chart white 1, may be reflected light of the scene.

    A surface that reflects 80 % of the light on the chart is the bound. Where the lamp's own colour is known to some
    accuracy, reflectances that would leave it another one are unlikely: then it is the quantile of the posterior of a reflectance
    that was even between 0 and 0.8 before.
    """
    white = white_rgb(xyz_from_rgb)
    to_xyz = np.asarray(xyz_from_rgb, np.float64)
    luminance = float(to_xyz[1] @ rgb)
    most = MOST_REFLECTED
    if expected is not None:
        tried = np.linspace(0.0, min(MOST_REFLECTED, 0.99 * luminance), 200)
        own = rgb - tried[:, None] * white
        likely = student(expected.ratios(own), expected.covariance())
        below = np.cumsum(likely) / likely.sum()
        most = float(tried[np.searchsorted(below, _CONFIDENCE)])
    own_xyz = to_xyz @ rgb - most * D65_XYZ
    shift = (
        float(np.hypot(*(uv_from_xyz(to_xyz @ rgb) - uv_from_xyz(own_xyz)))) if (own_xyz > 0).all() else float("inf")
    )
    return Reflected(min(1.0, most / luminance), shift)


def doubts_of_mixing(
    lamp: Lamp, xyz_from_rgb: npt.NDArray[np.float64], expected: ExpectedColour | None
) -> tuple[str, ...]:
    """Return a warning if light of the scene that the lamp may reflect could shift its colour."""
    bound = most_reflected(lamp.rgb, xyz_from_rgb, expected)
    if bound.shift <= _MIXED:
        return ()
    x, y = lamp.polygon.mean(axis=0)
    luminance = float(np.asarray(xyz_from_rgb, np.float64)[1] @ lamp.rgb)
    error = (
        f"its u'v' off by up to {bound.shift:.3f}"
        if np.isfinite(bound.shift)
        else "its colour that of the scene's light"
    )
    by_colour = "" if expected is None else ", going by its colour,"
    return (
        f"balance.lamp: the lamp at ({x:.0f}, {y:.0f}) is {luminance:.2g} times as bright as the chart's white, so{by_colour} up to "
        f"{bound.share:.0%} of what it shows may be light of the scene that it reflects, and {error} (up to {_MIXED} does no harm). "
        "Make it brighter or shade it, or photograph the view with the lamp off too (`capture.lamp_off`).",
    )
