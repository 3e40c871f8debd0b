"""What moved between the frames of a bracket: found where frames contradict each other by more than noise allows.

One frame, the longest that hardly clips, says what the scene was; where it clips, the longest shorter one that does not.
Every other frame is compared with it on means of 2×2 photosites, over windows of 5×5 of them: the mean difference and the
mean square of it, in units of the noise that the model expects of both (plus one per cent, and plus what a shift of a tenth
of a photosite would do, so that an edge is no evidence). Where one of them could not happen by chance, the frame is left out
of the merge, with a margin. A clipped sample is evidence too, of at least its light; where only some of the 2×2 clip, a frame
follows the others' verdict. Where there is no evidence, every frame counts.

Left out: movement that is smaller than the noise, and colour: what moves must be brighter or darker.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.exposure import BAYER_PATTERNS, MONOCHROME
from calibrate.merge.quads import quads_of
from calibrate.merge.records import Exposure, MosaicFrame, Plane
from calibrate.merge.survey import decoded

Mask = npt.NDArray[np.uint8]

_WINDOW = 5

# Standard deviations of a window's mean, and of its mean square, that chance reaches in less than 10⁻⁶ of all windows.
_MEAN_SIGMA, _SQUARE_SIGMA = 5.0, 8.0

# A place with clipped samples is evidence only by so many standard deviations of its own: one side of chance is cut off there.
_CLIPPED_SIGMA = 4.0

# Frames never agree better than to this share (a shutter's run, a lamp's ripple).
_UNSURE = 0.01

# A shift of so many means of 2×2 is no movement.
_JITTER = 0.05

# The margin around what moved, in means of 2×2.
_MARGIN = 3

# The reference clips at most this share of its photosites.
_CLIPPED = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Ghosts:
    """What to leave out: one mask a frame for `merge_mosaics`, the reference's place in the list, and shares left out."""

    masks: tuple[Mask, ...]
    reference: int
    shares: tuple[float, ...]


def find_ghosts(frames: Sequence[MosaicFrame], exposures: Sequence[Exposure]) -> Ghosts:
    """Return where each frame contradicts the reference; each frame is decoded at most twice.

    Masks are of shape (⌈H/2⌉, ⌈columns/2⌉), uint8.

    Raises
    ------
    CalibrateError
        Frames that are no Bayer or monochrome mosaics.
    """
    info = frames[0].info
    if info.cfa not in (*BAYER_PATTERNS, MONOCHROME):
        raise CalibrateError(
            f"{info.name}: movement cannot be found in frames with this pattern; in Bayer and monochrome mosaics it can. Set "
            "`merge.deghost: false`."
        )
    order = sorted(range(len(frames)), key=lambda k: (float(exposures[k].light.mean()), frames[k].info.name))
    reference = order[0]
    truth = variance = None
    known: npt.NDArray[np.bool_] | None = None
    source: Mask | None = None
    for k in order[::-1]:
        mean, var, valid, _ = _seen(frames[k], exposures[k])
        if truth is None:
            if valid.mean() < 1.0 - _CLIPPED and k != order[0]:
                continue
            reference, truth, variance, known = k, mean, var, valid
            source = np.full(mean.shape, k, np.uint8)
            continue
        assert variance is not None and known is not None and source is not None
        fresh = valid & ~known
        if fresh.any():
            truth[fresh], variance[fresh], source[fresh] = mean[fresh], var[fresh], k
            known |= fresh
    assert truth is not None and variance is not None and known is not None and source is not None
    slope = _slope(truth)
    masks = [np.zeros(truth.shape, np.uint8) for _ in frames]
    untold = [np.zeros(truth.shape, np.bool_) for _ in frames]
    for k in order:
        if k == reference and bool((source == k).all()):
            continue
        mean, var, valid, partly = _seen(frames[k], exposures[k])
        compared = (valid | _outshines(mean, var, truth, variance, slope)) & known & (source != k)
        moved = _contradicts(mean, var, truth, variance, slope, compared)
        # What a frame itself vouches for is not left out of it.
        masks[k] = (moved & known & (source != k)).astype(np.uint8)
        untold[k] = partly & known & (source != k)
    # Where one colour clips, the mean tells nothing of the others; what moved in another frame is not trusted there.
    somewhere = np.maximum.reduce(masks)
    for mask, silent in zip(masks, untold, strict=True):
        mask[silent] |= somewhere[silent]
    return Ghosts(tuple(masks), reference, tuple(float(m.mean()) for m in masks))


