"""What a frame of a bracket says about itself, and the human mistakes that show in it.

A bracket is one scene seen several times by one camera in which nothing but the shutter time changed. Every
deviation is found before a pixel is read, and all of them are reported at once. What the pixels themselves
reveal (movement, a shutter that is not as long as it says) is not looked at here.
"""

import itertools
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from calibrate import CalibrateError

BAYER_PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")

# Other arrangements of the photosites: no filters at all, and three colours at every photosite (side by side in a row of
# the mosaic). A pattern of 36 letters is a 6×6 such as Fujifilm's X-Trans.
MONOCHROME, LINEAR = "W", "RGB"
_PERIODS = {1: (1, 1), 3: (1, 3), 4: (2, 2), 36: (6, 6)}

# 4 EV leave a sixteenth of the light, so noise four times worse, just above where the longer frame clips.
WIDE_STEP_EV = 4.0

# Shutter times closer than this are one nominal setting (EXIF writes 1/30 and 0.0333 for the same third of a stop).
SAME_EXPOSURE_EV = 0.02

# Zooms report the same setting to this share; a bracket's frames then show the same scene to a pixel or few.
SAME_FOCAL_LENGTH = 0.02

# Some cameras measure their black anew for every frame; beyond this share of the range it is another format.
BLACK_TOLERANCE = 0.01

_OUT = "Move the file out of the bracket (`capture.reference` or `capture.environment`)"


@dataclass(frozen=True, slots=True)
class Masked:
    """Photosites that no light reaches, in raw counts: mean and standard deviation by position, and their number."""

    black_dn: tuple[float, ...]
    noise_dn: float
    count: int


@dataclass(frozen=True, slots=True)
class FrameInfo:
    """What one RAW frame says about itself.

    Attributes
    ----------
    name
        The file, as messages are to show it.
    exposure_s
        Shutter time in seconds; None where the file has none.
    iso, f_number
        Sensitivity and aperture; None where the file has none (a manual lens tells no aperture).
    camera, lens
        As the file names them; "" where it does not.
    width, height
        Of the visible mosaic, in photosites.
    cfa
        Colours of the top-left pattern of the visible area, row by row: "RGGB", "BGGR", "GRBG" or "GBRG", 36 letters of a
        6×6, "W" of a sensor without filters, "RGB" of a frame with three colours at every photosite.
    black_dn, white_dn
        Black and saturation level in raw counts at the positions of that pattern: (0,0), (0,1), (1,0), (1,1) of a Bayer
        mosaic.
    bits
        Bits a sample, None where unknown.
    masked
        What the photosites behind the frame's masked border read; None where there are none.
    transmission
        Share of the light that a filter before the lens lets through, in red, green and blue; told by a person.
    focal_length_mm, focus_distance_m
        Of the lens as it was set; None where the file has none. Infinity is `math.inf`.
    """

    name: str
    exposure_s: Fraction | None
    iso: float | None
    f_number: float | None
    camera: str
    lens: str
    width: int
    height: int
    cfa: str
    black_dn: tuple[float, ...]
    white_dn: tuple[float, ...]
    bits: int | None
    masked: Masked | None = None
    transmission: tuple[float, float, float] = (1.0, 1.0, 1.0)
    focal_length_mm: float | None = None
    focus_distance_m: float | None = None

    @property
    def period(self) -> tuple[int, int]:
        """Rows and columns after which the mosaic's pattern repeats."""
        return _PERIODS[len(self.cfa)]

    @property
    def columns(self) -> int:
        """Columns of the mosaic: three a photosite where all three colours were read."""
        return self.width * (3 if self.cfa == LINEAR else 1)

    @property
    def has_exposure(self) -> bool:
        """Whether there is a shutter time one can divide by."""
        return self.exposure_s is not None and self.exposure_s > 0


def known_pattern(cfa: str) -> bool:
    """Return whether frames with this arrangement of colours can be merged."""
    return cfa in (*BAYER_PATTERNS, MONOCHROME, LINEAR) or (len(cfa) == 36 and set(cfa) == set("RGB"))


def light_of(info: FrameInfo, *, mixed_aperture: bool = False) -> float:
    """Return what a frame collects of a scene: seconds × ISO / 100 × transmission; by aperture area if asked.

    A missing ISO counts as 100; without a shutter time the result is 0.
    """
    time = float(info.exposure_s) if info.exposure_s is not None else 0.0
    light = time * (info.iso or 100.0) / 100.0 * sum(info.transmission) / 3.0
    return light / info.f_number**2 if mixed_aperture and info.f_number else light


