"""What can be known of the frames before anything runs."""

from __future__ import annotations

import dataclasses

from envcal.config import Loaded
from envcal.errors import EnvcalError


def check_frames(loaded: Loaded) -> list[str]:
    """Return warnings about the brackets; an `EnvcalError` lists every mistake of every shot."""
    from calibrate import CalibrateError
    from calibrate.exposure import check_bracket
    from envcal.raw import read_info
    from envcal.steps.merge import changes_of, refuse_unknown_names

    warnings: list[str] = []
    mistakes: list[str] = []
    settings = loaded.settings.merge
    try:
        refuse_unknown_names(settings, loaded.shots)
    except EnvcalError as error:
        mistakes.append(str(error))
    for shot, frames in loaded.shots.items():
        infos = []
        for frame in frames:
            try:
                infos.append(dataclasses.replace(read_info(frame), **changes_of(frame.name, settings)))
            except EnvcalError as error:
                mistakes.append(str(error))
        try:
            warnings += (
                [
                    f"{shot}: {text}"
                    for text in check_bracket(
                        infos, mixed_iso=settings.mixed_iso, mixed_aperture=settings.mixed_aperture
                    )
                ]
                if infos
                else []
            )
        except CalibrateError as error:
            mistakes.append(str(error))
    if mistakes:
        raise EnvcalError("\n".join(mistakes))
    return warnings
