"""RAW files → what a frame says about itself, and its mosaic. The only module that imports rawpy.

LibRaw opens more than it can give: a float DNG arrives as rounded integers, a damaged one as zeros or as whatever the
memory held. Whatever is not a mosaic (Bayer, 6×6, monochrome) or a linear image of integers with something recorded in
it is refused here, by name and with a remedy. Orientation is left alone: mosaics are never rotated. The three colours of
a linear frame stand side by side in the rows of its mosaic.
"""

import dataclasses
import logging
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from calibrate.exposure import BAYER_PATTERNS, LINEAR, MONOCHROME, FrameInfo, Masked, known_pattern
from envcal.errors import EnvcalError

Counts = npt.NDArray[np.uint16]
Matrix = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

# DNG: ColorMatrix2 and its CalibrationIlluminant2, the same of 1; 21 is EXIF's D65.
_DNG_MATRICES = (("0xC622", "0xC65B"), ("0xC621", "0xC65A"))
_DNG_D65 = 21

# LibRaw gives zeros for a camera it does not know; matrices of real ones have determinants from 0.05 on.
_LEAST_DETERMINANT = 1e-3

_LARGEST_SIDE = 65_535
_JPEG_XL = 52_546  # TIFF Compression, DNG 1.7
_FLOAT = 3  # TIFF SampleFormat
_RAW_PHOTOMETRIC = (32_803, 34_892)  # DNG: colour filter array, linear RAW

# Above the range of the bits only stray values are credible (a defect map, a marked row); more is another memory's.
_STRAY_SHARE = 0.01

# Finer than any shutter scale: turns LibRaw's float32 back into the fraction it was (0.0333333351 → 1/30).
_SHUTTER_DENOMINATOR = 20_000

# Of a masked border, the rows and columns beside the picture may still see some light, the outermost are often empty.
_INNER_MARGIN, _OUTER_MARGIN = 4, 2

# Mosaics that stay in memory after they were decoded to be checked: 14 bytes a photosite, which with the merge's own 18
# stays below what writing the picture takes. Longer brackets are decoded again in every pass.
KEPT_MOSAICS = 7

_CONVERT = "Convert it to DNG (uncompressed or lossless) with a RAW converter, or take the file out of the bracket"


def rawpy_version() -> str:
    """Return the versions of rawpy and LibRaw, for the provenance of what was read."""
    import rawpy

    return f"rawpy {rawpy.__version__}, LibRaw {'.'.join(map(str, rawpy.libraw_version))}"


def read_info(path: Path | str) -> FrameInfo:
    """Return what a RAW frame says about itself; the file is decoded once to see that it can be.

    Exposure time and aperture are EXIF's exact rationals where ExifRead understands the file, else LibRaw's; zero
    counts as missing. Levels are in the order of the positions of the pattern at the visible area's top left.

    Raises
    ------
    EnvcalError
        The file is missing, unreadable, damaged, empty, or no mosaic of integers.
    """
    return read_frame(path)[0]


def read_mosaic(path: Path | str) -> Counts:
    """Return the raw counts of the visible area: shape (height, columns), uint16, black not subtracted.

    Raises
    ------
    EnvcalError
        As `read_info`.
    """
    return read_frame(path)[1]


def read_frame(path: Path | str) -> tuple[FrameInfo, Counts]:
    """Return what a frame says about itself and its raw counts, from one decoding (see `read_info`, `read_mosaic`)."""
    path = Path(path)
    exif = _exif(path)
    with _opened(path, exif) as raw:
        info = _described(path, raw, exif)
        visible = raw.raw_image_visible
        mosaic: Counts = visible[..., :3].reshape(info.height, info.columns) if info.cfa == LINEAR else visible.copy()
        mosaic = np.ascontiguousarray(mosaic)
        _refuse_empty(mosaic, info)
    return info, mosaic


def camera_from_xyz(path: Path | str) -> Matrix | None:
    """Return the matrix [3][3] from XYZ to camera RGB under D65 that LibRaw or the file itself knows, None without one."""
    path = Path(path)
    exif = _exif(path)
    known = np.zeros((3, 3))
    for matrix, illuminant in _DNG_MATRICES:
        values = _numbers(exif, matrix)
        if _numbers(exif, illuminant)[:1] == [_DNG_D65] and len(values) == 9:
            known = np.array([float(v) for v in values]).reshape(3, 3)
    if not known.any():
        with _opened(path, exif) as raw:
            known = np.asarray(raw.rgb_xyz_matrix, np.float64)[:3]
    if known.shape != (3, 3) or not np.isfinite(known).all() or abs(np.linalg.det(known)) < _LEAST_DETERMINANT:
        return None
    a, b, c = ((float(x), float(y), float(z)) for x, y, z in known)
    return a, b, c


