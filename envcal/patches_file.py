"""A chart's own measured patches: CGATS (.ti3, .txt of an instrument) or CSV with XYZ, L*a*b* or reflectances."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from envcal.errors import EnvcalError

if TYPE_CHECKING:
    from calibrate.chart import ChartReference

Floats = npt.NDArray[np.float64]
MOST_BYTES = 1 << 20
PATCHES, PATCHES_OF_SG = 24, 140
#: ICC's D50, under which instruments report XYZ and L*a*b*.
D50_XYZ: Floats = np.array([0.9642, 1.0, 0.8249])
_BAND = re.compile(r"(?:spec(?:tral)?|nm|r)?_?(?:nm)?_?(\d{3,4})(?:[.]0*)?(?:nm)?", re.IGNORECASE)
_XYZ = ("XYZ_X", "XYZ_Y", "XYZ_Z")
_LAB = ("LAB_L", "LAB_A", "LAB_B")
#: Columns that may say which patch of an SG a row is.
_NAMED = ("SAMPLE_NAME", "SAMPLE_LOC", "SAMPLE_ID", "NAME", "PATCH")
_OTHER_NAMES = {"X": "XYZ_X", "Y": "XYZ_Y", "Z": "XYZ_Z", "L": "LAB_L", "A": "LAB_A", "B": "LAB_B"}
_OTHER_NAMES |= {"L*": "LAB_L", "A*": "LAB_A", "B*": "LAB_B"}


def read_patches(path: Path) -> ChartReference:
    """Return the reference of the 24 patches in a file, row by row from dark skin, or of the 140 of an SG, by their names.

    XYZ (of white 100 or 1) and L*a*b* are taken as under D50, as instruments report them, and adapted; reflectances are
    integrated under D65. Raises EnvcalError with file, line and remedy.
    """
    from calibrate import CalibrateError
    from calibrate.chart import measured_reference

    names, rows, labels = _table(path)
    if len(rows) not in (PATCHES, PATCHES_OF_SG):
        raise EnvcalError(
            f"{path}: holds {len(rows)} patches; expected the {PATCHES} of a ColorChecker, row by row from dark skin to black, or "
            f"the {PATCHES_OF_SG} of a Digital SG."
        )
    values = np.asarray(rows, np.float64)
    if len(rows) == PATCHES_OF_SG:
        values = values[_order_of_sg(labels, path)]
    reflectances = None
    bands = {int(m[1]): k for k, name in enumerate(names) if (m := _BAND.fullmatch(name)) and 300 <= int(m[1]) <= 1100}
    try:
        if len(bands) >= 10:
            reflectances = _reflectances(values, bands, path)
            xyz, white = _integrated(*reflectances)
        elif set(_XYZ) <= set(names):
            xyz, white = values[:, [names.index(name) for name in _XYZ]], D50_XYZ
            xyz = xyz / 100 if xyz[:, 1].max() > 1.5 else xyz
        elif set(_LAB) <= set(names):
            xyz, white = _xyz_from_lab(values[:, [names.index(name) for name in _LAB]]), D50_XYZ
        else:
            raise EnvcalError(
                f"{path}: its columns are {', '.join(names[:8])}; expected XYZ_X, XYZ_Y, XYZ_Z, or LAB_L, LAB_A, LAB_B, or "
                "reflectances such as SPEC_380 … SPEC_730."
            )
        return measured_reference(path.name, xyz, white=white, reflectances=reflectances)
    except CalibrateError as error:
        raise EnvcalError(str(error)) from error


def _order_of_sg(labels: list[str], path: Path) -> list[int]:
    """Which row holds A1, B1 … N1, A2 … of an SG. Instruments list it by columns or by rows: only names tell."""
    wanted = [f"{column}{row}" for row in range(1, 11) for column in "ABCDEFGHIJKLMN"]
    # A01 is A1.
    said = [re.sub(r"(?<=[A-N])0(?=[1-9]$)", "", label.strip().upper()) for label in labels]
    missing = [name for name in wanted if name not in said]
    if missing:
        raise EnvcalError(
            f"{path}: no patch is called {', '.join(missing[:4])}{' …' if len(missing) > 4 else ''}; expected A1 to N10 once each in "
            f"a column {', '.join(_NAMED[:3])}, as the order of the {PATCHES_OF_SG} patches differs between instruments."
        )
    return [said.index(name) for name in wanted]


def _table(path: Path) -> tuple[list[str], list[list[float]], list[str]]:
    """The names of the numeric columns, upper case, the rows, and what each row is called ("" where nothing says it)."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise EnvcalError(f"{path}: is larger than {MOST_BYTES >> 20} MiB; that is no list of patches.")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise EnvcalError(f"{path}: cannot be read ({error.strerror}). Correct `correct.patches`.") from error
    except UnicodeDecodeError as error:
        raise EnvcalError(f"{path}: is not text; expected CSV or CGATS. Export it as text.") from error
    if "BEGIN_DATA_FORMAT" in text:
        header, lines = _cgats(text, path)
    else:
        cells = [row for row in csv.reader(io.StringIO(text), skipinitialspace=True) if any(c.strip() for c in row)]
        cells = [row for row in cells if not row[0].startswith("#")]
        if not cells:
            raise EnvcalError(f"{path}: is empty; expected a line of names and {PATCHES} lines of values.")
        header, lines = cells[0], cells[1:]
    wanted = [_OTHER_NAMES.get(name.strip().upper(), name.strip().upper()) for name in header]
    used = [k for k, name in enumerate(wanted) if name in (*_XYZ, *_LAB) or _BAND.fullmatch(name)]
    # The column in which a patch is called something like A1.
    named = [k for word in _NAMED for k, name in enumerate(wanted) if name == word]
    named = [k for k in named if all(len(row) > k and re.match(r"[A-Za-z]", row[k]) for row in lines)]
    labels = [row[named[0]] if named else "" for row in lines]
    rows = []
    for number, cells_of in enumerate(lines, 1):
        try:
            rows.append([float(cells_of[k]) for k in used])
        except (ValueError, IndexError):
            raise EnvcalError(
                f"{path}: patch {number} has no number in each of the columns {', '.join(wanted[k] for k in used)}: "
                f"{' '.join(cells_of)[:60]!r}. Write one patch a line, with points for decimals."
            ) from None
    return [wanted[k] for k in used], rows, labels


