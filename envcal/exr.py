"""OpenEXR files, streamed by rows. The only module that imports OpenEXR.

The library has habits that would harm an image silently: it writes arrays that are not C-contiguous wrongly,
turns half floats above 65504 into infinity and opens truncated files with no more than a printed line. All of
that is caught here. Header attributes beyond OpenEXR's own are strings, floats and integers; anything richer is JSON.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt

from envcal.atomic import replacing
from envcal.errors import EnvcalError

#: A side longer than this is taken for a damaged or hostile header.
LONGEST_SIDE = 65_536
#: Pixels of one image at most; 32768 × 16384, twice a 16k map a side.
MOST_PIXELS = 1 << 29
_PIXEL_TYPES = {"f4": "FLOAT", "f2": "HALF", "u4": "UINT"}
_LATLONG = 0
#: The legacy writer is the only one that streams rows, but it knows no envmap attribute and stores chromaticities
#: as whatever its memory held (zeros, mostly). Both are put right in place afterwards, and no offset in the file moves:
#: envmap goes in as a string of one byte (both type names have six letters), and the 32 bytes of the chromaticities
#: are written over.
_ENVMAP_WRITTEN = b"envmap\0string\0\x01\0\0\0L"
_ENVMAP_MEANT = b"envmap\0envmap\0\x01\0\0\0" + bytes([_LATLONG])
_CHROMATICITIES = b"chromaticities\0chromaticities\0\x20\0\0\0"

Plane = npt.NDArray[Any]
#: `rle` is for files that one stage hands to the next: of camera noise it leaves 8 % more than `zip`, in a quarter of the time;
#: `none` leaves a third more than that, in a quarter of its time.
Compression = Literal["zip", "rle", "none"]
_OF_LIBRARY: Mapping[Compression, str] = {"zip": "ZIP_COMPRESSION", "rle": "RLE_COMPRESSION", "none": "NO_COMPRESSION"}
#: Rows that are converted at a time: a picture is never copied as a whole.
_BAND = 128


class Writer:
    """An EXR file written band by band from the top; it takes its name only when it is whole.

    Parameters
    ----------
    path
        Where the file will stand.
    size
        (height, width) in pixels.
    channels
        Name → "f4", "f2" or "u4".
    attributes
        `chromaticities` (8 floats) and `whiteLuminance` in OpenEXR's own types, `envmap` True for a lat-long map;
        every other value is stored as a string (JSON unless it is a string already), a float or an int.
    compression
        All are lossless; the library compresses on all cores.
    """

    def __init__(
        self,
        path: Path,
        size: tuple[int, int],
        *,
        channels: Mapping[str, str],
        attributes: Mapping[str, Any],
        compression: Compression = "zip",
    ) -> None:
        self.path, self.size, self.channels = path, size, dict(channels)
        self._attributes = dict(attributes)
        self._compression = compression
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Self:
        import Imath
        import OpenEXR

        height, width = self.size
        self._latlong = bool(self._attributes.pop("envmap", False))
        header = OpenEXR.Header(width, height)
        header["compression"] = Imath.Compression(getattr(Imath.Compression, _OF_LIBRARY[self._compression]))
        header["channels"] = {
            name: Imath.Channel(Imath.PixelType(getattr(Imath.PixelType, _PIXEL_TYPES[kind])))
            for name, kind in self.channels.items()
        }
        if self._latlong:
            header["envmap"] = b"L"
        for name, value in self._attributes.items():
            header[name] = _attribute(name, value)
        self._part = self._stack.enter_context(replacing(self.path))
        try:
            OpenEXR.set_global_thread_count(os.cpu_count() or 1)
            self._file = OpenEXR.OutputFile(str(self._part), header)
        except BaseException:
            self._stack.__exit__(OSError, OSError("OpenEXR cannot create the file"), None)
            raise
        self._row = 0
        return self

    def rows(self, planes: Mapping[str, Plane]) -> None:
        """Append a band: one [rows, width] array per channel. Values are converted to the channel's type."""
        missing = self.channels.keys() ^ planes.keys()
        assert not missing, f"channels differ: {missing}"
        count = len(next(iter(planes.values())))
        band = {}
        for name, plane in planes.items():
            assert plane.shape == (count, self.size[1]), f"{name}: {plane.shape} in a band of {count} rows"
            with np.errstate(over="ignore"):
                data = np.ascontiguousarray(plane, dtype=self.channels[name])
            if self.channels[name] == "f2" and np.isinf(data).any() and not np.isinf(plane).any():
                raise EnvcalError(
                    f"{self.path}: channel {name} holds {float(np.nanmax(plane)):.4g}, more than a half float can "
                    f"(65504). Write full floats: `spectra.half: false`, or leave out --half."
                )
            band[name] = data
        try:
            self._file.writePixels(band, count)
        except (OSError, RuntimeError) as error:
            raise _write_failure(self.path, error) from error
        self._row += count

    def _mend_header(self) -> None:
        changes = []
        if self._latlong:
            changes.append((_ENVMAP_WRITTEN, _ENVMAP_MEANT))
        if "chromaticities" in self._attributes:
            values = np.asarray(self._attributes["chromaticities"], "<f4").tobytes()
            changes.append((_CHROMATICITIES, _CHROMATICITIES + values))
        with self._part.open("rb+") as handle:
            start = handle.read(1 << 22)
            for written, meant in changes:
                where = start.find(written)
                assert where > 0, f"{meant[:14]!r} was not found as the library is known to write it"
                handle.seek(where)
                handle.write(meant)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._file.close()
            if kind is None:
                assert self._row == self.size[0], f"{self._row} of {self.size[0]} rows written"
                self._mend_header()
        except BaseException as closing:
            self._stack.__exit__(type(closing), closing, closing.__traceback__)
            raise
        self._stack.__exit__(kind, error, trace)


