"""Where the counts of a frame begin and where they end, read from the counts themselves.

Clipped samples pile up on a plateau: one value where the converter ends, a narrow bump where the photosites fill
before it does. A bright surface that is not clipped makes a bump too, but one as wide as photon noise, many times the
widest plateau that is taken for one (0.5 % of the range); a surface without noise is told from a plateau by the next
shorter frame, in which clipped light goes on rising.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from calibrate.exposure import FrameInfo, Masked
from calibrate.merge.records import Counts, Float64

Indices = npt.NDArray[np.int64]

# Widths of a plateau that are tried, as shares of the range; the first that holds wins.
_WIDTHS = (0.0, 0.00025, 0.001, 0.0025, 0.005)

# A plateau is this many times as dense as the counts below it, and holds at least so many samples.
_CONTRAST = 12.0
_FEWEST = 50

# Fewer samples than this above everything else are strays (marked rows, a defect map).
_STRAYS = 20

# Of the plateau's samples, those that the shorter frame puts this far above it must be so many.
_BEYOND, _BEYOND_SHARE = 1.02, 0.3
_WITNESSES = 4096

# A plateau this near the file's level needs no witness: what is at stake is too little.
_NEAR = 0.02

# Nothing clips below this share of the range; a narrow heap of counts down there is darkness.
_LOWEST = 0.25

# Masked photosites: a mean further from the file's black than this share of the range was not made by darkness.
_MASKED_TOLERANCE = 0.01
_FEWEST_MASKED = 400


@dataclass(frozen=True, slots=True, eq=False)
class Plateau:
    """Clipped samples at one position of the pattern: where they begin, their mode, and some of them.

    `rows` and `columns` are the places of up to 4096 of them in the mosaic.
    """

    clip: float
    level: float
    count: int
    rows: Indices
    columns: Indices


def find_plateau(mosaic: Counts, position: tuple[int, int], period: tuple[int, int], *, span: float) -> Plateau | None:
    """Return the plateau of clipped samples at one position of the pattern, or None where the counts just fade out.

    Parameters
    ----------
    mosaic
        Shape (H, columns), uint16, raw counts.
    position
        Row and column within the pattern's `period`.
    span
        White − black as the file states them, raw counts.
    """
    plane = mosaic[position[0] :: period[0], position[1] :: period[1]]
    counts = _histogram(plane)
    from_top = np.cumsum(counts[::-1])[::-1]
    populated = np.flatnonzero(from_top >= min(_STRAYS, plane.size))
    if not len(populated):
        return None
    top = int(populated[-1])
    for width in (round(share * span) for share in _WIDTHS):
        low = top - width
        below = max(64, 3 * (width + 1))
        if low - below < 0:
            return None
        mass = int(from_top[low])
        density = (int(from_top[low - below]) - mass) / below
        if mass >= _FEWEST and mass / (width + 1) >= _CONTRAST * max(density, 1e-3):
            rows, columns = _witnesses(plane, low, mass)
            level = low + int(np.argmax(counts[low : top + 1]))
            return Plateau(
                float(low),
                float(level),
                mass,
                rows * period[0] + position[0],
                columns * period[1] + position[1],
            )
    return None


@njit(cache=True, error_model="numpy")
def _histogram(plane: Counts) -> Indices:  # pragma: no cover - compiled
    out = np.zeros(65536, np.int64)
    for y in range(plane.shape[0]):
        for x in range(plane.shape[1]):
            out[plane[y, x]] += 1
    return out


def _witnesses(plane: Counts, low: int, mass: int) -> tuple[Indices, Indices]:
    """Return the places of some of the `mass` samples from `low` on; of a large plateau, those in rows at even distances."""
    for apart in (max(1, mass // (8 * _WITNESSES)), 1):
        rows, columns = np.nonzero(plane[::apart] >= low)
        if len(rows) >= min(_FEWEST, mass):
            break
    step = max(1, len(rows) // _WITNESSES)
    return rows[::step] * apart, columns[::step]


def is_clipping(
    plateau: Plateau, shorter: Counts | None, *, black: float, shorter_black: float, white: float, ratio: float
) -> bool:
    """Return whether a plateau is clipped light rather than an even surface.

    Parameters
    ----------
    shorter
        The next shorter frame's mosaic, None if there is none.
    black, shorter_black, white
        Of this position, as the files state them.
    ratio
        Light in this frame over that in the shorter one, as well as it is known.
    """
    if plateau.level - black < _LOWEST * (white - black):
        return False
    near = abs(plateau.level / white - 1) <= _NEAR
    if shorter is None or near:
        return near
    seen = shorter[plateau.rows, plateau.columns].astype(np.float64) - shorter_black
    beyond = seen * ratio > _BEYOND * (plateau.level - black)
    return bool(beyond.mean() >= _BEYOND_SHARE)


def masked_black(
    strips: Sequence[Counts], period: tuple[int, int], black_dn: Sequence[float], white_dn: Sequence[float]
) -> Masked | None:
    """Return what masked photosites read, or None where the strips cannot be what they seem.

    The mean is that of the samples within 4 standard deviations of the median. Some cameras leave the border unfilled, or
    write other things there; so each position's mean must lie within 1 % of the range of the file's black.

    Parameters
    ----------
    strips
        Arrays of raw counts that begin at position (0, 0) of the pattern.
    black_dn, white_dn
        The file's levels by position.
    """
    means, spreads, counts = [], [], []
    for k in range(period[0] * period[1]):
        row, column = divmod(k, period[1])
        values = np.concatenate([s[row :: period[0], column :: period[1]].ravel() for s in strips])
        if len(values) < _FEWEST_MASKED:
            return None
        middle = float(np.median(values))
        spread = 1.4826 * float(np.median(np.abs(values - middle)))
        kept = values[np.abs(values - middle) <= 4.0 * max(spread, 1.0)]
        mean, reach = float(kept.mean()), _MASKED_TOLERANCE * (white_dn[k] - black_dn[k])
        if len(kept) < 0.9 * len(values) or abs(mean - black_dn[k]) > reach or kept.max() == kept.min():
            return None
        means.append(mean)
        spreads.append(float(kept.std()))
        counts.append(len(kept))
    return Masked(tuple(means), float(np.mean(spreads)), sum(counts))


def dark_levels(dark: Counts, info: FrameInfo) -> Float64:
    """Return black by position, shape (P,), from a frame exposed under a lens cap: the mean without outliers."""
    measured = masked_black([dark], info.period, info.black_dn, info.white_dn)
    return np.array(info.black_dn if measured is None else measured.black_dn)
