"""Opening a file with LibRaw, and refusing in plain words what it cannot give."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from envcal.errors import EnvcalError
from envcal.raw.exif import of_mosaic

_JPEG_XL = 52_546  # TIFF Compression, DNG 1.7
_FLOAT = 3  # TIFF SampleFormat

_CONVERT = "Convert it to DNG (uncompressed or lossless) with a RAW converter, or take the file out of the bracket"


def rawpy_version() -> str:
    """Return the versions of rawpy and LibRaw, for the provenance of what was read."""
    import rawpy

    return f"rawpy {rawpy.__version__}, LibRaw {'.'.join(map(str, rawpy.libraw_version))}"


@contextmanager
def opened(path: Path, exif: Mapping[str, Any]) -> Iterator[Any]:
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
    if _FLOAT in of_mosaic(exif, "SampleFormat"):
        raise EnvcalError(
            f"{path}: floating-point samples; integers are expected (this is a merged or processed file, not a frame). "
            "Give the frames it was made from."
        )
    if _JPEG_XL in of_mosaic(exif, "Compression"):
        raise EnvcalError(f"{path}: compressed as JPEG XL, which {rawpy_version()} does not decode. {_CONVERT}.")
