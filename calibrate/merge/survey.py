"""One look at every frame, from the longest to the shortest: a sample of its photosites, and where it clips."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.exposure import FrameInfo
from calibrate.merge.joint import Sites
from calibrate.merge.levels import Plateau, find_plateau, is_clipping
from calibrate.merge.records import Counts, Float64, MosaicFrame

# Photosites of all frames together that the fit looks at.
_SAMPLES = 300_000

# Clipping that starts this far below the file's level is worth a word.
_NOTABLE_CLIP = 0.01


@dataclass(slots=True)
class Levels:
    """The levels while they are being gathered; arrays are (N, P)."""

    black: Float64
    clip: Float64
    black_from: str = "file"
    clip_from: str = "file"
    warnings: list[str] = field(default_factory=list)


def black_groups(cfa: str) -> list[int]:
    """Return which black each position of a pattern has: its own in a 2×2, that of its colour in others."""
    return list(range(4)) if len(cfa) == 4 else [sorted(set(cfa)).index(c) for c in cfa]


def survey(
    frames: Sequence[MosaicFrame],
    infos: Sequence[FrameInfo],
    levels: Levels,
    light: Float64,
    *,
    plateaus: bool,
    progress: Callable[[int, int], None] | None,
) -> Sites:
    """Decode every frame once: a grid of photosites of each and, if asked, the `plateaus` of the longest of each ISO."""
    info = infos[0]
    height, columns, period = info.height, info.columns, info.period
    # A step without a common factor with any pattern visits all its positions.
    step = max(1, int((height * columns * len(frames) / _SAMPLES) ** 0.5))
    while math.gcd(step, 6) != 1:
        step += 1
    rows, across = np.arange(step // 2, height, step), np.arange(step // 2, columns, step)
    counts = np.empty((len(rows) * len(across), len(frames)), np.uint16)
    position = ((rows % period[0])[:, None] * period[1] + across % period[1]).ravel()
    tile = ((rows * 8 // height)[:, None] * 8 + across * 8 // columns).ravel()
    order = np.argsort(light.mean(axis=1), kind="stable")[::-1]
    looked: set[float] = set()
    pending: list[tuple[int, int, Plateau]] = []
    for done, k in enumerate(order):
        mosaic = decoded(frames[k])
        counts[:, k] = mosaic[np.ix_(rows, across)].ravel()
        for longer, p, plateau in pending:
            ratio = _rough_ratio(counts, position, p, longer, int(k), levels, light)
            _judge(levels, infos, longer, p, plateau, mosaic, ratio, int(k))
        pending = []
        iso = infos[k].iso or 100.0
        if plateaus and iso not in looked:
            span = float(np.mean(levels.clip[k] - levels.black[k]))
            for p in range(len(info.cfa)):
                found = find_plateau(mosaic, divmod(p, period[1]), period, span=span)
                if found is not None:
                    pending.append((int(k), p, found))
            looked.add(iso)
        del mosaic
        if progress:
            progress(done + 1, len(frames))
    for longer, p, plateau in pending:
        _judge(levels, infos, longer, p, plateau, None, 1.0, longer)
    return Sites(counts, position, np.array(black_groups(info.cfa))[position], tile)


def _rough_ratio(
    counts: Counts, position: npt.NDArray[np.int64], p: int, longer: int, shorter: int, levels: Levels, light: Float64
) -> float:
    """Return the light of one frame over another's from well exposed samples, or as told if there are none."""
    at = position == p
    high = counts[at, longer] - levels.black[longer, p]
    low = counts[at, shorter] - levels.black[shorter, p]
    span = levels.clip[longer, p] - levels.black[longer, p]
    good = (high > 0.1 * span) & (high < 0.6 * span) & (low > 0.002 * span)
    if good.sum() < 50:
        return float(light[longer, p] / light[shorter, p])
    return float(np.median(high[good] / low[good]))


def _judge(
    levels: Levels,
    infos: Sequence[FrameInfo],
    longer: int,
    p: int,
    plateau: Plateau,
    shorter: Counts | None,
    ratio: float,
    other: int,
) -> None:
    """Take a plateau's level for all frames of its ISO, or say why not."""
    info = infos[longer]
    white = info.white_dn[p]
    black, shorter_black = levels.black[longer, p], levels.black[other, p]
    if not is_clipping(plateau, shorter, black=black, shorter_black=shorter_black, white=white, ratio=ratio):
        return
    if plateau.clip > white:
        if plateau.level > white * (1 + _NOTABLE_CLIP) and p == 0:
            levels.warnings.append(
                f"{info.name}: samples clip at {plateau.level:g} counts, above the white level {white:g} of the file; the "
                f"file's level is used. If it is wrong, set `merge.white_level: {plateau.clip:g}`."
            )
        return
    for k, f in enumerate(infos):
        if (f.iso or 100.0) == (info.iso or 100.0):
            levels.clip[k, p] = min(levels.clip[k, p], plateau.clip)
    levels.clip_from = "data"
    if plateau.level < white * (1 - _NOTABLE_CLIP) and not any("clip at" in w for w in levels.warnings):
        levels.warnings.append(
            f"{info.name}: samples clip at {plateau.level:g} counts, below the white level {white:g} of the file; the "
            "lower level is used, so that highlights keep their colour. Nothing need be done; `merge.white_level` sets "
            "another."
        )


def decoded(frame: MosaicFrame) -> Counts:
    """Return a frame's mosaic; a `CalibrateError` if it is not what the frame announced."""
    raw, info = frame.mosaic(), frame.info
    if raw.shape != (info.height, info.columns) or raw.dtype != np.uint16:
        raise CalibrateError(
            f"{info.name}: mosaic of shape {raw.shape} and type {raw.dtype}; ({info.height}, {info.columns}) and uint16 "
            "are expected. The file may be damaged: copy it from the card again."
        )
    return raw
