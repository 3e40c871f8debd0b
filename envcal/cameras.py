"""Spectral sensitivities of cameras: files in two layouts, or a camera known by name.

The layouts are JSON as rawtoaces reads it (`spectral_data.data.main`: wavelength → [R, G, B], the columns' order in
`spectral_data.index.main`) and CSV (wavelength in nm and one column each for R, G, B, with or without a line of names).
By name there are the cameras that colour-science carries.

Sensitivities are relative: of each channel, and of the channels to each other, only as good as the measurement. Which
curve is which channel is what the file says, or else the order R, G, B.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from envcal.errors import EnvcalError

Floats = npt.NDArray[np.float64]

#: Files are refused beyond these: a camera at 1 nm has a few hundred lines.
MOST_BYTES = 1 << 21
MOST_SAMPLES = 5000
_SEPARATOR = re.compile(r"[\s,;]+")
_NAMES = {"r": 0, "g": 1, "b": 2, "red": 0, "green": 1, "blue": 2}
#: A camera's samples must reach from below to above these, or part of a channel is missing.
_MUST_COVER_NM = (450.0, 650.0)
#: Distance of two samples in nm from which on a straight line between them invents a curve.
_LARGEST_GAP_NM = 25.0
#: Noise of a monochromator makes values a little negative; more is another quantity (a matrix, logarithms).
_MOST_NEGATIVE = 0.02


def known_cameras() -> tuple[str, ...]:
    """The cameras that are known by name."""
    import colour

    return tuple(colour.MSDS_CAMERA_SENSITIVITIES)


def is_known(name: str) -> bool:
    """Whether `name` is a camera known by name rather than a file."""
    return name in known_cameras()


def sensitivities(name_or_path: str | Path, wavelengths_nm: npt.ArrayLike) -> Floats:
    """Return the sensitivities [N, 3] of R, G, B at `wavelengths_nm` [N]; the largest of all samples is 1.

    `name_or_path` is one of `known_cameras()` or a file: rawtoaces-style JSON (`.json`) or CSV (anything else). Linear
    between the samples, **zero outside** of them; values slightly below zero, as noise gives, become zero. Raises
    EnvcalError for an unknown name, a file that cannot be read, and for samples that are no three sensitivities.
    """
    at = np.asarray(wavelengths_nm, dtype=np.float64)
    if isinstance(name_or_path, str) and is_known(name_or_path):
        import colour

        known = colour.MSDS_CAMERA_SENSITIVITIES[name_or_path]
        table = np.column_stack([known.wavelengths, known.values])
        return _resampled(table, at, name_or_path)
    path = Path(name_or_path)
    text = _text(path, str(name_or_path))
    table = _from_json(text, path) if path.suffix.lower() == ".json" else _from_csv(text, path)
    return _resampled(table, at, str(path))


def _text(path: Path, given: str) -> str:
    try:
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise EnvcalError(
                f"{path}: {size} bytes; expected at most {MOST_BYTES}: sensitivities are a few hundred lines. Give the "
                "file of one camera."
            )
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise EnvcalError(
            f"camera {given!r}: neither a file that can be read ({error.strerror}) nor a camera known by name "
            f"({', '.join(known_cameras())}). Correct the path, or give one of these names."
        ) from error
    except UnicodeDecodeError as error:
        raise EnvcalError(f"{path}: is not text; expected CSV or JSON of a camera's sensitivities.") from error


def _from_csv(text: str, path: Path) -> Floats:
    """Rows of wavelength, R, G, B. A line of names, if there is one, may put the channels in another order."""
    rows: list[list[float]] = []
    order: list[int] | None = None
    titled = False
    for number, line in enumerate(text.splitlines(), 1):
        cells = [cell.strip("\"'") for cell in _SEPARATOR.split(line.split("#", 1)[0].strip()) if cell]
        if not cells:
            continue
        try:
            values = [float(cell) for cell in cells]
        except ValueError:
            if not rows and not titled:
                titled = True
                order = _order([cell.lower() for cell in cells[1:]])
                continue
            raise _bad_line(path, number, line) from None
        if len(values) != 4:
            raise _bad_line(path, number, line)
        if len(rows) == MOST_SAMPLES:
            raise EnvcalError(
                f"{path}:{number}: more than {MOST_SAMPLES} samples; give one camera, sampled by 1 nm or coarser."
            )
        rows.append(values)
    if len(rows) < 2:
        raise EnvcalError(f"{path}: holds {len(rows)} samples; expected lines of `wavelength, R, G, B`.")
    table = np.asarray(rows, np.float64)
    return table if order is None else table[:, [0, *(1 + k for k in order)]]


def _bad_line(path: Path, number: int, line: str) -> EnvcalError:
    return EnvcalError(
        f"{path}:{number}: {line.strip()[:60]!r} is not `wavelength, R, G, B`. Write four numbers a line, with points for "
        "decimals."
    )


def _order(names: list[str]) -> list[int] | None:
    """Which column is R, G and B, where the names say so; None where they do not."""
    found = [_NAMES.get(name) for name in names]
    return [found.index(k) for k in range(3)] if sorted(k for k in found if k is not None) == [0, 1, 2] else None


def _from_json(text: str, path: Path) -> Floats:
    expected = 'expected rawtoaces\' layout {"spectral_data": {"data": {"main": {"380": [R, G, B], …}}}}'
    try:
        tree: Any = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise EnvcalError(f"{path}: is not JSON ({str(error)[:80]}); {expected}. Correct the file.") from error
    try:
        data = tree["spectral_data"]
        main = data["data"]["main"]
        columns = data.get("index", {}).get("main")
        items = list(main.items())
    except (KeyError, TypeError, AttributeError) as error:
        raise EnvcalError(
            f"{path}: has no sensitivities where they should be; {expected}. Correct the file."
        ) from error
    if not 2 <= len(items) <= MOST_SAMPLES:
        raise EnvcalError(f"{path}: holds {len(items)} samples; expected 2 to {MOST_SAMPLES}. Give one camera.")
    rows = []
    for wavelength, values in items:
        try:
            row = [float(wavelength), *(float(value) for value in values)]
        except (TypeError, ValueError):
            row = []
        if len(row) != 4:
            raise EnvcalError(
                f"{path}: spectral_data.data.main[{str(wavelength)[:20]!r}] is {str(values)[:40]}; expected a wavelength in nm "
                "and [R, G, B]. Correct the file."
            )
        rows.append(row)
    table = np.asarray(rows, np.float64)
    order = _order([str(name).lower() for name in columns]) if isinstance(columns, list) else None
    return table if order is None else table[:, [0, *(1 + k for k in order)]]


def _resampled(table: Floats, at: Floats, place: str) -> Floats:
    """Check the samples [M, 4] and return R, G, B at `at`."""
    if not np.isfinite(table).all():
        raise EnvcalError(f"{place}: has values that are no finite numbers; correct them.")
    table = table[np.argsort(table[:, 0], kind="stable")]
    nm, values = table[:, 0], table[:, 1:]
    twice = nm[1:][np.diff(nm) <= 0]
    if twice.size:
        raise EnvcalError(f"{place}: {twice[0]:g} nm stands there twice; give each wavelength once.")
    low, high = _MUST_COVER_NM
    if nm[0] > low or nm[-1] < high:
        hint = " They look like micrometres: multiply by 1000." if nm[-1] < 10 else ""
        raise EnvcalError(
            f"{place}: samples from {nm[0]:g} to {nm[-1]:g} nm; expected at least {low:g} to {high:g} nm. Give the camera's "
            f"whole range in nm.{hint}"
        )
    inside = (nm >= low) & (nm <= high)
    gap = float(np.diff(np.concatenate([[low], nm[inside], [high]])).max())
    if gap > _LARGEST_GAP_NM:
        raise EnvcalError(
            f"{place}: {gap:g} nm between two samples; expected {_LARGEST_GAP_NM:g} nm at most. Give a finer measurement."
        )
    peaks = values.max(axis=0)
    if peaks.min() <= 0:
        names = [name for name, peak in zip("RGB", peaks, strict=True) if peak <= 0]
        raise EnvcalError(
            f"{place}: channel {', '.join(names)} sees nothing; expected a positive sensitivity somewhere."
        )
    if (values.min(axis=0) < -_MOST_NEGATIVE * peaks).any():
        raise EnvcalError(
            f"{place}: the least value is {values.min():g} beside a largest of {values.max():g}; sensitivities are not "
            "negative. Give linear, relative sensitivities of the raw channels."
        )
    values = np.maximum(values, 0.0) / peaks.max()
    return np.stack([np.interp(at, nm, values[:, k], left=0.0, right=0.0) for k in range(3)], axis=-1)
