"""Writes a Bayer mosaic as DNG 1.4, uncompressed or as lossless JPEG.

Layout: IFD0 holds the raw image in one strip (or, compressed, one tile); an EXIF IFD holds exposure time,
aperture and ISO, which LibRaw takes from there alone. Left out: previews, DNG's opcodes, maker notes.

Source: Adobe, Digital Negative Specification 1.4.0.0 (2012); TIFF 6.0 (1992); EXIF 2.3 (2012).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from samples.sensor import Camera, Counts, colour_matrix

Float64 = npt.NDArray[np.float64]

_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _SRATIONAL = 1, 2, 3, 4, 5, 10
_FORMATS = {_BYTE: "B", _ASCII: "B", _SHORT: "H", _LONG: "I", _RATIONAL: "I", _SRATIONAL: "i"}
_D65 = 21  # EXIF LightSource


class _Entry(NamedTuple):
    tag: int
    kind: int
    values: Sequence[int]

    @property
    def number(self) -> int:
        return len(self.values) // (2 if self.kind in (_RATIONAL, _SRATIONAL) else 1)

    @property
    def data(self) -> bytes:
        return struct.pack(f"<{len(self.values)}{_FORMATS[self.kind]}", *self.values)


def _text(tag: int, text: str) -> _Entry:
    return _Entry(tag, _ASCII, [*text.encode("ascii"), 0])


def _signed(tag: int, values: Float64, denominator: int = 10000) -> _Entry:
    pairs = [n for value in values.ravel() for n in (round(float(value) * denominator), denominator)]
    return _Entry(tag, _SRATIONAL, pairs)


def _directory(entries: Sequence[_Entry], start: int) -> bytes:
    """Return an IFD that begins at byte `start`, its long values behind it."""
    ordered = sorted(entries)
    table = struct.pack("<H", len(ordered))
    tail = b""
    behind = start + 2 + 12 * len(ordered) + 4
    for entry in ordered:
        data = entry.data
        if len(data) > 4:
            place = struct.pack("<I", behind + len(tail))
            tail += data + b"\0" * (len(data) % 2)
        else:
            place = data.ljust(4, b"\0")
        table += struct.pack("<HHI", entry.tag, entry.kind, entry.number) + place
    return table + struct.pack("<I", 0) + tail


def lossless_jpeg(counts: Counts, bits: int) -> bytes:
    """Return `counts` as one lossless JPEG (ITU-T T.81, process 14), coded two rows to a line.

    An even and an odd row side by side keep colours of the mosaic below each other, so that the upper
    neighbour predicts; readers of DNG unroll it by the tile's width. Needs imagecodecs.
    """
    import imagecodecs

    height, width = counts.shape
    return bytes(imagecodecs.ljpeg_encode(counts.reshape(height // 2, 2 * width), bitspersample=bits))


def encode_dng(
    counts: Counts,
    exposure_s: Fraction,
    *,
    camera: Camera,
    neutral: Float64,
    compressed: bool = False,
    settings: dict[str, object] | None = None,
) -> bytes:
    """Return the bytes of a DNG of `counts`, shape (height, width), uint16.

    `neutral` (3,) is camera RGB of the light's white. `settings` replaces or, with None, drops EXIF values
    by name ("exposure_s", "iso", "f_number", "model", "lens"), or adds "focal_length_mm" and "distance_m": for captures
    with a mistake in them, or with a lens. Raises
    ValueError if a compressed height is odd.
    """
    height, width = counts.shape
    if compressed and height % 2:
        raise ValueError(f"height {height}: a compressed mosaic needs an even height; write it uncompressed")
    given: dict[str, object] = {
        "exposure_s": exposure_s, "iso": camera.iso, "f_number": camera.f_number, "model": camera.model,
        "lens": "Ideal equirectangular", "focal_length_mm": None, "distance_m": None, **(settings or {}),
    }  # fmt: skip
    pixels = lossless_jpeg(counts, camera.bits) if compressed else counts.astype("<u2").tobytes()
    exif = _exif_entries(given)
    colours = ["RGB".index(letter) for letter in camera.cfa]
    neutral_values = np.round(neutral * 10000).astype(int).tolist()
    entries = [
        _Entry(254, _LONG, [0]),  # NewSubfileType: the full image
        _Entry(256, _LONG, [width]),
        _Entry(257, _LONG, [height]),
        _Entry(258, _SHORT, [camera.bits if compressed else 16]),
        _Entry(259, _SHORT, [7 if compressed else 1]),
        _Entry(262, _SHORT, [32803]),  # PhotometricInterpretation: colour filter array
        _text(271, camera.make),
        _text(272, str(given["model"])),
        _Entry(274, _SHORT, [1]),  # Orientation: as stored
        _Entry(277, _SHORT, [1]),
        _Entry(284, _SHORT, [1]),
        _text(305, "envcal samples"),
        _text(306, "2026:01:01 12:00:00"),
        _Entry(33421, _SHORT, [2, 2]),  # CFARepeatPatternDim
        _Entry(33422, _BYTE, colours),
        _Entry(50706, _BYTE, [1, 4, 0, 0]),  # DNGVersion
        _Entry(50707, _BYTE, [1, 1, 0, 0]),  # DNGBackwardVersion
        _text(50708, f"{camera.make} {given['model']}"),  # UniqueCameraModel
        _Entry(50710, _BYTE, [0, 1, 2]),  # CFAPlaneColor
        _Entry(50711, _SHORT, [1]),  # CFALayout: rectangular
        _Entry(50713, _SHORT, [2, 2]),  # BlackLevelRepeatDim
        _Entry(50714, _SHORT, list(camera.black_dn)),
        _Entry(50717, _LONG, [camera.white_dn]),
        _Entry(50719, _SHORT, [0, 0]),  # DefaultCropOrigin
        _Entry(50720, _LONG, [width, height]),
        _signed(50721, colour_matrix(camera.sensitivities)),
        _Entry(50728, _RATIONAL, [n for value in neutral_values for n in (value, 10000)]),
        _Entry(50778, _SHORT, [_D65]),
        _Entry(50829, _LONG, [0, 0, height, width]),  # ActiveArea
    ]
    if compressed:
        entries += [_Entry(322, _LONG, [width]), _Entry(323, _LONG, [height])]
        where, size = 324, 325
    else:
        entries.append(_Entry(278, _LONG, [height]))
        where, size = 273, 279
    entries.append(_Entry(size, _LONG, [len(pixels)]))
    # The IFDs' lengths do not depend on the places that they name.
    exif_start = 8 + len(_directory([*entries, _Entry(where, _LONG, [0]), _Entry(34665, _LONG, [0])], 8))
    data_start = (exif_start + len(_directory(exif, exif_start)) + 15) // 16 * 16
    entries += [_Entry(where, _LONG, [data_start]), _Entry(34665, _LONG, [exif_start])]
    head = struct.pack("<2sHI", b"II", 42, 8) + _directory(entries, 8) + _directory(exif, exif_start)
    return head.ljust(data_start, b"\0") + pixels


def _exif_entries(given: dict[str, object]) -> list[_Entry]:
    entries = [
        _Entry(36864, _BYTE, list(b"0230")),
        _text(36867, "2026:01:01 12:00:00"),
        _text(42036, str(given["lens"])),  # LensModel
    ]
    # ExposureTime, FNumber, SubjectDistance, FocalLength
    for tag, name in ((33434, "exposure_s"), (33437, "f_number"), (37382, "distance_m"), (37386, "focal_length_mm")):
        value = given[name]
        if value is not None:
            ratio = Fraction(str(value))
            entries.append(_Entry(tag, _RATIONAL, [ratio.numerator, ratio.denominator]))
    if given["iso"] is not None:
        entries.append(_Entry(34855, _SHORT, [int(str(given["iso"]))]))
    return entries
