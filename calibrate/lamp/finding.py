"""The search for the lamp: how likely each thing in the picture is it, or none of them, and the refusals where none will do."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.lamp.candidate import Candidate
from calibrate.lamp.evidence import log_odds
from calibrate.lamp.expected import ExpectedColour, ExpectedForm
from calibrate.lamp.reading import MOST_CLIPPED, MOST_REFLECTED, Image, Lamp, Mask, Points, read_region
from calibrate.lamp.reflected import doubts_of_mixing
from calibrate.lamp.regions import candidates, overlap

# Below these odds against there being no lamp in view nothing is taken.
_LEAST_ODDS: Final = 0.2
# From these odds on, against every other candidate and none together, a lamp is taken without a word.
SURE_ODDS: Final = 500.0
# Thinner than this, in pixels, blur and demosaicing reach the middle.
_THIN_PX: Final = 6.5
# A candidate of this probability is told of beside a better one.
_NOTABLE: Final = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class _Thing:
    """Candidates that overlap, told by the one that looks most like the lamp; `odds` against none."""

    look: Candidate
    odds: float

    @property
    def clipped(self) -> bool:
        return self.look.region.clipped > MOST_CLIPPED

    def place(self, offset: Points) -> str:
        x, y = self.look.region.polygon.mean(axis=0) - offset
        return f"({x:.0f}, {y:.0f})"


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
        If nothing looks like the module, or it is clipped in more than 30 % of its pixels.
    """
    chart = np.asarray(chart_corners, dtype=np.float64)
    width = image.shape[1]
    # The chart in the middle of a map, so that the seam is far from what stands beside it.
    shift = round(width / 2 - float(chart[:, 0].mean())) if latlong else 0
    seen = np.roll(image, shift, axis=1) if shift else image
    lost: Mask = np.asarray(~np.isfinite(seen).all(axis=2))
    if clipped is not None:
        lost = lost | np.roll(clipped, shift, axis=1)
    offset = np.array([float(shift), 0.0])
    to_xyz = np.asarray(xyz_from_rgb, dtype=np.float64)
    looks = candidates(seen, lost, chart + offset, to_xyz)
    known = form or ExpectedForm()
    things = _things(looks, to_xyz, expected, known)
    misplaced = expected is not None and (not things or things[0].odds < _LEAST_ODDS)
    if misplaced:
        # The camera may not be as published; then the lamp is looked for as with any camera, and never without a word.
        things = _things(looks, to_xyz, None, known)
    dim = bool(things) and float(things[0].look.xyz[1]) < MOST_REFLECTED
    if not things or things[0].odds < (1.0 if dim else _LEAST_ODDS):
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
    half = _at_half_level(best.look, looks)
    total = 1.0 + sum(thing.odds for thing in things)
    lamp = read_region(seen, half.region, xyz_from_rgb=xyz_from_rgb, clipped=lost, latlong=False)
    warnings = (
        lamp.warnings + _doubts_of_edges(half, offset) + _doubts(things, total, misplaced=misplaced, offset=offset)
    )
    warnings += doubts_of_mixing(replace(lamp, polygon=lamp.polygon - offset), to_xyz, None if misplaced else expected)
    return replace(
        lamp,
        polygon=lamp.polygon - offset,
        score=best.odds / total,
        runner_up=things[1].odds / total if len(things) > 1 else 0.0,
        warnings=warnings,
    )


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


def _doubts_of_edges(look: Candidate, offset: Points) -> tuple[str, ...]:
    """Return a warning if the thing taken is so thin that its surround mixes with all of it."""
    corners = look.region.polygon
    thin = 1 + float(min(np.hypot(*(corners[1] - corners[0])), np.hypot(*(corners[2] - corners[1]))))
    if thin >= _THIN_PX:
        return ()
    x, y = corners.mean(axis=0) - offset
    return (
        f"balance.lamp: the lamp at ({x:.0f}, {y:.0f}) is {thin:.1f} pixels thin, so that its surround mixes with all of it; "
        f"{_THIN_PX} are enough. Photograph it larger.",
    )


def _things(
    looks: list[Candidate], xyz_from_rgb: npt.NDArray[np.float64], expected: ExpectedColour | None, form: ExpectedForm
) -> list[_Thing]:
    """Return what does not overlap, the likeliest first."""
    things: list[_Thing] = []
    odds = np.exp([log_odds(look, xyz_from_rgb, expected, form) for look in looks])
    for n in np.argsort(-odds, kind="stable"):
        if odds[n] < 1e-4 * _LEAST_ODDS:
            break
        if not any(overlap(looks[n].region, thing.look.region) for thing in things):
            things.append(_Thing(looks[n], float(odds[n])))
    return things


def _doubts(things: list[_Thing], total: float, *, misplaced: bool, offset: Points) -> tuple[str, ...]:
    """Return what speaks against the thing taken: that it may be none, or another one, or one that is clipped."""
    best = things[0]
    against = (total - best.odds) / best.odds
    if not misplaced and against * SURE_ODDS <= 1:
        return ()
    remedy = "Look at the report; if it is something else, set `balance.lamp` to a rectangle inside the module."
    warnings: tuple[str, ...] = ()
    for other in things[1:]:
        if other.odds < _NOTABLE * best.odds:
            break
        looks_so = (
            f"is clipped in {other.look.region.clipped:.0%} of its pixels and may be"
            if other.clipped
            else "is likely to be"
        )
        warnings += (
            f"balance.lamp: another region, at {other.place(offset)}, {looks_so} the lamp with {other.odds / total:.0%}, the one taken, at "
            f"{best.place(offset)}, with {best.odds / total:.0%}. "
            + ("If it is, add a shorter exposure. " if other.clipped else "")
            + remedy,
        )
    if warnings and not misplaced:
        return warnings[:2]
    why = (
        "its colour is not where the camera's own matrix puts D65"
        if misplaced
        else (f"the odds for it are {1 / against:.2g} to 1 and {SURE_ODDS:.0f} to 1 is sure")
    )
    return (
        f"balance.lamp: what was taken, at {best.place(offset)}, may not be the lamp: {why}. {remedy} Its size and place "
        "(`balance.lamp: {size: …, within: …}`), if you state them, sharpen the odds.",
        *warnings[:1],
    )
