"""What can be known of the frames before anything runs."""

from __future__ import annotations

from envcal.config import Loaded
from envcal.errors import EnvcalError


def check_frames(loaded: Loaded) -> list[str]:
    """Return warnings about the brackets; an `EnvcalError` lists every mistake of every shot."""
    from calibrate import CalibrateError
    from calibrate.exposure import check_bracket
    from envcal.raw import read_info

    warnings: list[str] = []
    mistakes: list[str] = []
    for shot, frames in loaded.shots.items():
        infos = []
        for frame in frames:
            try:
                infos.append(read_info(frame))
            except EnvcalError as error:
                mistakes.append(str(error))
        try:
            warnings += (
                [f"{shot}: {text}" for text in check_bracket(infos, mixed_iso=loaded.settings.merge.mixed_iso)]
                if infos
                else []
            )
        except CalibrateError as error:
            mistakes.append(str(error))
    if mistakes:
        raise EnvcalError("\n".join(mistakes))
    return warnings
