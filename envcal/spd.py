"""Measured spectra from text files of two columns."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from envcal.errors import EnvcalError

MOST_BYTES = 1 << 22
_SEPARATOR = re.compile(r"[\s,;]+")


def read_spd(path: Path) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return wavelengths in nm and values of a file with one `wavelength, value` a line.

    Commas, semicolons, tabs and spaces separate; `#` begins a comment; one line of column names may stand on top.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise EnvcalError(f"{path}: is larger than {MOST_BYTES >> 20} MiB; a spectrum has a few hundred lines.")
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise EnvcalError(f"{path}: cannot be read ({error.strerror}). Correct the path of `spd`.") from error
    except UnicodeDecodeError as error:
        raise EnvcalError(f"{path}: is not text. A spectrum is a CSV of wavelength in nm and value.") from error
    rows: list[tuple[float, float]] = []
    titled = False
    for number, line in enumerate(lines, 1):
        text = line.split("#", 1)[0].strip()
        if not text:
            continue
        cells = [cell for cell in _SEPARATOR.split(text) if cell]
        try:
            wavelength, value = (float(cell) for cell in cells)
        except ValueError:
            if not rows and not titled:
                titled = True
                continue
            raise EnvcalError(
                f"{path}:{number}: {line.strip()[:60]!r} is not `wavelength, value`. Write two numbers a line, with "
                f"points for decimals."
            ) from None
        rows.append((wavelength, value))
    if len(rows) < 2:
        raise EnvcalError(f"{path}: holds {len(rows)} samples. A spectrum is a CSV of wavelength in nm and value.")
    table = np.asarray(rows, np.float64)
    return np.ascontiguousarray(table[:, 0]), np.ascontiguousarray(table[:, 1])