def _write_failure(path: Path, error: Exception) -> Exception:
    """OpenEXR reports a full disk as an error without errno; give it back as what the system would say."""
    import shutil

    free = shutil.disk_usage(path.parent).free
    if free < 1 << 22:
        return EnvcalError(
            f"{path}: the disk is full ({free >> 10} KiB free); nothing was left half-written. Free some space, or "
            f"choose another `output`, and run again: finished stages are kept."
        )
    return EnvcalError(f"{path}: cannot be written ({error}). Check the disk and its permissions.")


def _attribute(name: str, value: Any) -> Any:
    import Imath

    if name == "chromaticities":
        return Imath.Chromaticities(*(Imath.chromaticity(*value[k : k + 2]) for k in (0, 2, 4, 6)))
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        value = json.dumps(value, ensure_ascii=False, allow_nan=False)
    return value.encode() if isinstance(value, str) else value


def write(
    path: Path, planes: Mapping[str, Plane], *, attributes: Mapping[str, Any], compression: Compression = "zip"
) -> None:
    """Write whole planes, each [height, width] of float32, float16, uint32 or bool (stored as uint32), under their names."""
    kinds = {name: "u4" if plane.dtype == np.bool_ else plane.dtype.str[1:] for name, plane in planes.items()}
    size = next(iter(planes.values())).shape
    with Writer(path, (size[0], size[1]), channels=kinds, attributes=attributes, compression=compression) as writer:
        for top in range(0, size[0], _BAND):
            writer.rows({name: plane[top : top + _BAND] for name, plane in planes.items()})


@dataclass(frozen=True, slots=True)
class Header:
    """What an EXR says of itself: `size` (height, width), `channels` name → numpy kind, `attributes` by name."""

    path: Path
    size: tuple[int, int]
    channels: Mapping[str, str]
    attributes: Mapping[str, Any]
    origin: tuple[int, int]

    @property
    def latlong(self) -> bool:
        """Whether the header declares a latitude-longitude environment map."""
        return bool(self.attributes.get("envmap", False))

    @property
    def chromaticities(self) -> tuple[float, ...] | None:
        """Red, green, blue and white (x, y), or None when the header has none."""
        value = self.attributes.get("chromaticities")
        return None if value is None else tuple(round(float(v), 6) for v in value)

    def json(self, name: str) -> Any:
        """The attribute `name` parsed as JSON; an `EnvcalError` when it is missing or damaged."""
        text = self.attributes.get(name)
        if not isinstance(text, str):
            raise EnvcalError(
                f"{self.path}: has no `{name}` in its header; it was not written by the stage expected here."
            )
        try:
            return json.loads(text)
        except ValueError as error:
            raise EnvcalError(
                f"{self.path}: `{name}` in its header is damaged ({error}). Make the file again."
            ) from error


