"""Text of a settings file → a tree that keeps every value's line.

YAML is read by ruamel.yaml in its round-trip mode: no tag constructs an object, a key given twice is a mistake and
every value keeps its line.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from envcal.errors import EnvcalError

#: A settings file longer than this is not one.
MOST_BYTES = 1 << 20
#: Part of the parser's message → what the person most likely did.
REMEDIES = {
    "\\t": " Indent with spaces instead of tabs.",
    "mapping values are not allowed": " Is this line indented further than its neighbours, or does the value hold a "
    "colon? Line it up with them, or put the value in quotes.",
    "block end": " Is the line, or the one before it, indented by one space too many or too few? "
    "Settings of one stage stand at the same depth.",
    "could not find expected ':'": " A setting is written `key: value`, with a space after the colon.",
    "found duplicate key": " Delete one of the two.",
    "expected ','": " A bracket is opened and not closed.",
    "unexpected end of stream": " A quote is opened and not closed.",
}


#: How pictures begin: OpenEXR, Radiance, TIFF (and most RAW files), JPEG, PNG.
_PICTURES = (b"\x76\x2f\x31\x01", b"#?", b"II*\0", b"MM\0*", b"\xff\xd8\xff", b"\x89PNG")


def read_yaml(path: Path, *, expected: str = "a pipeline.yaml") -> Any:
    """The tree of a file; every mistake of YAML is an `EnvcalError` with its line and a remedy.

    `expected` names the file in messages to who gave another kind of file, or a folder.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        if path.is_dir():
            inside = path / expected.rsplit(maxsplit=1)[-1]
            raise EnvcalError(
                f"{path}: is a folder; {expected} is expected." + (f" Give {inside}." if inside.is_file() else "")
            )
        with path.open("rb") as handle:
            if handle.read(8).startswith(_PICTURES):
                raise EnvcalError(f"{path}: is an image; {expected} is expected.")
        if path.stat().st_size > MOST_BYTES:
            raise EnvcalError(f"{path}: is larger than {MOST_BYTES >> 20} MiB; that is no settings file.")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise EnvcalError(f"{path}: cannot be read ({error.strerror}). Give the path of {expected}.") from error
    except UnicodeDecodeError as error:
        raise EnvcalError(
            f"{path}: is not UTF-8 text ({error.reason} at byte {error.start}). Save it as UTF-8."
        ) from error
    try:
        return YAML(typ="rt").load(io.StringIO(text))
    except YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f":{mark.line + 1}" if mark else ""
        problem = " ".join(str(getattr(error, "problem", None) or error).split())
        remedy = next((text for part, text in REMEDIES.items() if part in problem), "")
        raise EnvcalError(f"{path}{place}: is not YAML: {problem}.{remedy}") from error
    except RecursionError as error:
        raise EnvcalError(f"{path}: is nested too deeply for a settings file.") from error


def plain(node: Any, depth: int = 0) -> Any:
    """Ruamel's own types → plain ones, so that messages and validation see what the person wrote."""
    if depth > 12:
        raise EnvcalError("the settings are nested more than 12 deep; no setting is.")
    if isinstance(node, dict):
        return {str(k): plain(v, depth + 1) for k, v in node.items()}
    if isinstance(node, list):
        return [plain(v, depth + 1) for v in node]
    for kind in (bool, int, float, str):
        if isinstance(node, kind):
            return kind(node)
    return node if node is None else str(node)


def override(tree: dict[str, Any], text: str) -> tuple[str, ...]:
    """Put the value of `key.key=value` into the tree; returns its keys."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    name, equals, value = text.partition("=")
    keys = tuple(part.strip() for part in name.split("."))
    if not equals or not all(keys):
        raise EnvcalError(f"--set {text}: expected key.key=value, such as --set uplift.method=scaled.")
    try:
        parsed = YAML(typ="safe").load(value)
    except YAMLError:
        raise EnvcalError(f"--set {text}: the value is not YAML; put quotes around it.") from None
    node = tree
    for key in keys[:-1]:
        if not isinstance(node.get(key), dict):
            node[key] = {}
        node = node[key]
    node[keys[-1]] = parsed
    return keys