def by_exposure(frames: Sequence[FrameInfo], *, mixed_aperture: bool = False) -> tuple[int, ...]:
    """Return the order that sorts `frames` from the least to the most light collected (see `light_of`).

    Frames without a shutter time come first. Ties are broken by name, so the order does not depend on the order given.
    The result indexes `frames`.
    """
    return tuple(
        sorted(range(len(frames)), key=lambda i: (light_of(frames[i], mixed_aperture=mixed_aperture), frames[i].name))
    )


def check_bracket(
    frames: Sequence[FrameInfo],
    *,
    allow_single: bool = True,
    mixed_iso: bool = False,
    mixed_aperture: bool = False,
) -> tuple[str, ...]:
    """Check that the frames differ in shutter time only, and return warnings.

    Parameters
    ----------
    frames
        One record a frame, in any order.
    allow_single
        A single frame is a warning; if False, a mistake.
    mixed_iso
        Let the ISO differ too (shutter times may then repeat, as long as time × ISO does not).
    mixed_aperture
        Let the aperture differ too; every frame must then tell it.

    Returns
    -------
    Warnings: things that cost quality, but leave the result right.

    Raises
    ------
    CalibrateError
        Lists every mistake, a line each: file, value, expectation, remedy.
    """
    if not frames:
        raise CalibrateError("bracket: 0 frames; at least one is needed. Check the pattern in `capture.reference`.")
    mistakes = [m for f in frames for m in _mistakes_within(f)]
    mistakes += _mistakes_between(frames, mixed_iso=mixed_iso, mixed_aperture=mixed_aperture)
    mistakes += _repeated(frames, mixed_aperture=mixed_aperture)
    if len(frames) == 1 and not allow_single:
        mistakes.append(
            f"{frames[0].name}: the only frame; a bracket has at least two. Add frames to `capture.reference`."
        )
    if mistakes:
        raise CalibrateError("\n".join(mistakes))
    return _warnings(frames, mixed_aperture=mixed_aperture)


def _mistakes_within(f: FrameInfo) -> list[str]:
    out = []
    if f.exposure_s is None:
        out.append(
            f"{f.name}: no exposure time in the file; the merge divides by it. Write it into the EXIF data "
            f"(tag ExposureTime), or {_OUT[0].lower()}{_OUT[1:]}."
        )
    elif f.exposure_s <= 0:
        out.append(
            f"{f.name}: exposure time {float(f.exposure_s):g} s; it must be above 0 (bulb exposures often record "
            f"0). Write the true time into the EXIF data (tag ExposureTime), or {_OUT[0].lower()}{_OUT[1:]}."
        )
    if not known_pattern(f.cfa):
        out.append(
            f"{f.name}: colour filter array {f.cfa!r}; a Bayer pattern ({', '.join(BAYER_PATTERNS)}), a 6×6 of R, G and "
            "B, one or three colours a photosite are merged. Use a camera with such a sensor."
        )
    if f.width < 4 or f.height < 4:
        out.append(f"{f.name}: {f.width}×{f.height} photosites; at least 4×4 are needed. {_OUT}.")
    for black, white in zip(f.black_dn, f.white_dn, strict=True):
        if not (math.isfinite(black) and math.isfinite(white) and 0 <= black < white):
            out.append(
                f"{f.name}: black level {black:g} and white level {white:g}; 0 ≤ black < white is expected. "
                "Correct the file's BlackLevel and WhiteLevel."
            )
            break
    return out


def _mistakes_between(frames: Sequence[FrameInfo], *, mixed_iso: bool, mixed_aperture: bool) -> list[str]:
    iso = [f.iso for f in frames]
    out = [
        *_odd_ones(frames, [f"camera {f.camera!r}" if f.camera else None for f in frames]),
        *_odd_ones(frames, [f"lens {f.lens!r}" if f.lens else None for f in frames]),
        *_odd_ones(frames, _focal_lengths(frames)),
        *_odd_ones(frames, [f"size {f.width}×{f.height}" for f in frames]),
        *_odd_ones(frames, [f"colour filter array {f.cfa}" for f in frames]),
        *_odd_ones(frames, [f"{f.bits} bits a sample" if f.bits else None for f in frames]),
        *_odd_ones(frames, [f"white level {_listed(f.white_dn)}" for f in frames]),
    ]
    if not mixed_iso:
        said = [f"ISO {v:g}" if v else None for v in iso]
        out += _odd_ones(frames, said, remedy=", or set `merge.mixed_iso: true`")
    elif any(iso) and not all(iso):
        out += [
            f"{f.name}: no ISO in the file; with `merge.mixed_iso: true` every frame needs one. "
            f"Write ISOSpeedRatings into the EXIF data, or set `merge.mixed_iso: false`."
            for f in frames
            if not f.iso
        ]
    if not mixed_aperture:
        said = [f"aperture f/{f.f_number:g}" if f.f_number else None for f in frames]
        out += _odd_ones(frames, said, remedy=", or set `merge.mixed_aperture: true`")
    else:
        out += [
            f"{f.name}: no aperture in the file; with `merge.mixed_aperture: true` every frame needs one. Write FNumber "
            "into the EXIF data, or give `merge.exposures` times that contain it and set it to false."
            for f in frames
            if not f.f_number
        ]
    return out + _strayed_blacks(frames)


