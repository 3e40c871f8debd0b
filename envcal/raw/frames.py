"""Frames of a bracket: read, checked, and kept in memory where there is room."""

import dataclasses
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from calibrate.exposure import LINEAR, FrameInfo
from envcal.errors import EnvcalError
from envcal.raw.described import described
from envcal.raw.exif import read_tags
from envcal.raw.opening import opened

Counts = npt.NDArray[np.uint16]

# Above the range of the bits only stray values are credible (a defect map, a marked row); more is another memory's.
_STRAY_SHARE = 0.01

# Of brackets up to this length all mosaics stay in memory after they were decoded to be checked, 2 bytes a photosite each.
# Longer ones are decoded again whenever they are asked for. Frames that may be moved are there twice while they are merged.
KEPT_MOSAICS, KEPT_IF_MOVED = 12, 9


def read_info(path: Path | str) -> FrameInfo:
    """Return what a RAW frame says about itself; the file is decoded once to see that it can be.

    Exposure time and aperture are EXIF's exact rationals where ExifRead understands the file, else LibRaw's; zero
    counts as missing. Levels are in the order of the positions of the pattern at the visible area's top left.

    Raises
    ------
    EnvcalError
        The file is missing, unreadable, damaged, empty, or no mosaic of integers.
    """
    return read_frame(path)[0]


def read_mosaic(path: Path | str) -> Counts:
    """Return the raw counts of the visible area: shape (height, columns), uint16, black not subtracted.

    Raises
    ------
    EnvcalError
        As `read_info`.
    """
    return read_frame(path)[1]


def read_frame(path: Path | str) -> tuple[FrameInfo, Counts]:
    """Return what a frame says about itself and its raw counts, from one decoding (see `read_info`, `read_mosaic`)."""
    path = Path(path)
    tags = read_tags(path)
    with opened(path, tags) as raw:
        info = described(path, raw, tags)
        visible = raw.raw_image_visible
        mosaic: Counts = visible[..., :3].reshape(info.height, info.columns) if info.cfa == LINEAR else visible.copy()
        mosaic = np.ascontiguousarray(mosaic)
        _refuse_empty(mosaic, info)
    return info, mosaic


class RawFrame:
    """A RAW file as a frame of a bracket: `info` is read once, `mosaic()` decodes anew unless `kept` holds the counts."""

    def __init__(self, path: Path | str, *, info: FrameInfo | None = None, kept: Counts | None = None) -> None:
        self.path = Path(path)
        self._kept = kept
        if info is not None:
            self.info = info

    def __repr__(self) -> str:
        return f"RawFrame({str(self.path)!r})"

    @cached_property
    def info(self) -> FrameInfo:
        """What the file says about itself (see `read_info`)."""
        return read_info(self.path)

    def mosaic(self) -> Counts:
        """Decode the file (see `read_mosaic`); not to be written to."""
        return read_mosaic(self.path) if self._kept is None else self._kept

    def described(self, **changed: Any) -> "RawFrame":
        """Return the same frame with parts of its `info` replaced."""
        return RawFrame(self.path, info=dataclasses.replace(self.info, **changed), kept=self._kept)


def open_bracket(paths: Sequence[Path], *, keep: int = KEPT_MOSAICS) -> list[RawFrame]:
    """Decode every file once, a few at a time, check it, and keep all mosaics in memory if they are no more than `keep`.

    Raises
    ------
    EnvcalError
        The mistakes of all files, a line each.
    """

    def frame_of(path: Path) -> RawFrame | EnvcalError:
        try:
            info, mosaic = read_frame(path)
        except EnvcalError as error:
            return error
        return RawFrame(path, info=info, kept=mosaic if len(paths) <= keep else None)

    # LibRaw lets go of the interpreter while it decodes; one more than two keeps both busy to the end. More would cost memory.
    with ThreadPoolExecutor(min(3, (os.cpu_count() or 1) + 1)) as pool:
        found = list(pool.map(frame_of, paths))
    mistakes = [str(f) for f in found if isinstance(f, EnvcalError)]
    if mistakes:
        raise EnvcalError("\n".join(mistakes))
    return [f for f in found if isinstance(f, RawFrame)]


def _refuse_empty(mosaic: Counts, info: FrameInfo) -> None:
    """Refuse a frame in which nothing was recorded, or something that cannot have been."""
    rows, columns = info.period
    places = [mosaic[k // columns :: rows, k % columns :: columns] for k in range(rows * columns)]
    # Nearly always the first of a thousand samples tell.
    if all(p[::31, ::31].max() <= b and p.max() <= b for p, b in zip(places, info.black_dn, strict=True)):
        raise EnvcalError(
            f"{info.name}: no sample above the black level {max(info.black_dn):g}; an exposed frame is expected. The "
            "file is damaged, or the lens was covered: copy it from the card again, or take it out of the bracket."
        )
    if mosaic[::31, ::31].min() == mosaic[::31, ::31].max() and mosaic.min() == mosaic.max() < min(info.white_dn):
        raise EnvcalError(
            f"{info.name}: every sample is {int(mosaic.max())}; a photograph has noise. The file is damaged: copy it from "
            "the card again, or take it out of the bracket."
        )
    if info.bits is not None:
        largest = 2**info.bits - 1
        # A share of one per cent shows in any sample of some thousands.
        some = mosaic[::7, ::7] if mosaic.size > 1 << 20 else mosaic
        stray = float(np.mean(some > largest)) if some.max() > largest else 0.0
        if stray > _STRAY_SHARE:
            raise EnvcalError(
                f"{info.name}: {stray:.0%} of the samples are above {largest}, the largest that its white level "
                f"{max(info.white_dn):g} allows. The file is damaged or its WhiteLevel wrong: copy it from the card "
                "again, or correct the tag."
            )
