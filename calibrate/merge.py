"""One mosaic of radiance from a bracket of RAW mosaics.

Every sample is weighted by its inverse variance under read and shot noise, in the mosaic, before demosaicing: there
the noise of one sample does not depend on another (as Granados et al. 2010, "Optimal HDR reconstruction with linear
digital cameras", CVPR; Hasinoff, Durand and Freeman 2010, "Noise-optimal capture for high dynamic range photography",
CVPR). The weight needs the radiance that is sought, so there are two passes over the frames. The first takes
Σ t·counts / Σ t², which is inverse variance where read noise rules. It is preferred to the usual Σ counts / Σ t: there
the noise of the short frames moves the weights along with the values, which biases the mean by +1.3 % at 5–16
electrons in the longest frame and by +0.3 % at 16–50 (this: by less than 0.1 %; simulated, five frames 2 EV apart, 3 e-
read noise).

Left out: alignment and movement, exposure times that differ from what the file says, lens shading, flare.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from calibrate import CalibrateError
from calibrate.exposure import FrameInfo, by_exposure, check_bracket

Plane = npt.NDArray[np.float32]

# What a typical sensor of 4–6 µm photosites has at ISO 100 (SENSOR_READ includes the converter).
_FULL_WELL_E = 50_000.0
_SENSOR_READ_E = 3.0

# A clipped sample cannot tell how far it would have gone; what it and the others together say is then at least 1 less
# this many σ of the part of the others. See `_weigh`.
_CLIP_GUARD_SIGMA = 2.0

# A frame's share in the result is measured on about this many photosites.
_SHARE_SAMPLES = 1 << 16


class MosaicFrame(Protocol):
    """A RAW frame that is decoded when asked, so that a bracket need not stand in memory."""

    @property
    def info(self) -> FrameInfo:
        """What the frame says about itself."""
        ...

    def mosaic(self) -> npt.NDArray[np.uint16]:
        """Decode: shape (height, width), uint16, raw counts of the visible area, black not subtracted."""
        ...


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Variance of a sample in electrons: signal + read_noise_e².

    Attributes
    ----------
    gain_e_per_dn
        Electrons a raw count, at the lowest ISO of the bracket.
    read_noise_e
        Standard deviation of a dark sample in electrons, the converter's noise included.
    """

    gain_e_per_dn: float
    read_noise_e: float


@dataclass(frozen=True, slots=True)
class FrameUse:
    """What became of one frame of the bracket.

    Attributes
    ----------
    name, exposure_s
        Of the frame.
    clipped
        Samples at or above the white level.
    used
        Samples that went into the result.
    share
        Its part in the result: mean over the pixels of weight / sum of weights. The shares of a bracket add up to 1
        (they are measured on a regular sample of the pixels).
    """

    name: str
    exposure_s: Fraction
    clipped: int
    used: int
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """Radiance seen through the mosaic.

    Attributes
    ----------
    mosaic
        Shape (H, W), float32, camera RGB units: (counts − black)/(white − black) per second. May be slightly negative
        where it is dark (noise). NaN where lost.
    lost
        Shape (H, W), bool: clipped in every frame.
    cfa
        Colours of the top-left 2×2 of the mosaic.
    frames
        One record a frame, from the shortest to the longest exposure.
    lost_count, defect_count
        Pixels lost; single defective photosites replaced by the median of their neighbours of the same colour.
    defects
        Shape (defect_count, 2), int32: row and column of each of them.
    noise
        The noise model that ranked the samples.
    warnings
        What a person should know: message with place, value, expectation and remedy.
    """

    mosaic: Plane
    lost: npt.NDArray[np.bool_]
    cfa: str
    frames: tuple[FrameUse, ...]
    lost_count: int
    defect_count: int
    defects: npt.NDArray[np.int32]
    noise: NoiseModel
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Scale:
    """How the counts of one frame become radiance and variance; arrays have one entry a position of the 2×2."""

    light: float  # seconds × ISO / lowest ISO
    black: npt.NDArray[np.float64]
    white: npt.NDArray[np.float64]
    electrons: npt.NDArray[np.float64]  # at the white level
    read: npt.NDArray[np.float64]  # variance of the read noise, in (white − black)²


