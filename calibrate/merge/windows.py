"""The bracket in the order in which it is weighed: windows of rows that fit into memory, bands of them that fit a cache."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calibrate.merge.records import Counts, Exposure, MosaicFrame, Plane
from calibrate.merge.survey import decoded
from calibrate.merge.weights import weigh

# So many mosaics at most are in memory as a whole: 24 bytes a photosite. Longer brackets are weighed in windows of rows, for
# each of which every frame is decoded again.
MOSAICS_AT_ONCE = 12

# Rows that are weighed at a time: a multiple of the height of every pattern, and of the 2×2 of the ghosts' masks.
_BAND = 48

Skip = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """Radiance and its inverse variance, (H, columns) float32; by frame: samples clipped and used, part in the result."""

    mosaic: Plane
    weights: Plane
    clipped: tuple[int, ...]
    used: tuple[int, ...]
    shares: tuple[float, ...]


def weigh_bracket(
    frames: Sequence[MosaicFrame],
    exposures: Sequence[Exposure],
    skips: Sequence[Skip] | None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Weighed:
    """Return the inverse-variance mean of frames that go from the shortest to the longest exposure.

    `skips` has a mask a frame, (⌈H/2⌉, ⌈columns/2⌉), not 0 where a 2×2 of it is left out. `progress` is called with (bands
    done, bands).
    """
    info, n = frames[0].info, len(frames)
    shape = info.height, info.columns
    levels = _stacked(exposures)
    mosaic, weights = np.empty(shape, np.float32), np.empty(shape, np.float32)
    clipped, used = np.zeros((shape[0], n), np.int64), np.zeros((shape[0], n), np.int64)
    shares = np.zeros((shape[0], n))
    band = np.empty((n, min(_BAND, shape[0]), shape[1]), np.uint16)
    bands = -(-shape[0] // _BAND)
    for first, mosaics in _windows(frames):
        end = first + len(mosaics[0])
        for top in range(first, end, _BAND):
            rows = np.s_[top : min(top + _BAND, end)]
            count = rows.stop - rows.start
            for k in range(n):
                band[k, :count] = mosaics[k][top - first : top - first + count]
            left_out = np.zeros((0, 0, 0), np.uint8)
            if skips is not None:
                left_out = np.stack([s[top // 2 : (rows.stop + 1) // 2] for s in skips])
            weigh(
                band[:, :count], left_out, top, info.period[1], *levels, mosaic[rows], weights[rows], clipped[rows],
                used[rows], shares[rows],
            )  # fmt: skip
            if progress:
                progress(top // _BAND + 1, bands)
    parts = shares.sum(axis=0)
    return Weighed(
        mosaic,
        weights,
        tuple(int(v) for v in clipped.sum(axis=0)),
        tuple(int(v) for v in used.sum(axis=0)),
        tuple(float(v) for v in parts / max(float(parts.sum()), 1e-300)),
    )


def _windows(frames: Sequence[MosaicFrame]) -> Iterator[tuple[int, list[Counts]]]:
    """Yield (first row, rows of every frame) from the top; the list is emptied before the next is filled."""
    height = frames[0].info.height
    if len(frames) <= MOSAICS_AT_ONCE:
        yield 0, [decoded(frame) for frame in frames]
        return
    rows = max(height * MOSAICS_AT_ONCE // len(frames) // _BAND, 1) * _BAND
    for first in range(0, height, rows):
        mosaics = [decoded(frame)[first : first + rows].copy() for frame in frames]
        yield first, mosaics
        mosaics.clear()


def _stacked(exposures: Sequence[Exposure]) -> tuple[Plane, ...]:
    """Return black, clipping level, one count, light, and the variance of a sample by radiance and without light, (N, P) each."""
    black, clip, span, light = (
        np.array([getattr(e, name) for e in exposures]) for name in ("black", "clip", "span", "light")
    )
    electrons = np.array([e.gain_e_per_dn for e in exposures])[:, None] * span
    read = (np.array([e.read_noise_e for e in exposures])[:, None] / electrons) ** 2
    return tuple(a.astype(np.float32) for a in (black, clip, 1.0 / span, light, light / electrons, read))
