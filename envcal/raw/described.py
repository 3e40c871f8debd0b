"""What an opened RAW file says about itself → `FrameInfo`: pattern, levels, masked border, exposure."""

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from calibrate.exposure import BAYER_PATTERNS, LINEAR, MONOCHROME, FrameInfo, Masked, known_pattern
from envcal.errors import EnvcalError
from envcal.raw.exif import numbers, of_mosaic, positive, text

_LARGEST_SIDE = 65_535
_INFINITE = 2**32 - 1  # EXIF SubjectDistance

# Finer than any shutter scale: turns LibRaw's float32 back into the fraction it was (0.0333333351 → 1/30).
_SHUTTER_DENOMINATOR = 20_000

# Of a masked border, the rows and columns beside the picture may still see some light, the outermost are often empty.
_INNER_MARGIN, _OUTER_MARGIN = 4, 2

# LibRaw's patterns repeat after 2, 6, 8 or 16 photosites.
_PERIOD = 48


def described(path: Path, raw: Any, exif: Mapping[str, Any]) -> FrameInfo:
    cfa, colours = _pattern(path, raw)
    other = raw.other
    exposure = positive(numbers(exif, "ExposureTime"))
    if exposure is None and other.shutter_speed > 0:
        exposure = Fraction(float(other.shutter_speed)).limit_denominator(_SHUTTER_DENOMINATOR)
    iso = float(other.iso_speed) or float(positive(numbers(exif, "ISOSpeedRatings")) or 0)
    f_number = float(positive(numbers(exif, "FNumber")) or 0) or float(other.aperture)
    make, model = text(exif, "Image Make"), text(exif, "Image Model")
    height, width = raw.raw_image_visible.shape[:2]
    if max(height, width) > _LARGEST_SIDE:
        raise EnvcalError(
            f"{path}: {width}×{height} photosites; at most {_LARGEST_SIDE} a side are expected. The file may be damaged: "
            "copy it from the card again."
        )
    white = _white(raw)
    blacks = _blacks(raw, colours, exif)
    whites = tuple(white[c] for c in colours)
    period = (2, 2) if cfa in BAYER_PATTERNS else (1, 1) if cfa == MONOCHROME else (6, 6)
    return FrameInfo(
        name=str(path),
        exposure_s=exposure if exposure else None,
        iso=iso or None,
        f_number=f_number or None,
        camera=model if model.lower().startswith(make.lower()) else f"{make} {model}".strip(),
        lens=text(exif, "EXIF LensModel") or str(raw.lens.model).strip(),
        width=width,
        height=height,
        cfa=cfa,
        black_dn=blacks,
        white_dn=whites,
        bits=math.ceil(math.log2(raw.white_level + 1)) if raw.white_level > 0 else None,
        masked=None if cfa == LINEAR else _masked(raw, period, blacks, whites),
        focal_length_mm=float(positive(numbers(exif, "FocalLength")) or 0) or float(other.focal_length) or None,
        focus_distance_m=_distance(exif),
    )


def _distance(exif: Mapping[str, Any]) -> float | None:
    """Return the focus distance in metres; EXIF writes infinity as a numerator of 2³² − 1, and unknown as 0."""
    found = positive(numbers(exif, "SubjectDistance"))
    if found is None:
        return None
    return math.inf if found.numerator >= _INFINITE else float(found)


def _pattern(path: Path, raw: Any) -> tuple[str, tuple[int, ...]]:
    """Return the pattern's letters and LibRaw's colour indices (second green: 3); refuse what cannot be merged."""
    import rawpy

    if raw.raw_type != rawpy.RawType.Flat:
        planes = raw.raw_image_visible.shape[-1] if raw.raw_image_visible.ndim == 3 else 1
        if planes >= 3 and raw.num_colors == 3:
            return LINEAR, (0, 1, 2)
        what = f"{planes} samples at every photosite and {raw.num_colors} colours"
    elif raw.num_colors == 1:
        return MONOCHROME, (0,)
    else:
        side = 6 if raw.raw_pattern is not None and raw.raw_pattern.shape == (6, 6) else 2
        sizes = raw.sizes
        colours = np.array(
            [
                [raw.raw_color(sizes.top_margin + y, sizes.left_margin + x) for x in range(min(_PERIOD, sizes.width))]
                for y in range(min(_PERIOD, sizes.height))
            ]
        )
        corner = colours[:side, :side]
        repeats = corner.shape == (side, side) and all(
            np.all(colours[r::side, c::side] == corner[r, c]) for r in range(side) for c in range(side)
        )
        letters = "".join("RGBG"[c] if c < 4 else "?" for c in corner.ravel())
        if repeats and known_pattern(letters):
            return letters, tuple(int(c) for c in corner.ravel())
        what = f"the colour pattern {letters}{'' if repeats else ', which does not repeat'}"
    raise EnvcalError(
        f"{path}: {what}; a Bayer mosaic ({', '.join(BAYER_PATTERNS)}), a 6×6 one of red, green and blue, or one or three "
        "colours at every photosite are expected. Photograph with a camera that has such a sensor, or convert the file "
        "to linear DNG with a RAW converter."
    )


def _masked(raw: Any, period: tuple[int, int], blacks: Sequence[float], whites: Sequence[float]) -> Masked | None:
    """Return what the masked border reads: the left or the upper one, whichever is the quieter."""
    from calibrate.merge.levels import masked_black

    sizes, whole = raw.sizes, raw.raw_image
    top, left = sizes.top_margin, sizes.left_margin
    found = []
    for along, margin in ((0, left), (1, top)):
        first = _OUTER_MARGIN + (margin - _OUTER_MARGIN) % period[1 - along]
        last = margin - _INNER_MARGIN
        if last - first < period[1 - along]:
            continue
        side, upper = np.s_[top : top + sizes.height, first:last], np.s_[first:last, left : left + sizes.width]
        strip = whole[side if along == 0 else upper]
        measured = masked_black([strip], period, blacks, whites)
        if measured is not None:
            found.append(measured)
    return min(found, key=lambda m: m.noise_dn) if found else None


def _white(raw: Any) -> list[float]:
    """Return the saturation level a colour: the camera's own where it tells one, never above the format's."""
    own = raw.camera_white_level_per_channel or [0, 0, 0, 0]
    return [float(min(w, raw.white_level) if w > 0 else raw.white_level) for w in own]


def _blacks(raw: Any, colours: tuple[int, ...], exif: Mapping[str, Any]) -> tuple[float, ...]:
    """Return black by position.

    LibRaw gives it by colour and cuts fractions off, and where a DNG's active area starts at an odd row or column (which
    LibRaw rounds up) it gives the levels of the wrong neighbours. The DNG's own tag, whose pattern starts at the corner
    of the active area (DNG specification 1.6, BlackLevelRepeatDim), is therefore preferred if it tells the same levels.
    """
    by_colour = raw.black_level_per_channel
    black = [float(by_colour[c]) for c in colours]
    tag = [float(v) for v in of_mosaic(exif, "BlackLevel")]
    told = tag * 4 if len(tag) == 1 else tag
    if len(black) == len(told) == 4 and sorted(math.floor(v) for v in told) == sorted(black):
        # Tag 0xC68D is ActiveArea, which ExifRead does not name.
        area = of_mosaic(exif, "0xC68D") or of_mosaic(exif, "ActiveArea") or [Fraction(0)] * 2
        down, across = raw.sizes.top_margin - int(area[0]), raw.sizes.left_margin - int(area[1])
        black = [told[2 * ((r + down) % 2) + (c + across) % 2] for r in (0, 1) for c in (0, 1)]
    return tuple(black)
