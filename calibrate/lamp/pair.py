"""The lamp alone: the difference of two pictures of one view, with the lamp on and off.

Light adds up, so the difference holds the lamp's light and nothing of the scene's, whatever the lamp's surface reflects
of that. It holds only if camera and scene stood still, which is checked on the rest of the picture (`stillness`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.lamp.reading import Image, Mask
from calibrate.lamp.stillness import Stillness, stillness

# Inside the lamp nothing changes by a fifth of a pixel; half a pixel is no tripod.
_NOTABLE_SHIFT_PX: Final = 0.2
_LARGEST_SHIFT_PX: Final = 0.5
# Of the scene's light. What reaches the reading is this times what the lamp's surface reflects over what it shines.
_NOTABLE_CHANGE: Final = 0.01
_LARGEST_CHANGE: Final = 0.03
# Share of the tiles that may have become darker by more than the largest change.
_MOST_DARKENED: Final = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class LampAlone:
    """The light of the lamp [H, W, 3] in camera RGB and its standard deviation [H, W, 3]; NaN where either picture is lost.

    `clipped` [H, W]: lost with the lamp on and not without it. `shift_px` (x, y) is how the camera moved, `change` how the scene's
    light changed (0.01: 1 % brighter with the lamp on), `darkened` the share of the picture that became darker.
    """

    light: Image
    sigma: Image
    clipped: Mask
    shift_px: tuple[float, float]
    change: float
    darkened: float
    warnings: tuple[str, ...] = ()


def lamp_alone(
    on: Image,
    off: Image,
    *,
    sigma_on: Image,
    sigma_off: Image,
    white_rgb: npt.NDArray[np.float64],
) -> LampAlone:
    """Return the difference of two pictures [H, W, 3] in linear camera RGB of one unit, after a check that all else is the same.

    Parameters
    ----------
    on, off
        Shape (H, W, 3). With the lamp on and off; NaN where lost.
    sigma_on, sigma_off
        Shape (H, W, 3). Their standard deviations.
    white_rgb
        Shape (3,). Camera RGB of something white in the scene's light, any scale.

    Raises
    ------
    CalibrateError
        If the sizes differ, too little is seen to check, the camera moved or the scene's light changed.
    """
    if on.shape != off.shape or sigma_on.shape != on.shape or sigma_off.shape != off.shape:
        raise CalibrateError(
            f"capture.lamp_off: a picture of {off.shape[1]}×{off.shape[0]} pixels; the reference has {on.shape[1]}×{on.shape[0]}. "
            "Photograph both brackets with one camera, from one tripod."
        )
    sigma = np.asarray(np.hypot(sigma_on, sigma_off), np.float32)
    still = stillness(on, off, sigma, white_rgb=white_rgb, notable_change=_LARGEST_CHANGE)
    warnings = _judged(still)
    lost_on, lost_off = (~np.isfinite(picture).all(axis=2) for picture in (on, off))
    return LampAlone(
        np.asarray(on - off, np.float32),
        sigma,
        np.asarray(lost_on & ~lost_off),
        still.shift_px,
        still.change,
        still.darkened,
        warnings,
    )


def _judged(still: Stillness) -> tuple[str, ...]:
    """Refuse what moved or changed too much; return warnings of what did notably."""
    moved = float(np.hypot(*still.shift_px))
    if moved > _LARGEST_SHIFT_PX:
        raise CalibrateError(
            f"capture.lamp_off: the camera moved by {moved:.1f} pixels between the brackets; at most {_LARGEST_SHIFT_PX} "
            "may be. Photograph both from a tripod without touching it, or leave `capture.lamp_off` out."
        )
    if abs(still.change) > _LARGEST_CHANGE or still.darkened > _MOST_DARKENED:
        raise CalibrateError(
            f"capture.lamp_off: with the lamp on, the scene's own light differs by {still.change:+.1%} from what it is without, and "
            f"{still.darkened:.0%} of the picture is darker by more than {_LARGEST_CHANGE:.0%} and noise (at most {_LARGEST_CHANGE:.0%}, and "
            f"{_MOST_DARKENED:.0%} of the picture). Photograph both brackets right after one another, in steady light and with "
            "nobody in view, or leave `capture.lamp_off` out."
        )
    warnings: tuple[str, ...] = ()
    if abs(still.change) > _NOTABLE_CHANGE:
        warnings += (
            f"capture.lamp_off: the scene's own light changed by {still.change:+.1%} between the brackets; up to {_NOTABLE_CHANGE:.0%} does "
            "no harm. Photograph both right after one another.",
        )
    if moved > _NOTABLE_SHIFT_PX:
        warnings += (
            f"capture.lamp_off: the camera moved by {moved:.2f} pixels between the brackets; up to {_NOTABLE_SHIFT_PX} does no "
            "harm. Use a tripod and a remote release.",
        )
    return warnings
