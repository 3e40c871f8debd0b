"""The tags of a file by name, as far as ExifRead understands it."""

import logging
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

_RAW_PHOTOMETRIC = (32_803, 34_892)  # DNG: colour filter array, linear RAW


def read_tags(path: Path) -> dict[str, Any]:
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


def numbers(exif: Mapping[str, Any], tag: str) -> list[Fraction]:
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


def of_mosaic(exif: Mapping[str, Any], tag: str) -> list[Fraction]:
    """Return the numbers of a tag in the TIFF directory of the RAW data; previews and masks have directories too."""
    for name, entry in exif.items():
        directory, _, last = name.rpartition(" ")
        if last == "PhotometricInterpretation" and entry.values and entry.values[0] in _RAW_PHOTOMETRIC:
            return numbers({n: e for n, e in exif.items() if n.startswith(f"{directory} ")}, tag)
    return []


def text(exif: Mapping[str, Any], *names: str) -> str:
    return next((str(exif[n]).strip() for n in names if n in exif and str(exif[n]).strip()), "")


def positive(values: list[Fraction]) -> Fraction | None:
    return next((v for v in values if v > 0), None)