def _focal_lengths(frames: Sequence[FrameInfo]) -> list[str | None]:
    """What each frame says of its focal length; what a zoom rounds differently is the same."""
    told = Counter(f.focal_length_mm for f in frames if f.focal_length_mm)
    usual = told.most_common(1)[0][0] if told else 0.0
    same = [
        v if v and abs(v - usual) > SAME_FOCAL_LENGTH * usual else v and usual
        for v in (f.focal_length_mm for f in frames)
    ]
    return [f"focal length {v:g} mm" if v else None for v in same]


def _odd_ones(frames: Sequence[FrameInfo], said: Sequence[str | None], *, remedy: str = "") -> list[str]:
    """Name every frame that says something else than most of them; None says nothing."""
    known = Counter(v for v in said if v is not None)
    if len(known) < 2:
        return []
    usual = known.most_common(1)[0][0]
    fellow = frames[said.index(usual)].name
    return [
        f"{f.name}: {v} differs from {usual} of {fellow}; a bracket may differ in shutter time only. {_OUT}{remedy}."
        for f, v in zip(frames, said, strict=True)
        if v is not None and v != usual
    ]


def _strayed_blacks(frames: Sequence[FrameInfo]) -> list[str]:
    reference = frames[0]
    limit = BLACK_TOLERANCE * (max(reference.white_dn) - min(reference.black_dn))
    return [
        f"{f.name}: black level {_listed(f.black_dn)} differs from {_listed(reference.black_dn)} of {reference.name} "
        f"by more than {BLACK_TOLERANCE:.0%} of the range. {_OUT}."
        for f in frames[1:]
        if any(abs(a - b) > limit for a, b in zip(f.black_dn, reference.black_dn, strict=True))
    ]


def _listed(values: tuple[float, ...]) -> str:
    return f"{values[0]:g}" if len(set(values)) == 1 else "/".join(f"{v:g}" for v in values)


def _repeated(frames: Sequence[FrameInfo], *, mixed_aperture: bool) -> list[str]:
    out = []
    timed = [f for f in frames if f.has_exposure]
    for i, f in enumerate(timed):
        for other in timed[:i]:
            if f.iso != other.iso or f.transmission != other.transmission:
                continue
            if mixed_aperture and f.f_number != other.f_number:
                continue
            if abs(_step_ev(other, f, mixed_aperture=mixed_aperture)) < SAME_EXPOSURE_EV:
                same = "the same file is listed twice" if f.name == other.name else "each exposure may occur once"
                out.append(
                    f"{f.name}: exposure {f.exposure_s} s is also that of {other.name}; {same}. "
                    f"Keep one of the two in `capture.reference` or `capture.environment`."
                )
                break
    return out


def _step_ev(shorter: FrameInfo, longer: FrameInfo, *, mixed_aperture: bool) -> float:
    low, high = (light_of(f, mixed_aperture=mixed_aperture) for f in (shorter, longer))
    return math.log2(high / low)


def _warnings(frames: Sequence[FrameInfo], *, mixed_aperture: bool) -> tuple[str, ...]:
    out = []
    if len(frames) == 1:
        out.append(
            f"{frames[0].name}: the only frame; what is clipped in it cannot be recovered. Add shorter exposures to "
            "the bracket."
        )
    order = [frames[i] for i in by_exposure(frames, mixed_aperture=mixed_aperture)]
    for shorter, longer in itertools.pairwise(order):
        step = _step_ev(shorter, longer, mixed_aperture=mixed_aperture)
        if step > WIDE_STEP_EV:
            out.append(
                f"{longer.name}: {step:.1f} EV above {shorter.name}, the next shorter frame; above "
                f"{WIDE_STEP_EV:g} EV the noise jumps visibly where this frame clips. Add a frame between them."
            )
    unknown = [f.name for f in frames if f.iso is None]
    if unknown:
        more = f" and {len(unknown) - 1} more" if unknown[1:] else ""
        out.append(
            f"{unknown[0]}{more}: no ISO in the file; the noise model takes it for 100, which only shifts "
            "the weights a little. Write ISOSpeedRatings into the EXIF data."
        )
    return tuple(out)
