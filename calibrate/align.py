"""Frames that were not taken from quite the same place: found by their shift, and put in place, in the mosaic.

Two frames that are neighbours in exposure are compared on the means of 2×2 photosites, in the range that both see, in a
logarithmic scale. Phase correlation gives the whole shift to a few photosites (Kuglin and Hines 1975); in a grid of tiles it
is then refined by least squares on the gradients (Lucas and Kanade 1981), and the median of the tiles is taken. A frame is
moved only if that proves a gain: most tiles agree on the shift, it is larger than 0.12 photosites, and it makes the
difference of the frames smaller by a tenth. What moves in the scene, clouds or people, moves some tiles and not the median.

A mosaic is shifted by an even number of photosites, which keeps its colours, and the rest by Catmull and Rom's cubic within
each colour's own grid. A sample that leans on a clipped one, or on one outside, counts as clipped.

Left out: rotation, change of focal length, parallax, rolling shutter; 6×6 patterns and linear frames.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit, prange

from calibrate import CalibrateError
from calibrate.exposure import BAYER_PATTERNS, MONOCHROME, FrameInfo
from calibrate.merge.quads import quads_of
from calibrate.merge.records import Counts, Exposure, Float64, MosaicFrame, Plane
from calibrate.merge.survey import decoded

Shift = tuple[float, float]

# All lengths here are in means of 2×2, half the scale of the photosites, unless they say otherwise.
_TILES, _TILE = 5, 160
_BLUR = 1.0
_COARSE = 768
_STEPS = 12

# A tile speaks if it knows its shift this well; enough tiles must speak, and so many of them agree this closely.
_KNOWN, FEWEST_TILES, _AGREE, _AGREEING = 0.05, 4, 0.2, 0.6

# A shift is worth it from here on, and if the frames differ less by this share after it.
_SMALLEST, _GAIN = 0.06, 0.1

# Frames of one scene share its fine structure. A tile tells where both frames have some, of this standard deviation (logarithm;
# noise has less, see `_seen`), and agrees from this correlation on; chance reaches a tenth of it. So many tiles must tell, and so
# many of them agree.
_FINE, _STRUCTURE, _ALIKE, _TELLING, _IN_COMMON = 4.0, 0.06, 0.4, 4, 0.2

# Photosites: a remainder below this is not interpolated.
_NEGLIGIBLE = 0.02

_NOWHERE = np.uint16(65535)


@dataclass(frozen=True, slots=True)
class Displacement:
    """How a frame stands against the reference: `shift` (rows, columns) in photosites, applied only if `moved`.

    `tiles` is how many spoke, `agreement` the share of them that agrees, `gain` by what share the difference to its
    neighbour in exposure gets smaller.
    """

    shift: Shift
    moved: bool
    tiles: int
    agreement: float
    gain: float


class AlignedFrame:
    """A frame of which sample (y, x) shows what the frame shows at (y + rows, x + columns)."""

    def __init__(self, frame: MosaicFrame, shift: Shift, clip: Float64) -> None:
        self._frame, self._shift, self._clip = frame, shift, clip

    @property
    def info(self) -> FrameInfo:
        """What the frame says about itself; its masked border is not moved."""
        return self._frame.info

    def mosaic(self) -> Counts:
        """Decode and move: counts of the same type, the largest number where nothing is known."""
        return shifted(self._frame.mosaic(), self._shift, clip=self._clip, step=self.info.period[0])


def find_displacements(frames: Sequence[MosaicFrame], exposures: Sequence[Exposure]) -> tuple[Displacement, ...]:
    """Return how each frame stands against the middle one by exposure; each frame is decoded once.

    Raises
    ------
    CalibrateError
        Frames that are no Bayer or monochrome mosaics, too small to tell, or of different scenes.
    """
    info = frames[0].info
    if info.cfa not in (*BAYER_PATTERNS, MONOCHROME):
        raise CalibrateError(
            f"{info.name}: frames with this pattern cannot be aligned; Bayer and monochrome mosaics can. Set `merge.align: "
            "false`."
        )
    if min(info.height, info.width) < 4 * _TILE // 5:
        raise CalibrateError(
            f"{info.name}: {info.width}×{info.height} photosites; at least {4 * _TILE // 5} a side are needed to align. Set "
            "`merge.align: false`."
        )
    order = sorted(range(len(frames)), key=lambda k: (float(exposures[k].light.mean()), frames[k].info.name))
    links: dict[tuple[int, int], _Link] = {}
    before: tuple[int, Plane, float, float] | None = None
    for k in order:
        e = exposures[k]
        image, low, high = _seen(frames[k], e)
        if before is not None:
            links[before[0], k] = _compare(before[1], image, low=before[2], high=high)
        before = k, image, low, high
    _refuse_strangers(frames, links)
    middle = (len(order) - 1) // 2
    out: list[Displacement | None] = [None] * len(frames)
    out[order[middle]] = Displacement((0.0, 0.0), False, 0, 1.0, 0.0)
    for side, sign in ((order[middle:], 1.0), (order[middle::-1], -1.0)):
        rows, columns = 0.0, 0.0
        for one, other in itertools.pairwise(side):
            link = links[(one, other) if sign > 0 else (other, one)]
            if link.proven:
                rows, columns = rows + 2 * sign * link.shift[0], columns + 2 * sign * link.shift[1]
            moved = bool(np.hypot(rows, columns) >= 2 * _SMALLEST)
            out[other] = Displacement((rows, columns), moved, link.tiles, link.agreement, link.gain)
    return tuple(d for d in out if d is not None)


def _refuse_strangers(frames: Sequence[MosaicFrame], links: Mapping[tuple[int, int], "_Link"]) -> None:
    """Raise for every pair of neighbours that have structure, but none in common."""
    mistakes = [
        f"{frames[other].info.name}: has nothing in common with {frames[one].info.name}, its neighbour in exposure: "
        f"{link.alike} of {link.told} parts of the picture agree at any shift, at least {_IN_COMMON:.0%} are expected. "
        "Take the one that shows something else out of the bracket, or set `merge.align: false`."
        for (one, other), link in links.items()
        if link.told >= _TELLING and link.alike < _IN_COMMON * link.told
    ]
    if mistakes:
        raise CalibrateError("\n".join(mistakes))


def shifted(mosaic: Counts, shift: Shift, *, clip: Float64, step: int) -> Counts:
    """Return a mosaic moved so that (y, x) shows what stood at (y, x) + shift, within the grids of its colours.

    Parameters
    ----------
    shift
        Rows and columns, photosites.
    clip
        Shape (P,): counts from which a sample is clipped.
    step
        Photosites from one sample of a colour to the next: 2 in a Bayer mosaic, 1 without filters.
    """
    whole = [step * round(s / step) for s in shift]
    rest = [s - w for s, w in zip(shift, whole, strict=True)]
    taps = np.stack([_catmull_rom(r / step) if abs(r) >= _NEGLIGIBLE else _catmull_rom(0.0) for r in rest])
    out = np.empty_like(mosaic)
    _move(mosaic, whole[0], whole[1], taps, clip, step, out)
    return out


def _catmull_rom(at: float) -> Float64:
    """Return the weights of samples −1, 0, 1, 2 (or, for a negative place, mirrored into five taps −2…2)."""
    t = abs(at)
    w = 0.5 * np.array([-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, -(t**2) + t**3])
    five = np.zeros(5)
    five[1:] = w
    return five if at >= 0 else five[::-1].copy()


def _seen(frame: MosaicFrame, e: Exposure) -> tuple[Plane, float, float]:
    """Return radiances of 2×2 photosites, clipped ones at the ceiling, and the range that the frame sees."""
    quads = quads_of(decoded(frame), e)
    high = float(np.min((e.clip - e.black) / (e.light * e.span)))
    quads.mean[quads.clipped > 0] = high
    noise = 2.0 * e.read_noise_e / e.gain_e_per_dn / quads.scale
    # Where shot noise is a tenth of the signal.
    shot = 100.0 / (e.gain_e_per_dn * quads.scale)
    return quads.mean, max(10.0 * noise, shot), high


@dataclass(frozen=True, slots=True)
class _Link:
    shift: Shift
    proven: bool
    tiles: int
    agreement: float
    gain: float
    told: int
    alike: int


def _compare(one: Plane, other: Plane, *, low: float, high: float) -> _Link:
    """Return the shift of `other` against `one`: other(x + shift) = one(x)."""
    if high <= 1.5 * low:
        return _Link((0.0, 0.0), False, 0, 0.0, 0.0, 0, 0)
    a, b = (
        cv2.GaussianBlur(np.log(np.clip(image, np.float32(low), np.float32(high))), (0, 0), _BLUR)
        for image in (one, other)
    )
    start = _coarse(a, b)
    height, width = a.shape
    tile = min(_TILE, height // 2, width // 2)
    fine_a, fine_b = (image - cv2.GaussianBlur(image, (0, 0), _FINE) for image in (a, b))
    found, told, alike = [], 0, 0
    for y in np.linspace(0, height - tile, _TILES).astype(int):
        for x in np.linspace(0, width - tile, _TILES).astype(int):
            corner = int(y), int(x)
            spoken = _refine(a, b, corner, tile, start)
            if spoken is not None:
                found.append((*corner, spoken))
            likeness = [_likeness(fine_a, fine_b, corner, tile, at) for at in (spoken or start, (0.0, 0.0))]
            told += likeness[0] is not None
            alike += any(value is not None and value >= _ALIKE for value in likeness)
    if len(found) < FEWEST_TILES:
        return _Link((0.0, 0.0), False, len(found), 0.0, 0.0, told, alike)
    shifts = np.array([shift for *_, shift in found])
    middle = np.median(shifts, axis=0)
    near = np.hypot(*(shifts - middle).T) <= _AGREE
    agreement = float(near.mean())
    gains = []
    for y, x, _ in found:
        still = _difference(a, b, (y, x), tile, (0.0, 0.0))
        moved = _difference(a, b, (y, x), tile, (float(middle[0]), float(middle[1])))
        gains.append(1.0 - moved / still if still > 0 else 0.0)
    gain = float(np.median(gains))
    proven = agreement >= _AGREEING and bool(np.hypot(*middle) >= _SMALLEST) and gain >= _GAIN
    return _Link((float(middle[0]), float(middle[1])), proven, len(found), agreement, gain, told, alike)


def _coarse(a: Plane, b: Plane) -> Shift:
    factor = max(1.0, max(a.shape) / _COARSE)
    size = (round(a.shape[1] / factor), round(a.shape[0] / factor))
    small = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (a, b)]
    window = cv2.createHanningWindow(size, cv2.CV_32F)
    (columns, rows), _ = cv2.phaseCorrelate(small[0] - small[0].mean(), small[1] - small[1].mean(), window)
    return rows * a.shape[0] / size[1], columns * a.shape[1] / size[0]


def _cut(image: Plane, corner: tuple[int, int], tile: int, shift: Shift) -> Plane:
    centre = (corner[1] + shift[1] + (tile - 1) / 2, corner[0] + shift[0] + (tile - 1) / 2)
    return np.asarray(cv2.getRectSubPix(image, (tile, tile), centre), np.float32)


def _likeness(a: Plane, b: Plane, corner: tuple[int, int], tile: int, shift: Shift) -> float | None:
    """Return the correlation of a tile with what stands in its place, None where one of the two is without structure."""
    part = a[corner[0] : corner[0] + tile, corner[1] : corner[1] + tile].ravel()
    moved = _cut(b, corner, tile, shift).ravel()
    spread = float(part.std()), float(moved.std())
    if min(spread) < _STRUCTURE:
        return None
    return float(np.mean((part - part.mean()) * (moved - moved.mean()))) / (spread[0] * spread[1])


def _difference(a: Plane, b: Plane, corner: tuple[int, int], tile: int, shift: Shift) -> float:
    rest = _cut(b, corner, tile, shift) - a[corner[0] : corner[0] + tile, corner[1] : corner[1] + tile]
    return float(np.mean((rest - rest.mean()) ** 2))


def _refine(a: Plane, b: Plane, corner: tuple[int, int], tile: int, start: Shift) -> Shift | None:
    """Return the shift of a tile, or None where it has too little structure to tell."""
    part = a[corner[0] : corner[0] + tile, corner[1] : corner[1] + tile]
    rows, columns = start
    inverse, rest = np.eye(2), part
    for _ in range(_STEPS):
        moved = _cut(b, corner, tile, (rows, columns))
        rest = part - moved
        rest = (rest - rest.mean())[1:-1, 1:-1]
        mean = 0.25 * (part + moved)
        slopes = mean[2:, 1:-1] - mean[:-2, 1:-1], mean[1:-1, 2:] - mean[1:-1, :-2]
        gradient = [np.asarray(g, np.float32) for g in slopes]
        # What moves within the tile, or shines in one frame only, is weighted down.
        some = np.abs(rest[::3, ::3]).ravel()
        scale = 4.0 * 1.4826 * float(np.partition(some, some.size // 2)[some.size // 2]) + 1e-9
        weight = 1.0 / (1.0 + (rest / scale) ** 2)
        weighted = [np.asarray(weight * g, np.float32) for g in gradient]
        normal = np.array([[_inner(w, g) for g in gradient] for w in weighted])
        if np.linalg.eigvalsh(normal)[0] < 1e-6:
            return None
        inverse = np.linalg.inv(normal)
        step = inverse @ [_inner(w, rest) for w in weighted]
        rows, columns = rows + float(np.clip(step[0], -2.0, 2.0)), columns + float(np.clip(step[1], -2.0, 2.0))
        if math.hypot(rows - start[0], columns - start[1]) > tile / 2:
            return None
        if np.abs(step).max() < 1e-3:
            break
    # Blurred noise is correlated over about 4π σ² samples.
    error = math.sqrt(inverse.max() * float(np.var(rest)) * 4 * np.pi * _BLUR**2)
    return (rows, columns) if error < _KNOWN else None


def _inner(a: Plane, b: Plane) -> float:
    """Return Σ a b; not by the linear algebra's library, whose sums hang on the number of threads."""
    return float(np.einsum("ij,ij->", a, b))


@njit(cache=True, parallel=True, error_model="numpy")
def _move(
    mosaic: Counts,
    rows: int,
    columns: int,
    taps: Float64,
    clip: Float64,
    step: int,
    out: Counts,
) -> None:  # pragma: no cover - compiled
    height, width = mosaic.shape
    for y in prange(height):
        for x in range(width):
            p = (y % step) * step + x % step
            total = 0.0
            known = True
            for v in range(5):
                if taps[0, v] == 0.0:
                    continue
                j = y + rows + step * (v - 2)
                if j < 0 or j >= height:
                    known = False
                    break
                for u in range(5):
                    if taps[1, u] == 0.0:
                        continue
                    i = x + columns + step * (u - 2)
                    if i < 0 or i >= width or mosaic[j, i] >= clip[p]:
                        known = False
                        break
                    total += taps[0, v] * taps[1, u] * mosaic[j, i]
                if not known:
                    break
            if known:
                out[y, x] = np.uint16(min(max(np.rint(total), 0.0), np.ceil(clip[p]) - 1.0))
            else:
                out[y, x] = _NOWHERE