def _seen(frame: MosaicFrame, e: Exposure) -> tuple[Plane, Plane, npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Return mean radiance of 2×2 photosites, its variance by the noise model, where none clips, and where some do."""
    quads = quads_of(decoded(frame), e)
    read2 = 4.0 * (e.read_noise_e / e.gain_e_per_dn) ** 2
    # The square root of a few counts is not known from them: smoothed, as neighbours are alike.
    expected = np.maximum(cv2.blur(quads.mean, (3, 3)), np.float32(0))
    var = np.float32(read2 / quads.scale**2) + expected * np.float32(1.0 / (e.gain_e_per_dn * quads.scale))
    return quads.mean, np.asarray(var, np.float32), quads.clipped == 0, (quads.clipped > 0) & (quads.clipped < 4)


def _slope(image: Plane) -> Plane:
    """Return by how much the neighbours of each place differ at most."""
    cube = np.ones((3, 3), np.uint8)
    return np.asarray(cv2.dilate(image, cube) - cv2.erode(image, cube), np.float32)


def _looseness(mean: Plane, truth: Plane, slope: Plane) -> Plane:
    """Return the variance of what makes frames differ besides noise and movement."""
    unsure, jitter = np.float32(_UNSURE) * np.maximum(np.abs(truth), np.abs(mean)), np.float32(_JITTER) * slope
    return np.asarray(unsure**2 + jitter**2, np.float32)


def _outshines(mean: Plane, var: Plane, truth: Plane, variance: Plane, slope: Plane) -> npt.NDArray[np.bool_]:
    """Return where a frame is clearly brighter than the truth: also a clipped sample, which is at least that bright, tells."""
    surely = (mean - truth) ** 2 > np.float32(_CLIPPED_SIGMA**2) * (var + variance + _looseness(mean, truth, slope))
    return np.asarray(surely & (mean > truth), np.bool_)


def _contradicts(
    mean: Plane, var: Plane, truth: Plane, variance: Plane, slope: Plane, compared: npt.NDArray[np.bool_]
) -> npt.NDArray[np.bool_]:
    count = cv2.boxFilter(compared.astype(np.float32), -1, (_WINDOW, _WINDOW), normalize=False)
    noise = var + variance
    loose = _looseness(mean, truth, slope)
    off = np.where(compared, mean - truth, np.float32(0))
    # A common error of all places of a window does not average out: it counts in full.
    total = cv2.boxFilter(off, -1, (_WINDOW, _WINDOW), normalize=False)
    expected = cv2.boxFilter(np.where(compared, noise, np.float32(0)), -1, (_WINDOW, _WINDOW), normalize=False)
    common = cv2.boxFilter(np.where(compared, np.sqrt(loose), np.float32(0)), -1, (_WINDOW, _WINDOW), normalize=False)
    by_mean = total**2 > np.float32(_MEAN_SIGMA**2) * (expected + common**2 / np.float32(9))
    chi = np.where(compared, off**2 / (noise + loose), np.float32(0))
    square = cv2.boxFilter(chi, -1, (_WINDOW, _WINDOW), normalize=False)
    by_square = square > count + np.float32(_SQUARE_SIGMA) * np.sqrt(2 * count) + np.float32(_SQUARE_SIGMA)
    # A window beside a moving thing contradicts with few places; a single hot photosite is not a movement.
    found = (by_mean | by_square) & (count >= _WINDOW)
    found = cv2.morphologyEx(found.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    grown = cv2.dilate(found, np.ones((2 * _MARGIN + 1,) * 2, np.uint8))
    return np.asarray(grown > 0)
