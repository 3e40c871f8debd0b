"""What speaks against the thing that was taken for the lamp: others, that there may be none, and its edges."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from calibrate.lamp.candidate import Candidate
from calibrate.lamp.expected import ExpectedForm
from calibrate.lamp.reading import MOST_CLIPPED, Lamp, Points

# From these odds on, against every other candidate and none together, a lamp is taken without a word. In 346 synthetic scenes, a third
# of them without a lamp, no wrong thing had better ones than 230.
SURE_ODDS: Final = 500.0
# Where the camera is not known, daylight in windows and on screens has the colour as often as not.
SURE_ODDS_OF_UNKNOWN_CAMERA: Final = 10 * SURE_ODDS
# Thinner than this, in pixels, blur and demosaicing reach the middle.
_THIN_PX: Final = 6.5
# A candidate of this share of the best one's odds is told of.
_NOTABLE: Final = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Thing:
    """Candidates that overlap, told by the one that looks most like the lamp; `odds` against none."""

    look: Candidate
    odds: float

    @property
    def clipped(self) -> bool:
        return self.look.region.clipped > MOST_CLIPPED

    def place(self, offset: Points) -> str:
        x, y = self.look.region.polygon.mean(axis=0) - offset
        return f"({x:.0f}, {y:.0f})"


def doubts_of_identity(
    things: list[Thing], total: float, *, sure_odds: float, misplaced: bool, form: ExpectedForm, offset: Points
) -> tuple[str, ...]:
    """Return what speaks against the thing taken: that it may be none, or another one, or one that is clipped.

    `total` is the odds of all things and of none together; `misplaced`: the lamp's colour had to be left out of account.
    """
    best = things[0]
    against = (total - best.odds) / best.odds
    if not misplaced and against * sure_odds <= 1:
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
        else f"the odds for it are {1 / against:.3g} to 1 and {sure_odds:.0f} to 1 is sure"
    )
    stating = (
        " Its size and place (`balance.lamp: {size: …, within: …}`), if you state them, sharpen the odds."
        if form.size is None or form.within is None
        else ""
    )
    return (
        f"balance.lamp: what was taken, at {best.place(offset)}, may not be the lamp: {why}. {remedy}{stating}",
        *warnings[:1],
    )


def doubts_of_edges(lamp: Lamp) -> tuple[str, ...]:
    """Return a warning if a lamp is so thin that its surround mixes with all of it."""
    corners = lamp.polygon
    thin = 1 + float(min(np.hypot(*(corners[1] - corners[0])), np.hypot(*(corners[2] - corners[1]))))
    if thin >= _THIN_PX:
        return ()
    x, y = corners.mean(axis=0)
    return (
        f"balance.lamp: the lamp at ({x:.0f}, {y:.0f}) is {thin:.1f} pixels thin, so that its surround mixes with all of it; "
        f"{_THIN_PX} are enough. Photograph it larger.",
    )
