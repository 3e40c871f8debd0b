"""Measured spectra from files: text of two columns, and IES TM-27 (.spdx)."""

from __future__ import annotations

import re
from pathlib import Path
from xml.parsers import expat

import numpy as np
import numpy.typing as npt

from envcal.errors import EnvcalError

Floats = npt.NDArray[np.float64]

MOST_BYTES = 1 << 22
MOST_FILES = 1000
MOST_TITLES = 100
SUFFIXES = (".csv", ".txt", ".sd", ".spd", ".spdx", ".xml")
_SEPARATOR = re.compile(r"[\s,;]+")
_XML = (".spdx", ".xml")
#: Quantities of TM-27 that are no emission.
_OF_MATERIALS = {"absorptance", "transmittance", "reflectance", "r-factor", "t-factor"}


def read_spd(path: Path) -> tuple[Floats, Floats]:
    """Return wavelengths in nm and values of a measured spectrum.

    `.spdx` and `.xml` are read as IES TM-27; anything else as text with one `wavelength, value` a line: commas,
    semicolons, tabs and spaces separate, `#` begins a comment, and lines that are no numbers may stand above the data
    (one in a CSV; instruments write more in `.sd`, `.spd` and `.txt` files).
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise EnvcalError(f"{path}: is larger than {MOST_BYTES >> 20} MiB; a spectrum has a few hundred lines.")
        data = path.read_bytes()
    except OSError as error:
        raise EnvcalError(f"{path}: cannot be read ({error.strerror}). Correct the path of `spd`.") from error
    table = np.asarray(_tm27(path, data) if path.suffix.lower() in _XML else _columns(path, data), np.float64)
    return np.ascontiguousarray(table[:, 0]), np.ascontiguousarray(table[:, 1])


def _columns(path: Path, data: bytes) -> list[tuple[float, float]]:
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise EnvcalError(f"{path}: is not text. A spectrum is a CSV of wavelength in nm and value.") from error
    rows: list[tuple[float, float]] = []
    titles = 1 if path.suffix.lower() == ".csv" else MOST_TITLES
    for number, line in enumerate(lines, 1):
        text = line.split("#", 1)[0].strip()
        if not text:
            continue
        cells = [cell for cell in _SEPARATOR.split(text) if cell]
        try:
            wavelength, value = (float(cell) for cell in cells)
        except ValueError:
            titles -= 1
            if not rows and titles >= 0:
                continue
            raise EnvcalError(
                f"{path}:{number}: {line.strip()[:60]!r} is not `wavelength, value`. Write two numbers a line, with "
                f"points for decimals."
            ) from None
        rows.append((wavelength, value))
    if len(rows) < 2:
        raise EnvcalError(f"{path}: holds {len(rows)} samples. A spectrum is a CSV of wavelength in nm and value.")
    return rows


def _tm27(path: Path, data: bytes) -> list[tuple[float, float]]:
    """The samples of an IES TM-27 document (ANSI/IES TM-27-14 and -20), whatever its namespace.

    Declarations of document types are refused, with all their entities; nothing outside the file is ever read.
    """
    rows: list[tuple[float, float]] = []
    open_elements: list[str] = []
    text: list[str] = []
    wavelength: list[str] = []

    def refuse(*_: object) -> None:
        raise EnvcalError(
            f"{path}: declares a document type, which a spectrum has no use for. Remove the DOCTYPE line."
        )

    def start(name: str, attributes: dict[str, str]) -> None:
        local = name.rpartition(" ")[2]
        if not open_elements and local != "IESTM2714":
            raise EnvcalError(f"{path}: its root is <{local[:40]}>; expected <IESTM2714>, a spectrum by IES TM-27.")
        open_elements.append(local)
        text.clear()
        wavelength[:] = [attributes.get("wavelength", "")]

    def end(name: str) -> None:
        local = name.rpartition(" ")[2]
        open_elements.pop()
        content = "".join(text).strip()
        text.clear()
        if local == "SpectralQuantity" and content.lower() in _OF_MATERIALS:
            raise EnvcalError(
                f"{path}: holds a {content.lower()}; expected the spectrum of a lamp (flux, radiance, …)."
            )
        if local == "SpectralData":
            try:
                rows.append((float(wavelength[0]), float(content)))
            except ValueError:
                raise EnvcalError(
                    f"{path}:{parser.CurrentLineNumber}: SpectralData of wavelength {wavelength[0][:20]!r} is "
                    f"{content[:20]!r}; expected numbers."
                ) from None

    parser = expat.ParserCreate(namespace_separator=" ")
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = text.append
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise EnvcalError(f"{path}:{error.lineno}: is not XML: {expat.ErrorString(error.code)}.") from error
    if len(rows) < 2:
        raise EnvcalError(f"{path}: holds {len(rows)} SpectralData; expected a spectrum by IES TM-27.")
    return rows


def in_library(folder: Path) -> list[Path]:
    """Return the spectra in a folder of a person's own, by name; an `EnvcalError` says if there is no such folder."""
    try:
        found = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file())
    except OSError as error:
        raise EnvcalError(
            f"{folder}: is no folder of spectra ({error.strerror}). Correct `cluster.library`."
        ) from error
    if len(found) > MOST_FILES:
        raise EnvcalError(f"{folder}: holds {len(found)} spectra; at most {MOST_FILES} make a library.")
    return found


def resolved(path: Path, library: Path | None) -> Path:
    """Return the file that `spd` names: itself, or the one of that name (with or without its ending) in the library."""
    if path.is_file() or library is None:
        return path
    return next((one for one in in_library(library) if path.name in (one.name, one.stem)), path)
