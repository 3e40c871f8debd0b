"""Files that are whole or absent: written beside their place, flushed, then renamed.

A process that is killed leaves a `*.part` file at worst; `sweep` removes those at the start of the next run.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from envcal.errors import EnvcalError

PART = ".part"


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on success it is flushed to disk and takes the name of `path`.

    On any failure the temporary file is removed and what stood at `path` before is untouched. A full disk, a
    missing permission or a folder in the way becomes an `EnvcalError`.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}{PART}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise EnvcalError(f"{path}: is a folder; a file is to be written there. Give another output name.")
        yield part
        with part.open("rb+") as handle:
            os.fsync(handle.fileno())
        part.replace(path)
    except OSError as error:
        raise EnvcalError(_explain(path, error)) from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def _explain(path: Path, error: OSError) -> str:
    if error.errno in (errno.ENOSPC, errno.EDQUOT if hasattr(errno, "EDQUOT") else errno.ENOSPC):
        return (
            f"{path}: the disk is full; nothing was left half-written. Free some space, or choose another "
            f"`output`, and run again: finished stages are kept."
        )
    return f"{path}: cannot be written ({error.strerror or error}). Check the folder and its permissions."


def check_folder(folder: Path) -> None:
    """Refuse a name for an output folder at which, or above which, there is a file."""
    for place in (folder, *folder.parents):
        if place.is_file():
            raise EnvcalError(
                f"{folder}: the output has to be a folder, and {place} is a file. Give another name to -o."
            )


def write_text(path: Path, text: str) -> None:
    """Write `text` as UTF-8 with line feeds, whole or not at all."""
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8", newline="\n")


def write_json(path: Path, value: Any) -> None:
    """Write `value` as indented JSON, whole or not at all. NaN is refused: JSON has none."""
    write_text(path, json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def digest(path: Path) -> str:
    """Return the SHA-256 of the file's bytes as hexadecimal digits."""
    try:
        with path.open("rb") as handle:
            return hashlib.file_digest(handle, "sha256").hexdigest()
    except OSError as error:
        raise EnvcalError(f"{path}: cannot be read ({error.strerror}). Check the name and its permissions.") from error


def sweep(folder: Path) -> None:
    """Remove what a killed process left half-written below `folder`."""
    for part in folder.rglob(f".*{PART}"):
        with contextlib.suppress(OSError):
            part.unlink()
