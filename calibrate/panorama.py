"""Shots to one lat-long map: a single lat-long shot passes through.

Joining several overlapping shots is not done here, and is refused rather than guessed.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError


def latlong_from_shots(shots: Sequence[npt.NDArray[np.float32]]) -> npt.NDArray[np.float32]:
    """Return the lat-long map [H, 2H, 3] that `shots` show.

    One shot of 2:1 is that map, and comes back unchanged (the same array). Row 0 is the zenith; the centre looks
    along −Z. Anything else raises CalibrateError.
    """
    if len(shots) != 1:
        raise CalibrateError(
            f"capture.environment: {len(shots)} shots; expected exactly one lat-long shot, as shots cannot be joined "
            "yet. Stitch them outside and name the one lat-long result, or omit `capture.environment` if the reference shot "
            "is the map."
        )
    shot = shots[0]
    if shot.ndim != 3 or shot.shape[2] != 3:
        raise CalibrateError(
            f"capture.environment: a shot of shape {shot.shape}; expected (height, width, 3). Pass linear RGB."
        )
    height, width = shot.shape[:2]
    if width != 2 * height:
        raise CalibrateError(
            f"capture.environment: a shot of {width}×{height} pixels; a lat-long map is exactly twice as wide as high "
            f"({2 * height}×{height}). Remap it to lat-long outside, or crop the borders a stitcher has left."
        )
    return shot