def header(path: Path) -> Header:
    """Read the header of the first part of an EXR file."""
    import OpenEXR

    if path.is_dir():
        raise EnvcalError(f"{path}: is a folder; an .exr file is expected. Give the file in it.")
    if not path.is_file():
        raise EnvcalError(f"{path}: there is no such file.")
    try:
        with path.open("rb") as handle:
            begins = handle.read(4)
    except OSError as error:
        raise EnvcalError(f"{path}: cannot be read ({error.strerror}). Check its permissions.") from error
    if begins != b"\x76\x2f\x31\x01":
        raise EnvcalError(
            f"{path}: is not an OpenEXR file{'' if begins else ', but empty'}. Give an .exr, or an .hdr with that extension."
        )
    try:
        with OpenEXR.File(str(path), separate_channels=True, header_only=True) as file:
            if not file.parts:
                raise EnvcalError(_truncated(path))
            raw = dict(file.parts[0].header)
        with contextlib.closing(OpenEXR.InputFile(str(path))) as legacy:
            kinds = {name: _kind(channel.type) for name, channel in legacy.header()["channels"].items()}
    except (RuntimeError, ValueError, OSError, TypeError) as error:
        if "Unable to open" in str(error):  # what the library says of a header cut off, though the file was opened
            raise EnvcalError(_truncated(path)) from error
        raise EnvcalError(f"{path}: cannot be read as OpenEXR ({error}). Copy or make the file again.") from error
    (x0, y0), (x1, y1) = (tuple(int(v) for v in corner) for corner in raw["dataWindow"])
    height, width = y1 - y0 + 1, x1 - x0 + 1
    if max(height, width) > LONGEST_SIDE or height * width > MOST_PIXELS:
        raise EnvcalError(
            f"{path}: {width}×{height} pixels; at most {LONGEST_SIDE} a side and {MOST_PIXELS} in all are taken. "
            f"Scale the map down."
        )
    attributes = {k: _plain(k, v) for k, v in raw.items() if k not in ("channels", "dataWindow", "displayWindow")}
    return Header(path, (height, width), kinds, attributes, (x0, y0))


def _truncated(path: Path) -> str:
    return f"{path}: is truncated or damaged. Copy or make the file again."


def _kind(pixel_type: Any) -> str:
    import Imath

    return {Imath.PixelType.FLOAT: "f4", Imath.PixelType.HALF: "f2"}.get(pixel_type.v, "u4")


def _plain(name: str, value: Any) -> Any:
    if name == "envmap":
        return "LATLONG" in str(value)
    return value.decode() if isinstance(value, bytes) else value


def bands(path: Path, names: Sequence[str], *, rows: int) -> Iterator[tuple[int, dict[str, Plane]]]:
    """Yield (first row, name → [≤ rows, width] array) from the top; memory does not grow with the height."""
    import OpenEXR

    about = header(path)
    absent = [n for n in names if n not in about.channels]
    if absent:
        raise EnvcalError(f"{path}: has no channel {', '.join(absent)}; it holds {', '.join(sorted(about.channels))}.")
    height, width = about.size
    try:
        file = OpenEXR.InputFile(str(path))
    except (OSError, RuntimeError) as error:
        raise EnvcalError(_truncated(path)) from error
    with contextlib.closing(file):
        for top in range(0, height, rows):
            count = min(rows, height - top)
            first = top + about.origin[1]
            try:
                data = file.channels(list(names), scanLine1=first, scanLine2=first + count - 1)
            except (OSError, RuntimeError, ValueError) as error:
                raise EnvcalError(_truncated(path)) from error
            yield (
                top,
                {
                    n: np.frombuffer(d, about.channels[n]).reshape(count, width)
                    for n, d in zip(names, data, strict=True)
                },
            )


def read(path: Path, names: Sequence[str]) -> tuple[Header, dict[str, Plane]]:
    """Read whole planes by name, in the types they are stored in."""
    about = header(path)
    ((_, planes),) = bands(path, names, rows=about.size[0])
    return about, planes


def read_rgb(path: Path) -> tuple[Header, npt.NDArray[np.float32]]:
    """Read R, G, B as one [height, width, 3] float32 image."""
    about = header(path)
    absent = [n for n in "RGB" if n not in about.channels]
    if absent:
        raise EnvcalError(
            f"{path}: has no channel {', '.join(absent)}; it holds {', '.join(sorted(about.channels))}. An image "
            f"with plain R, G and B channels is needed: save the layer wanted as such."
        )
    image = np.empty((*about.size, 3), np.float32)
    for top, planes in bands(path, "RGB", rows=512):
        for k, name in enumerate("RGB"):
            image[top : top + len(planes[name]), :, k] = planes[name]
    return about, image


def rgb_planes(image: npt.NDArray[np.floating]) -> dict[str, npt.NDArray[np.float32]]:
    """The R, G, B planes of an image [height, width, 3] as float32, C-contiguous."""
    return {name: np.ascontiguousarray(image[..., k], dtype=np.float32) for k, name in enumerate("RGB")}


def with_lost(image: npt.NDArray[np.float32]) -> dict[str, Plane]:
    """R, G, B and `lost`, 1 where a channel is NaN, as the stages before the map's spectra hand them over."""
    planes: dict[str, Plane] = dict(rgb_planes(image))
    return planes | {"lost": np.asarray(np.isnan(image).any(axis=2), np.uint32)}