def _cgats(text: str, path: Path) -> tuple[list[str], list[list[str]]]:
    """Field names and rows of cells of the first table of a CGATS file."""
    parts = re.search(r"BEGIN_DATA_FORMAT\s(.*?)END_DATA_FORMAT.*?BEGIN_DATA\s(.*?)END_DATA", text, re.DOTALL)
    if parts is None:
        raise EnvcalError(f"{path}: has no BEGIN_DATA … END_DATA after its data format. Export it again.")
    names = parts[1].split()
    lines = [line for line in parts[2].splitlines() if line.strip() and not line.lstrip().startswith("#")]
    rows = [[cell.strip('"') for cell in re.findall(r'"[^"]*"|\S+', line)] for line in lines]
    return names, rows


def _xyz_from_lab(lab: Floats) -> Floats:
    """CIELAB under D50 → XYZ, white Y = 1 (CIE 15:2018, 8.2.1)."""
    fy = (lab[:, 0] + 16) / 116
    f = np.stack([fy + lab[:, 1] / 500, fy, fy - lab[:, 2] / 200], axis=-1)
    return np.asarray(np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29)) * D50_XYZ)


def _reflectances(values: Floats, bands: dict[int, int], path: Path) -> tuple[Floats, Floats]:
    """Wavelengths [W] in nm and reflectances [N, W], 1 = white."""
    at = np.array(sorted(bands), dtype=np.float64)
    if at[0] > 400 or at[-1] < 700:
        raise EnvcalError(f"{path}: reflectances from {at[0]:g} to {at[-1]:g} nm; expected at least 400 to 700 nm.")
    reflectances = values[:, [bands[int(nm)] for nm in at]]
    if reflectances.max() > 1.5:
        reflectances = reflectances / 100
    return at, reflectances


def _integrated(at: Floats, reflectances: Floats) -> tuple[Floats, Floats]:
    """XYZ [N, 3] of reflectances [N, W] at wavelengths [W] under D65, and the XYZ of D65."""
    from uplift.spectrum import illuminant, observer, xyz_of

    seen = observer()
    light = illuminant("D65", seen)
    white = xyz_of(light, seen)
    spectra = np.array([np.interp(seen.wavelengths_nm, at, row) for row in reflectances]) * light
    return np.asarray(xyz_of(spectra, seen)) / white[1], np.asarray(white) / white[1]
