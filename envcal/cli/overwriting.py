"""No command writes over what it reads."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from envcal.errors import EnvcalError


def refuse_own_input(out: Path, inputs: Iterable[Path | None], *, beside: Iterable[Path] = ()) -> None:
    """Refuse to write `out`, or a file `beside` it, where one of the inputs stands, by whatever name it goes."""
    read = [path for path in inputs if path is not None]
    for path in read:
        if _same(out, path):
            raise EnvcalError(f"{out}: the output is the input{_named(out, path)}. Give another name to -o.")
    for written in beside:
        for path in read:
            if _same(written, path):
                raise EnvcalError(
                    f"{written}: is written beside the output {out.name}, and it is an input{_named(written, path)}. Give "
                    f"another name to -o."
                )


def _same(one: Path, other: Path) -> bool:
    """Whether two names are those of one file: also through `..`, links, and other case where the disk ignores it."""
    try:
        return one.samefile(other)
    except OSError:  # one of them does not exist
        return False


def _named(written: Path, path: Path) -> str:
    return "" if str(written) == str(path) else f" {path}"
