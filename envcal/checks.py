"""What can be known of the frames and of the output folder before anything runs."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

from envcal.config import Loaded
from envcal.errors import EnvcalError


def check_frames(loaded: Loaded) -> list[str]:
    """Return warnings about the brackets; an `EnvcalError` lists every mistake of every shot and of the output."""
    from calibrate import CalibrateError
    from calibrate.exposure import check_bracket
    from envcal.raw import read_info
    from envcal.steps.merge import changes_of, refuse_unknown_names

    warnings: list[str] = []
    mistakes = _unwritable(loaded.output)
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


def _unwritable(output: Path) -> list[str]:
    """The mistake if the output folder cannot be made or written."""
    standing = next(folder for folder in (output, *output.parents) if folder.exists())
    if not standing.is_dir():
        return [f"output: {standing} is a file; give the name of a folder."]
    if not os.access(standing, os.W_OK | os.X_OK):
        return [f"output: {standing} cannot be written. Choose another folder, or mend its permissions."]
    return []