class RawFrame:
    """A RAW file as a frame of a bracket: `info` is read once, `mosaic()` decodes anew unless `kept` holds the counts."""

    def __init__(self, path: Path | str, *, info: FrameInfo | None = None, kept: Counts | None = None) -> None:
        self.path = Path(path)
        self._kept = kept
        if info is not None:
            self.info = info

    def __repr__(self) -> str:
        return f"RawFrame({str(self.path)!r})"

    @cached_property
    def info(self) -> FrameInfo:
        """What the file says about itself (see `read_info`)."""
        return read_info(self.path)

    def mosaic(self) -> Counts:
        """Decode the file (see `read_mosaic`); not to be written to."""
        return read_mosaic(self.path) if self._kept is None else self._kept

    def described(self, **changed: Any) -> "RawFrame":
        """Return the same frame with parts of its `info` replaced."""
        return RawFrame(self.path, info=dataclasses.replace(self.info, **changed), kept=self._kept)


def open_bracket(paths: Sequence[Path], *, keep: int = KEPT_MOSAICS) -> list[RawFrame]:
    """Decode every file once, two at a time, check it, and keep the first `keep` mosaics in memory.

    Raises
    ------
    EnvcalError
        The mistakes of all files, a line each.
    """

    def opened(item: tuple[int, Path]) -> RawFrame | EnvcalError:
        number, path = item
        try:
            info, mosaic = read_frame(path)
        except EnvcalError as error:
            return error
        return RawFrame(path, info=info, kept=mosaic if number < keep else None)

    # LibRaw lets go of the interpreter while it decodes; more than two at a time would cost memory.
    with ThreadPoolExecutor(min(2, os.cpu_count() or 1)) as pool:
        found = list(pool.map(opened, enumerate(paths)))
    mistakes = [str(f) for f in found if isinstance(f, EnvcalError)]
    if mistakes:
        raise EnvcalError("\n".join(mistakes))
    return [f for f in found if isinstance(f, RawFrame)]


@contextmanager
def _opened(path: Path, exif: Mapping[str, Any]) -> Iterator[Any]:
    """Open and unpack with LibRaw; every way in which that fails becomes one message."""
    import rawpy

    _refuse_unsuited(path, exif)
    try:
        with rawpy.imread(str(path)) as raw:
            raw.unpack()
            yield raw
    except rawpy.LibRawFileUnsupportedError as error:
        raise EnvcalError(
            f"{path}: not a RAW file that {rawpy_version()} knows; a Bayer RAW file is expected. {_CONVERT}."
        ) from error
    except (rawpy.LibRawError, rawpy.NotSupportedError) as error:
        said = error.args[0] if error.args else error
        said = said.decode(errors="replace") if isinstance(said, bytes) else said
        raise EnvcalError(
            f"{path}: cannot be decoded ({said}); a complete RAW file is expected. Copy it from the card again; if that "
            "does not help, take it out of the bracket."
        ) from error


def _refuse_unsuited(path: Path, exif: Mapping[str, Any]) -> None:
    """Refuse what LibRaw would fail on in unclear words, or decode wrongly without any."""
    if not path.is_file():
        raise EnvcalError(f"{path}: no such file; a RAW file is expected. Check the path or pattern.")
    if path.stat().st_size == 0:
        raise EnvcalError(f"{path}: 0 bytes; a RAW file is expected. Copy it from the card again.")
    if _FLOAT in _of_mosaic(exif, "SampleFormat"):
        raise EnvcalError(
            f"{path}: floating-point samples; integers are expected (this is a merged or processed file, not a frame). "
            "Give the frames it was made from."
        )
    if _JPEG_XL in _of_mosaic(exif, "Compression"):
        raise EnvcalError(f"{path}: compressed as JPEG XL, which {rawpy_version()} does not decode. {_CONVERT}.")


def _exif(path: Path) -> dict[str, Any]:
    """Return EXIF tags by the name after their directory's; empty where ExifRead does not know the format."""
    import exifread

    # It reports every odd tag of a maker's private directory.
    logging.getLogger("exifread").setLevel(logging.CRITICAL + 1)
    if not path.is_file():
        return {}
    try:
        with path.open("rb") as file:
            tags = exifread.process_file(file, details=False)
    except Exception as error:
        # Whatever it stumbles over in a damaged file, LibRaw has the last word on whether the file is readable.
        logging.getLogger(__name__).debug("%s: ExifRead: %s", path, error)
        return {}
    return {name: tag for name, tag in tags.items() if hasattr(tag, "values")}


