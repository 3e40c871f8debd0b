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

# 4 EV leave a sixteenth of the light, so noise four times worse, just above where the longer frame clips.
WIDE_STEP_EV = 4.0

# Shutter times closer than this are one nominal setting (EXIF writes 1/30 and 0.0333 for the same third of a stop).
SAME_EXPOSURE_EV = 0.02

# Some cameras measure their black anew for every frame; beyond this share of the range it is another format.
BLACK_TOLERANCE = 0.01

_OUT = "Move the file out of the bracket (`capture.reference` or `capture.environment`)"


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
        Colours of the top-left 2×2 of the visible area, row by row: "RGGB", "BGGR", "GRBG" or "GBRG".
    black_dn, white_dn
        Black and saturation level in raw counts at the positions (0,0), (0,1), (1,0), (1,1) of that 2×2.
    bits
        Bits a sample, None where unknown.
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
    black_dn: tuple[float, float, float, float]
    white_dn: tuple[float, float, float, float]
    bits: int | None

    @property
    def has_exposure(self) -> bool:
        """Whether there is a shutter time one can divide by."""
        return self.exposure_s is not None and self.exposure_s > 0


def by_exposure(frames: Sequence[FrameInfo]) -> tuple[int, ...]:
    """Return the order that sorts `frames` from the least to the most light collected.

    Light is shutter time × ISO (a missing ISO counts as 100); frames without a shutter time come first. Ties are
    broken by name, so the order does not depend on the order given. The result indexes `frames`.
    """

    def light(i: int) -> tuple[float, str]:
        info = frames[i]
        time = float(info.exposure_s) if info.exposure_s is not None else 0.0
        return time * (info.iso or 100.0), info.name

    return tuple(sorted(range(len(frames)), key=light))


def check_bracket(
    frames: Sequence[FrameInfo], *, allow_single: bool = True, mixed_iso: bool = False
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
    mistakes += _mistakes_between(frames, mixed_iso=mixed_iso)
    mistakes += _repeated(frames, mixed_iso=mixed_iso)
    if len(frames) == 1 and not allow_single:
        mistakes.append(
            f"{frames[0].name}: the only frame; a bracket has at least two. Add frames to `capture.reference`."
        )
    if mistakes:
        raise CalibrateError("\n".join(mistakes))
    return _warnings(frames)


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
    if f.cfa not in BAYER_PATTERNS:
        out.append(
            f"{f.name}: colour filter array {f.cfa!r}; only Bayer mosaics are merged ({', '.join(BAYER_PATTERNS)}). "
            "Use a camera with a Bayer sensor."
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


def _mistakes_between(frames: Sequence[FrameInfo], *, mixed_iso: bool) -> list[str]:
    iso = [f.iso for f in frames]
    out = [
        *_odd_ones(frames, [f"camera {f.camera!r}" if f.camera else None for f in frames]),
        *_odd_ones(frames, [f"lens {f.lens!r}" if f.lens else None for f in frames]),
        *_odd_ones(frames, [f"size {f.width}×{f.height}" for f in frames]),
        *_odd_ones(frames, [f"colour filter array {f.cfa}" for f in frames]),
        *_odd_ones(frames, [f"aperture f/{f.f_number:g}" if f.f_number else None for f in frames]),
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
    return out + _strayed_blacks(frames)


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


def _repeated(frames: Sequence[FrameInfo], *, mixed_iso: bool) -> list[str]:
    out = []
    timed = [f for f in frames if f.has_exposure]
    for i, f in enumerate(timed):
        for other in timed[:i]:
            if mixed_iso and f.iso != other.iso:
                continue
            if abs(_step_ev(other, f)) < SAME_EXPOSURE_EV:
                same = "the same file is listed twice" if f.name == other.name else "each exposure may occur once"
                out.append(
                    f"{f.name}: exposure {f.exposure_s} s is also that of {other.name}; {same}. "
                    f"Keep one of the two in `capture.reference` or `capture.environment`."
                )
                break
    return out


def _step_ev(shorter: FrameInfo, longer: FrameInfo) -> float:
    if shorter.exposure_s is None or longer.exposure_s is None:
        raise AssertionError("both frames have an exposure time by now")
    return math.log2(longer.exposure_s / shorter.exposure_s)


def _warnings(frames: Sequence[FrameInfo]) -> tuple[str, ...]:
    out = []
    if len(frames) == 1:
        out.append(
            f"{frames[0].name}: the only frame; what is clipped in it cannot be recovered. Add shorter exposures to "
            "the bracket."
        )
    order = [frames[i] for i in by_exposure(frames)]
    for shorter, longer in itertools.pairwise(order):
        step = _step_ev(shorter, longer) + math.log2((longer.iso or 100.0) / (shorter.iso or 100.0))
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
