"""Frames → one mosaic: described, measured, put in place, searched for what moved, merged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from envcal.config import MergeSettings
from envcal.reporter import Progress
from envcal.steps.merge.asked import asked_of, changes_of

if TYPE_CHECKING:
    from calibrate.align import Displacement
    from calibrate.deghost import Ghosts
    from calibrate.merge import Measured, Merged, MosaicFrame
    from envcal.raw import RawFrame


@dataclass(frozen=True, slots=True, eq=False)
class Bracket:
    """A merged bracket: what was measured of it, how its frames stood, the share of each that was left out."""

    merged: Merged
    measured: Measured
    displaced: Sequence[Displacement]
    left_out: Sequence[float] | None
    warnings: Sequence[str]


def opened(frames: Sequence[Path], settings: MergeSettings) -> list[RawFrame]:
    """Return the frames as files and settings describe them; mistakes of the whole bracket come at once."""
    from calibrate.exposure import check_bracket
    from envcal.raw import KEPT_IF_MOVED, KEPT_MOSAICS, open_bracket

    files = open_bracket(frames, keep=KEPT_IF_MOVED if settings.align else KEPT_MOSAICS)
    raws = [raw.described(**changes_of(raw.path.name, settings)) for raw in files]
    check_bracket([raw.info for raw in raws], mixed_iso=settings.mixed_iso, mixed_aperture=settings.mixed_aperture)
    return raws


def merged(raws: Sequence[RawFrame], settings: MergeSettings, progress: Progress) -> Bracket:
    """Measure and merge the frames."""
    from calibrate.merge import measure_bracket, merge_mosaics

    asked = asked_of(settings, raws)
    measured = measure_bracket(raws, asked)
    placed, displaced, moves = _placed(raws, measured, settings)
    if any(d.moved for d in displaced):
        measured = measure_bracket(placed, asked)
    ghosts = _ghosts(placed, measured, settings)
    done = merge_mosaics(
        placed,
        measured=measured,
        defects=settings.defects,
        mixed_iso=settings.mixed_iso,
        mixed_aperture=settings.mixed_aperture,
        deviation=settings.deviation,
        ghosts=None if ghosts is None else ghosts.masks,
        progress=progress,
    )
    left_out = None if ghosts is None else [float(share) for share in ghosts.shares]
    return Bracket(done, measured, displaced, left_out, [*moves, *done.warnings])


def _placed(
    raws: Sequence[RawFrame], measured: Measured, settings: MergeSettings
) -> tuple[Sequence[MosaicFrame], Sequence[Displacement], list[str]]:
    """Return the frames, moved where that proves a gain, how they stood, and what a person should know."""
    if not settings.align or len(raws) == 1:
        return raws, (), []
    from calibrate.align import FEWEST_TILES, AlignedFrame, find_displacements

    found = find_displacements(raws, measured.exposures)
    frames: list[MosaicFrame] = [
        AlignedFrame(raw, d.shift, e.clip) if d.moved else raw
        for raw, d, e in zip(raws, found, measured.exposures, strict=True)
    ]
    if not any(d.moved for d in found):
        return frames, found, []
    reach = max(float(np.hypot(*d.shift)) for d in found if d.moved)
    warnings = [
        f"{sum(d.moved for d in found)} of {len(raws)} frames were shifted by up to {reach:.1f} photosites, as `merge.align` "
        "asks. Use a tripod for the sharpest result."
    ]
    warnings += [
        f"{raw.info.name}: too little is seen in it and its neighbour alike to tell how it stands; it keeps its neighbour's "
        "place. Leave it out if edges are double."
        for raw, d in zip(raws, found, strict=True)
        if d.tiles < FEWEST_TILES and d.agreement < 1.0
    ]
    return frames, found, warnings


def _ghosts(frames: Sequence[MosaicFrame], measured: Measured, settings: MergeSettings) -> Ghosts | None:
    if not settings.deghost or len(frames) == 1:
        return None
    from calibrate.deghost import find_ghosts

    return find_ghosts(frames, measured.exposures)