def guess_noise(info: FrameInfo) -> NoiseModel:
    """Return the noise model of a typical sensor, scaled to a frame's levels and ISO.

    A well of 50 000 electrons at the white level at ISO 100, inversely proportional to ISO, and 3 electrons of read
    noise. It is a guess that only ranks the samples of a pixel: the result is unbiased whatever the model, and a model
    that is wrong by a factor of two costs a few per cent of noise. Do not report it as a property of the camera.
    """
    span = sum(info.white_dn) / 4 - sum(info.black_dn) / 4
    return NoiseModel(_FULL_WELL_E / span * 100.0 / (info.iso or 100.0), _SENSOR_READ_E)


def merge_mosaics(
    frames: Sequence[MosaicFrame],
    *,
    noise: NoiseModel | None = None,
    defects: bool = True,
    mixed_iso: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Merged:
    """Return the radiance that best explains a bracket of mosaics.

    Each sample is weighted by its inverse variance under `noise`. A sample at or above the white level weighs exactly
    nothing. So does a sample that is not clipped by luck only: where the frames together expect it within about one σ
    of the white level, or above. (Choosing by the sample's own value keeps the low ones: −0.25 σ at the white level;
    this: −0.06 σ.) The shortest frame that is not clipped is always used. A pixel clipped in every frame is NaN, and
    counted.

    The frames are sorted by exposure first, and no sum runs across threads: the result is bit-identical for any order
    of the frames and any number of threads. Each frame is decoded twice and dropped at once. Peak memory is 18 bytes a
    photosite (four float32 planes and one uint16 mosaic), however many frames there are, plus what `mosaic()` itself
    needs: 0.43 GB at 24 megapixels.

    Parameters
    ----------
    frames
        In any order; one scene, differing in shutter time only.
    noise
        At the lowest ISO of the bracket; None takes `guess_noise`.
    defects
        Replace single photosites that stand out as no optical image can (see `find_defects`).
    mixed_iso
        Let the ISO differ; radiance is then in units of the lowest ISO.
    progress
        Called with (frames decoded, frames to decode).

    Raises
    ------
    CalibrateError
        What `check_bracket` finds; a mosaic that is not what its frame announced; a noise model that is not positive.
    """
    infos = [f.info for f in frames]
    warnings = list(check_bracket(infos, mixed_iso=mixed_iso))
    order = by_exposure(infos)
    frames, infos = [frames[i] for i in order], [infos[i] for i in order]
    lowest = min((f for f in infos), key=lambda f: f.iso or 100.0)
    noise = noise or guess_noise(lowest)
    if not (noise.gain_e_per_dn > 0 and noise.read_noise_e > 0):
        raise CalibrateError(
            f"merge: noise model with gain {noise.gain_e_per_dn:g} e-/DN and read noise {noise.read_noise_e:g} e-; "
            "both must be above 0. Leave `merge.gain_e_per_dn` and `merge.read_noise_e` out to have them guessed."
        )
    scales = [_scale(f, noise, lowest.iso or 100.0) for f in infos]
    shape = infos[0].height, infos[0].width
    steps = 2 * len(frames)

    first, squares = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    clipped = []
    for k, (frame, scale) in enumerate(zip(frames, scales, strict=True)):
        rows = np.zeros(shape[0], np.int64)
        _gather(_decoded(frame), scale.black, scale.white, scale.light, first, squares, rows)
        clipped.append(int(rows.sum()))
        if progress:
            progress(k + 1, steps)

    weighted, weights = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    share = _Shares(shape)
    used = []
    for k, (frame, scale) in enumerate(zip(frames, scales, strict=True)):
        rows = np.zeros(shape[0], np.int64)
        _weigh(
            _decoded(frame),
            scale.black,
            scale.white,
            scale.light,
            scale.electrons,
            scale.read,
            first,
            squares,
            weighted,
            weights,
            rows,
        )
        used.append(int(rows.sum()))
        share.add(weights)
        if progress:
            progress(len(frames) + k + 1, steps)
    del first, squares

    lost = weights == 0
    np.divide(weighted, weights, out=weighted, where=~lost)
    weighted[lost] = np.nan
    mosaic = weighted
    at = np.empty((0, 2), np.int32)
    if defects:
        at = find_defects(mosaic, weights, ceiling=1.0 / scales[0].light)
        _replace(mosaic, lost, at)
    lost_count = int(lost.sum())
    uses = tuple(
        FrameUse(i.name, i.exposure_s or Fraction(0), c, u, s)
        for i, c, u, s in zip(infos, clipped, used, share.shares(), strict=True)
    )
    warnings += _warnings(uses, lost_count, len(at), mosaic.size)
    return Merged(mosaic, lost, infos[0].cfa, uses, lost_count, len(at), at, noise, tuple(warnings))


def find_defects(mosaic: Plane, weights: Plane, *, ceiling: float) -> npt.NDArray[np.int32]:
    """Return the rows and columns of single photosites that no optical image can have made.

    The image of a point, however small, is wider than a photosite; so a small lamp lifts its neighbours too, while a
    hot, stuck or dead photosite stands alone. It is one if, compared with its eight neighbours of the same colour,

    - it is above their largest (below their smallest) by a factor of 1.5,
    - by 5 σ of the merged value,
    - and by twice the spread of the eight, which spares texture and noise that is larger than the model says,

    and the direct neighbours, which have the other colours, do not rise (fall) with it against the next ones of their
    own colour: by no more than a twentieth of what the photosite itself rises, relatively, and by no more than a half
    (a deep red lamp is faint in green, not absent), within 3 σ. Two defects that are neighbours are not found.

    Parameters
    ----------
    mosaic
        Shape (H, W), float32, radiance; NaN where clipped in every frame.
    weights
        Shape (H, W), float32: inverse variance of the mosaic, 0 where lost.
    ceiling
        Radiance that a lost pixel has at least.
    """
    height, width = mosaic.shape
    rows, columns = _reflected(height), _reflected(width)
    mask = np.zeros(mosaic.shape, np.bool_)
    _mark_defects(mosaic, weights, ceiling, rows, columns, mask)
    return np.argwhere(mask).astype(np.int32)


def _scale(info: FrameInfo, noise: NoiseModel, lowest_iso: float) -> _Scale:
    if info.exposure_s is None:
        raise AssertionError("check_bracket lets no frame without an exposure pass")
    iso = (info.iso or 100.0) / lowest_iso
    black, white = np.array(info.black_dn), np.array(info.white_dn)
    electrons = noise.gain_e_per_dn / iso * (white - black)
    return _Scale(float(info.exposure_s) * iso, black, white, electrons, (noise.read_noise_e / electrons) ** 2)


def _decoded(frame: MosaicFrame) -> npt.NDArray[np.uint16]:
    raw, info = frame.mosaic(), frame.info
    if raw.shape != (info.height, info.width) or raw.dtype != np.uint16:
        raise CalibrateError(
            f"{info.name}: mosaic of shape {raw.shape} and type {raw.dtype}; ({info.height}, {info.width}) and uint16 "
            "are expected. The file may be damaged: copy it from the card again."
        )
    return raw


def _reflected(n: int) -> npt.NDArray[np.int64]:
    """Return the indices −3 … n+2 reflected into 0 … n−1 without repeating the edge, which keeps the CFA's phase."""
    i = np.abs(np.arange(-3, n + 3))
    return np.where(i >= n, 2 * (n - 1) - i, i)


def _replace(mosaic: Plane, lost: npt.NDArray[np.bool_], at: npt.NDArray[np.int32]) -> None:
    if not len(at):
        return
    rows, columns = _reflected(mosaic.shape[0]), _reflected(mosaic.shape[1])
    ring = [(dy, dx) for dy in (1, 3, 5) for dx in (1, 3, 5) if (dy, dx) != (3, 3)]
    around = np.stack([mosaic[rows[at[:, 0] + dy], columns[at[:, 1] + dx]] for dy, dx in ring], axis=-1)
    known = ~np.isnan(around).all(axis=-1)
    y, x = at[known].T
    mosaic[y, x] = np.nanmedian(around[known], axis=-1)
    lost[y, x] = False


class _Shares:
    """Follows how the weights of a regular sample of the pixels grow from frame to frame."""

    def __init__(self, shape: tuple[int, int]) -> None:
        # An odd step visits all positions of the 2×2.
        self._step = max(1, int((shape[0] * shape[1] / _SHARE_SAMPLES) ** 0.5)) | 1
        self._sums: list[Plane] = []

    def add(self, weights: Plane) -> None:
        self._sums.append(weights[:: self._step, :: self._step].copy())

    def shares(self) -> list[float]:
        total = self._sums[-1].astype(np.float64)
        valid = total > 0
        if not valid.any():
            return [0.0] * len(self._sums)
        parts = [float(np.mean(s[valid] / total[valid])) for s in self._sums]
        return [b - a for a, b in zip([0.0, *parts], parts, strict=False)]


def _warnings(uses: Sequence[FrameUse], lost: int, defects: int, pixels: int) -> list[str]:
    out = []
    if lost:
        shortest = uses[0]
        out.append(
            f"{shortest.name}: {lost} photosites ({lost / pixels:.2g} of all) are clipped even in this, the shortest "
            f"exposure ({shortest.exposure_s} s), and are lost. Add a shorter exposure to the bracket if they matter."
        )
    out += [
        f"{use.name}: no sample of it was used ({use.clipped / pixels:.0%} clipped); it should add to the bracket. "
        "Remove it from `capture.reference` or `capture.environment`."
        for use in uses
        if use.used == 0
    ]
    if defects > 1e-3 * pixels:
        out.append(
            f"{uses[-1].name}: {defects} photosites ({defects / pixels:.2g} of all) were taken for defects and "
            "replaced; a sensor has fewer than 1 in 1000. If the scene has single bright points, set "
            "`merge.defects: false`."
        )
    return out


@njit(cache=True, parallel=True, error_model="numpy")
def _gather(
    raw: npt.NDArray[np.uint16],
    black: npt.NDArray[np.float64],
    white: npt.NDArray[np.float64],
    light: float,
    first: Plane,
    squares: Plane,
    clipped: npt.NDArray[np.int64],
) -> None:  # pragma: no cover - compiled
    """Pass 1: add light × sample and light² of the samples that are not clipped."""
    height, width = raw.shape
    for y in prange(height):
        for x in range(width):
            p = 2 * (y & 1) + (x & 1)
            value = np.float64(raw[y, x])
            if value >= white[p]:
                clipped[y] += 1
            else:
                first[y, x] += light * (value - black[p]) / (white[p] - black[p])
                squares[y, x] += light * light


@njit(cache=True, parallel=True, error_model="numpy")
def _weigh(
    raw: npt.NDArray[np.uint16],
    black: npt.NDArray[np.float64],
    white: npt.NDArray[np.float64],
    light: float,
    electrons: npt.NDArray[np.float64],
    read: npt.NDArray[np.float64],
    first: Plane,
    squares: Plane,
    weighted: Plane,
    weights: Plane,
    used: npt.NDArray[np.int64],
) -> None:  # pragma: no cover - compiled
    """Pass 2: add the samples by inverse variance; frames come from the shortest to the longest.

    Whether a sample s near the white level is used must not depend on s − r, r being what the other frames expect of it:
    the mean of the result would move by the correlation. Their inverse-variance mean does not correlate with s − r, so it
    decides. It cannot be formed where s is clipped; with s at the white level it spreads by own·√borrowed/(own + borrowed)
    around it, so the threshold stands 2 σ of that lower: nearly all that would belong to clipped samples is left out.
    """
    height, width = raw.shape
    for y in prange(height):
        for x in range(width):
            p = 2 * (y & 1) + (x & 1)
            value = np.float64(raw[y, x])
            if value >= white[p]:
                continue
            sample = (value - black[p]) / (white[p] - black[p])
            radiance = max(first[y, x] / np.float64(squares[y, x]), 0.0)
            own = radiance * light / electrons[p] + read[p]
            # The shortest usable sample has no weight before it, and is always taken. Far below the white level nothing
            # is near clipping, and the roots can be spared.
            if weights[y, x] > 0 and radiance * light > 0.5:
                rest_square = squares[y, x] - light * light
                rest = (first[y, x] - light * sample) / rest_square * light
                # The longest of the others makes up nearly all of their sum of squares.
                ratio = light / np.sqrt(rest_square)
                borrowed = ratio * radiance * light / electrons[p] + ratio * ratio * read[p]
                both = (borrowed * sample + own * rest) / (own + borrowed)
                if both + _CLIP_GUARD_SIGMA * own * np.sqrt(borrowed) / (own + borrowed) >= 1.0:
                    continue
            certainty = light / own
            weighted[y, x] += certainty * sample
            weights[y, x] += certainty * light
            used[y] += 1


@njit(cache=True, error_model="numpy")
def _level(mosaic: Plane, y: int, x: int, ceiling: float) -> float:  # pragma: no cover - compiled
    value = np.float64(mosaic[y, x])
    return ceiling if np.isnan(value) else value


@njit(cache=True, error_model="numpy")
def _stands_alone(
    mosaic: Plane,
    weights: Plane,
    ceiling: float,
    rows: npt.NDArray[np.int64],
    columns: npt.NDArray[np.int64],
    y: int,
    x: int,
    sign: float,
    rise: float,
) -> bool:  # pragma: no cover - compiled
    """Whether the direct neighbours keep to the level of the next ones of their colour, in all three groups."""
    for group in range(3):  # beside, above and below, diagonal: one colour each in a Bayer pattern
        inner, outer, weight = -np.inf, -np.inf, np.inf
        for dy in range(-3, 4):
            for dx in range(-3, 4):
                odd_y, odd_x = dy & 1, dx & 1
                if (group == 0 and (odd_y or not odd_x)) or (group == 1 and (odd_x or not odd_y)):
                    continue
                if group == 2 and not (odd_y and odd_x):
                    continue
                reach = abs(dy) + abs(dx)
                if reach > 4:
                    continue
                j, i = rows[y + dy + 3], columns[x + dx + 3]
                value = sign * _level(mosaic, j, i, ceiling)
                if abs(dy) <= 1 and abs(dx) <= 1:
                    inner = max(inner, value)
                    if weights[j, i] > 0:
                        weight = min(weight, np.float64(weights[j, i]))
                else:
                    outer = max(outer, value)
        if inner - outer > rise * abs(outer) + 3.0 / np.sqrt(weight):
            return False
    return True


@njit(cache=True, parallel=True, error_model="numpy")
def _mark_defects(
    mosaic: Plane,
    weights: Plane,
    ceiling: float,
    rows: npt.NDArray[np.int64],
    columns: npt.NDArray[np.int64],
    mask: npt.NDArray[np.bool_],
) -> None:  # pragma: no cover - compiled
    height, width = mosaic.shape
    for y in prange(height):
        for x in range(width):
            value = _level(mosaic, y, x, ceiling)
            smallest, largest = np.inf, -np.inf
            weight = np.float64(weights[y, x]) if weights[y, x] > 0 else np.inf
            for dy in (-2, 0, 2):
                for dx in (-2, 0, 2):
                    if dy == 0 and dx == 0:
                        continue
                    j, i = rows[y + dy + 3], columns[x + dx + 3]
                    other = _level(mosaic, j, i, ceiling)
                    smallest = min(smallest, other)
                    largest = max(largest, other)
                    if weights[j, i] > 0:
                        weight = min(weight, np.float64(weights[j, i]))
            if value > largest:
                excess = value - largest
                far = value > 1.5 * largest
                rise = min(0.02 * (value / largest - 1.0), 0.2) if largest > 0 else 0.2
                sign = 1.0
            elif value < smallest:
                excess = smallest - value
                far = 1.5 * value < smallest
                rise = min(0.02 * (1.0 - value / smallest), 0.2) if smallest > 0 else 0.0
                sign = -1.0
            else:
                continue
            if far and excess > 2.0 * (largest - smallest) and excess * np.sqrt(weight) > 5.0:
                mask[y, x] = _stands_alone(mosaic, weights, ceiling, rows, columns, y, x, sign, rise)
