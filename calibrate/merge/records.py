"""What the parts of the merge hand to each other."""

from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol

import numpy as np
import numpy.typing as npt

from calibrate.exposure import FrameInfo

Counts = npt.NDArray[np.uint16]
Float64 = npt.NDArray[np.float64]
Plane = npt.NDArray[np.float32]


class MosaicFrame(Protocol):
    """A RAW frame that is decoded when asked, so that a bracket need not stand in memory."""

    @property
    def info(self) -> FrameInfo:
        """What the frame says about itself."""
        ...

    def mosaic(self) -> Counts:
        """Decode: shape (height, columns), uint16, raw counts of the visible area, black not subtracted."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """How the counts of one frame become radiance; arrays have one entry a position of the mosaic's pattern.

    Attributes
    ----------
    light
        Shape (P,): seconds × ISO / lowest ISO × transmission (× aperture area / that of the lowest f-number's frame).
    black, clip
        Shape (P,), raw counts: no light; the level from which a sample counts as clipped.
    span
        Shape (P,): counts of one unit, white − black as the file states them.
    gain_e_per_dn, read_noise_e
        The noise of this frame, at its own ISO.
    """

    light: Float64
    black: Float64
    clip: Float64
    span: Float64
    gain_e_per_dn: float
    read_noise_e: float


@dataclass(frozen=True, slots=True)
class Ratio:
    """What the pixels say of a frame's exposure.

    Attributes
    ----------
    factor
        Light in the frame over what the file says; the middle frame of the bracket is 1 by definition.
    error
        Standard error of the factor; infinite where too few samples speak.
    applied
        Whether the merge uses it: where it is known to 0.3 % and differs from 1 by more than that and 4 errors.
    uneven
        How far single tiles of the frame, of 8×8, depart from it: the largest that noise cannot explain, 0 where none.
    """

    factor: float
    error: float
    applied: bool
    uneven: float


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What a bracket tells about itself: an `Exposure` a frame, in the order of the frames given.

    Attributes
    ----------
    names, exposures, ratios
        One entry a frame.
    noise
        At the lowest ISO of the bracket.
    noise_from
        "settings", "bracket" (photon transfer between the frames), or "guess".
    black_from
        "file", "masked pixels", "dark frame" or "bracket".
    clip_from
        "file", "data" or "settings".
    black_shift_dn
        What was added to the file's black, mean over the positions.
    warnings
        Place, value, expectation and remedy.
    """

    names: tuple[str, ...]
    exposures: tuple[Exposure, ...]
    ratios: tuple[Ratio, ...]
    noise: NoiseModel
    noise_from: str
    black_from: str
    clip_from: str
    black_shift_dn: float
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FrameUse:
    """What became of one frame of the bracket.

    Attributes
    ----------
    name, exposure_s
        Of the frame, as the file (or the settings) told it.
    clipped
        Samples at or above the clipping level.
    used
        Samples that went into the result.
    share
        Its part in the result: mean over the pixels of weight / sum of weights. The shares of a bracket add up to 1
        (they are measured on a regular sample of the pixels).
    light
        What the merge divided by, relative to `exposure_s`: measured factor × ISO × filter × aperture (green).
    ghosts
        Samples left out because something had moved there.
    """

    name: str
    exposure_s: Fraction
    clipped: int
    used: int
    share: float
    light: float = 1.0
    ghosts: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """Radiance seen through the mosaic.

    Attributes
    ----------
    mosaic
        Shape (H, columns), float32, camera RGB units: (counts − black)/(white − black) per second. May be slightly
        negative where it is dark (noise). NaN where lost.
    lost
        Shape (H, columns), bool: clipped in every frame.
    cfa
        Colours of the top-left pattern of the mosaic.
    frames
        One record a frame, from the shortest to the longest exposure.
    lost_count, defect_count
        Samples lost; single defective photosites replaced by the median of their neighbours of the same colour.
    defects
        Shape (defect_count, 2), int32: row and column of each of them.
    noise
        The noise model that ranked the samples, at the lowest ISO.
    ceiling
        Shape (P,): the radiance that a lost sample has at least, by position of the pattern.
    deviation
        Shape (H, columns), float32: standard deviation of `mosaic` under the noise model; None unless asked for.
    ghosts
        Shape (H, columns), bool: samples of some frame were left out here because something had moved; None unless
        looked for.
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
    ceiling: Float64
    deviation: Plane | None
    ghosts: npt.NDArray[np.bool_] | None
    warnings: tuple[str, ...]
