"""The search for the lamp: how likely each thing in the picture is it, or none of them, and the refusals where none will do."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.lamp.candidate import Candidate
from calibrate.lamp.doubts import (
    SURE_ODDS,
    SURE_ODDS_OF_UNKNOWN_CAMERA,
    Thing,
    doubts_of_edges,
    doubts_of_identity,
)
from calibrate.lamp.evidence import log_odds
from calibrate.lamp.expected import ExpectedColour, ExpectedForm
from calibrate.lamp.reading import MOST_CLIPPED, MOST_REFLECTED, Image, Lamp, Mask, Points, read_region
from calibrate.lamp.reflected import doubts_of_mixing
from calibrate.lamp.regions import candidates, overlap

# Below these odds against there being no lamp in view nothing is taken, and below even odds nothing dim.
_LEAST_ODDS: Final = 0.2
_LEAST_ODDS_OF_DIM: Final = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What stands out in a picture: the `image` [H, W, 3], shifted by `shift` pixels to the right so that the chart is far from its seam,
    what is `lost` [H, W] of it, and the candidates `looks`.
    """

    image: Image
    lost: Mask
    shift: int
    xyz_from_rgb: npt.NDArray[np.float64]
    looks: list[Candidate]


def look_around(
    image: Image,
    *,
    chart_corners: Points,
    xyz_from_rgb: npt.NDArray[np.float64],
    clipped: Mask | None = None,
    latlong: bool = False,
) -> View:
    """Return what stands out in `image` and may be the lamp; the parameters are those of `find_lamp`."""
    chart = np.asarray(chart_corners, dtype=np.float64)
    # The chart in the middle of a map, so that the seam is far from what stands beside it.
    shift = round(image.shape[1] / 2 - float(chart[:, 0].mean())) if latlong else 0
    seen = np.roll(image, shift, axis=1) if shift else image
    lost: Mask = np.asarray(~np.isfinite(seen).all(axis=2))
    if clipped is not None:
        lost = lost | np.roll(clipped, shift, axis=1)
    to_xyz = np.asarray(xyz_from_rgb, dtype=np.float64)
    return View(seen, lost, shift, to_xyz, candidates(seen, lost, chart + np.array([float(shift), 0.0]), to_xyz))


def find_lamp(
    image: Image,
    *,
    chart_corners: Points,
    xyz_from_rgb: npt.NDArray[np.float64],
    expected: ExpectedColour | None = None,
    form: ExpectedForm | None = None,
    clipped: Mask | None = None,
    latlong: bool = False,
) -> Lamp:
    """Return the D65 module in `image` [H, W, 3], corrected working RGB (1.0 = perfect white at the chart).

    Parameters
    ----------
    chart_corners
        Shape (4, 2), px. The chart itself is left out, and gives the scale of sizes and distances.
    xyz_from_rgb
        Shape (3, 3). The working space.
    expected
        The colour that the camera should see. Without it the lamp may have the colour of D65 seen from any light, as
        windows often do.
    form
        Its size and how near the chart it stands, as far as they are known.
    clipped
        Shape (H, W). Pixels that are clipped; NaN counts as clipped as well.
    latlong
        x wraps at the image's width.

    Raises
    ------
    CalibrateError
        If nothing looks like the module, or it is too dim, or clipped in more than 30 % of its pixels.
    """
    view = look_around(image, chart_corners=chart_corners, xyz_from_rgb=xyz_from_rgb, clipped=clipped, latlong=latlong)
    return choose_lamp(view, expected=expected, form=form)


def choose_lamp(view: View, *, expected: ExpectedColour | None = None, form: ExpectedForm | None = None) -> Lamp:
    """Return what of a view is likeliest the lamp; parameters and errors are those of `find_lamp`."""
    known, offset = form or ExpectedForm(), np.array([float(view.shift), 0.0])
    things = _things(view, expected, known)
    misplaced = expected is not None and (not things or things[0].odds < _LEAST_ODDS)
    if misplaced:
        # The camera may not be as published; then the lamp is looked for as with any camera, and never without a word.
        expected = None
        things = _things(view, None, known)
    best = _acceptable(things, offset)
    half = _at_half_level(best.look, view.looks)
    total = 1.0 + sum(thing.odds for thing in things)
    lamp = read_region(view.image, half.region, xyz_from_rgb=view.xyz_from_rgb, clipped=view.lost, latlong=False)
    lamp = replace(
        lamp,
        polygon=lamp.polygon - offset,
        score=best.odds / total,
        runner_up=things[1].odds / total if len(things) > 1 else 0.0,
    )
    sure_odds = SURE_ODDS_OF_UNKNOWN_CAMERA if expected is None else SURE_ODDS
    doubts = (
        *doubts_of_edges(lamp),
        *doubts_of_identity(things, total, sure_odds=sure_odds, misplaced=misplaced, form=known, offset=offset),
        *doubts_of_mixing(lamp, view.xyz_from_rgb, expected),
    )
    return replace(lamp, warnings=(*lamp.warnings, *doubts))


def _acceptable(things: list[Thing], offset: Points) -> Thing:
    """Return the likeliest thing, or refuse it."""
    dim = bool(things) and float(things[0].look.xyz[1]) < MOST_REFLECTED
    if not things or things[0].odds < (_LEAST_ODDS_OF_DIM if dim else _LEAST_ODDS):
        odds = things[0].odds if things else 0.0
        raise CalibrateError(
            "balance.lamp: no region looks like a D65 module (compact, of one colour, of that of D65 seen from another light, "
            f"brighter than its surround; best odds {odds:.2g} to 1, least {_LEAST_ODDS}). Set "
            "`balance.lamp: {rectangle: [x, y, width, height]}` to pixels inside the module."
        )
    best = things[0]
    if best.clipped:
        raise CalibrateError(
            f"balance.lamp: what looks like the lamp, at {best.place(offset)}, is clipped in {best.look.region.clipped:.0%} of its pixels; "
            f"at most {MOST_CLIPPED:.0%} may be. Add a shorter exposure to the bracket, or set "
            "`balance.lamp: {rectangle: [x, y, width, height]}` on another lamp of known colour."
        )
    if dim:
        raise CalibrateError(
            f"balance.lamp: what looks most like the lamp, at {best.place(offset)}, is {best.look.xyz[1]:.2g} times as bright as the "
            f"chart's white; expected at least {MOST_REFLECTED}, since an unlit surface may be as bright. Make the lamp brighter, or "
            "photograph the view with the lamp off too (`capture.lamp_off`)."
        )
    return best


def _things(view: View, expected: ExpectedColour | None, form: ExpectedForm) -> list[Thing]:
    """Return what does not overlap, the likeliest first."""
    things: list[Thing] = []
    odds = np.exp([log_odds(look, view.xyz_from_rgb, expected, form) for look in view.looks])
    for n in np.argsort(-odds, kind="stable"):
        if odds[n] < 1e-4 * _LEAST_ODDS:
            break
        if not any(overlap(view.looks[n].region, thing.look.region) for thing in things):
            things.append(Thing(view.looks[n], float(odds[n])))
    return things


def _at_half_level(best: Candidate, looks: list[Candidate]) -> Candidate:
    """Return of all that overlaps the thing taken what ends where it is half as bright: that is where its edge is."""
    same = [
        look
        for look in looks
        if look.region.clipped <= MOST_CLIPPED
        and look.thick * look.long <= 1.5 * best.thick * best.long
        and overlap(look.region, best.region)
    ]
    return min(same, key=lambda look: abs(float(np.log(2 * look.level / best.xyz[1]))))