def _numbers(exif: Mapping[str, Any], tag: str) -> list[Fraction]:
    """Return the values of a tag in all directories of the file, as far as they are numbers."""
    out = []
    for name, entry in exif.items():
        if name.split()[-1] != tag or not isinstance(entry.values, list):
            continue
        for value in entry.values:
            try:
                out.append(Fraction(value))
            except (TypeError, ValueError, ZeroDivisionError):
                continue
    return out


def _of_mosaic(exif: Mapping[str, Any], tag: str) -> list[Fraction]:
    """Return the numbers of a tag in the TIFF directory of the RAW data; previews and masks have directories too."""
    for name, entry in exif.items():
        directory, _, last = name.rpartition(" ")
        if last == "PhotometricInterpretation" and entry.values and entry.values[0] in _RAW_PHOTOMETRIC:
            return _numbers({n: e for n, e in exif.items() if n.startswith(f"{directory} ")}, tag)
    return []


def _text(exif: Mapping[str, Any], *names: str) -> str:
    return next((str(exif[n]).strip() for n in names if n in exif and str(exif[n]).strip()), "")


def _positive(values: list[Fraction]) -> Fraction | None:
    return next((v for v in values if v > 0), None)


def _described(path: Path, raw: Any, exif: Mapping[str, Any]) -> FrameInfo:
    cfa, colours = _pattern(path, raw)
    other = raw.other
    exposure = _positive(_numbers(exif, "ExposureTime"))
    if exposure is None and other.shutter_speed > 0:
        exposure = Fraction(float(other.shutter_speed)).limit_denominator(_SHUTTER_DENOMINATOR)
    iso = float(other.iso_speed) or float(_positive(_numbers(exif, "ISOSpeedRatings")) or 0)
    f_number = float(_positive(_numbers(exif, "FNumber")) or 0) or float(other.aperture)
    make, model = _text(exif, "Image Make"), _text(exif, "Image Model")
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
        lens=_text(exif, "EXIF LensModel") or str(raw.lens.model).strip(),
        width=width,
        height=height,
        cfa=cfa,
        black_dn=blacks,
        white_dn=whites,
        bits=math.ceil(math.log2(raw.white_level + 1)) if raw.white_level > 0 else None,
        masked=None if cfa == LINEAR else _masked(raw, period, blacks, whites),
    )


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
        colours = raw.raw_colors_visible
        side = 6 if raw.raw_pattern is not None and raw.raw_pattern.shape == (6, 6) else 2
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
    tag = [float(v) for v in _of_mosaic(exif, "BlackLevel")]
    told = tag * 4 if len(tag) == 1 else tag
    if len(black) == len(told) == 4 and sorted(math.floor(v) for v in told) == sorted(black):
        # Tag 0xC68D is ActiveArea, which ExifRead does not name.
        area = _of_mosaic(exif, "0xC68D") or _of_mosaic(exif, "ActiveArea") or [Fraction(0)] * 2
        down, across = raw.sizes.top_margin - int(area[0]), raw.sizes.left_margin - int(area[1])
        black = [told[2 * ((r + down) % 2) + (c + across) % 2] for r in (0, 1) for c in (0, 1)]
    return tuple(black)


def _refuse_empty(mosaic: Counts, info: FrameInfo) -> None:
    """Refuse a frame in which nothing was recorded, or something that cannot have been."""
    rows, columns = info.period
    places = [mosaic[k // columns :: rows, k % columns :: columns] for k in range(rows * columns)]
    # Nearly always the first of a thousand samples tell.
    if all(p[::31, ::31].max() <= b and p.max() <= b for p, b in zip(places, info.black_dn, strict=True)):
        raise EnvcalError(
            f"{info.name}: no sample above the black level {max(info.black_dn):g}; an exposed frame is expected. The "
            "file is damaged, or the lens was covered: copy it from the card again, or take it out of the bracket."
        )
    if mosaic[::31, ::31].min() == mosaic[::31, ::31].max() and mosaic.min() == mosaic.max() < min(info.white_dn):
        raise EnvcalError(
            f"{info.name}: every sample is {int(mosaic.max())}; a photograph has noise. The file is damaged: copy it from "
            "the card again, or take it out of the bracket."
        )
    if info.bits is not None:
        largest = 2**info.bits - 1
        # A share of one per cent shows in any sample of some thousands.
        some = mosaic[::7, ::7] if mosaic.size > 1 << 20 else mosaic
        stray = float(np.mean(some > largest)) if some.max() > largest else 0.0
        if stray > _STRAY_SHARE:
            raise EnvcalError(
                f"{info.name}: {stray:.0%} of the samples are above {largest}, the largest that its white level "
                f"{max(info.white_dn):g} allows. The file is damaged or its WhiteLevel wrong: copy it from the card "
                "again, or correct the tag."
            )
