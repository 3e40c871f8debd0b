"""Make docs/settings.md from the models that read pipeline.yaml: `python docs/settings.py`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from envcal.config import Pipeline

PAGE = Path(__file__).with_name("settings.md")
HEAD = """# Settings

What may stand in a `pipeline.yaml`. Everything but `capture.reference` has a default. An unknown name is a mistake; all
mistakes are listed with their lines, before anything runs. Relative paths start from the folder of the file.

    envcal check pipeline.yaml                             # all mistakes, and the frames looked at
    envcal run pipeline.yaml --set uplift.method=scaled    # a setting changed for one run
    envcal schema                                          # the same as a JSON schema, for editors

`name.inner` stands for a mapping inside a setting, `name[].inner` for one inside a list:

    cluster:
      lights:
        - {at: [0.84, 0.16], type: led}

This page is made from the code by `python docs/settings.py`.
"""
Node = Mapping[str, Any]


def page() -> str:
    """Return the page: a section for what stands at the top of the file, then one for each part of it."""
    schema = Pipeline.model_json_schema()
    defined = schema["$defs"]
    parts = {name: defined[_name(node)] for name, node in schema["properties"].items() if "$ref" in node}
    alone = {name: node for name, node in schema["properties"].items() if name not in parts}
    sections = [_section("At the top", "For the whole run.", {**schema, "properties": alone}, defined, "")]
    sections += [_section(name, part["description"], part, defined, f"{name}.") for name, part in parts.items()]
    return "\n".join([HEAD, *sections])


def _section(title: str, description: str, model: Node, defined: Node, prefix: str) -> str:
    rows = list(_rows(model, defined, prefix))
    table = ["| setting | type | default | meaning |", "|---|---|---|---|", *rows] if rows else ["No settings."]
    return "\n".join([f"## {title}", "", _line(description), "", *table, ""])


def _rows(model: Node, defined: Node, prefix: str) -> Iterator[str]:
    """A row for each setting, and below it one for each setting of the mappings it may hold."""
    for name, node in model["properties"].items():
        default = "required" if name in model.get("required", []) else _default(node)
        meaning = _line(node.get("description", "–"))
        yield f"| `{prefix}{name}` | {_type(node)} | {default} | {meaning} |"
        for inner, many in _mappings(node):
            yield from _rows(defined[inner], defined, f"{prefix}{name}{'[]' if many else ''}.")


def _mappings(node: Node, *, many: bool = False) -> Iterator[tuple[str, bool]]:
    """The models that a setting may hold, and whether as items of a list."""
    if "$ref" in node:
        yield _name(node), many
    for branch in node.get("anyOf", []):
        yield from _mappings(branch, many=many)
    if "items" in node:
        yield from _mappings(node["items"], many=True)


def _name(node: Node) -> str:
    return str(node["$ref"]).rsplit("/", 1)[-1]


def _type(node: Node) -> str:
    """A type in words."""
    if "$ref" in node:
        return "mapping"
    if "anyOf" in node:
        return " or ".join(dict.fromkeys(_type(branch) for branch in node["anyOf"] if branch.get("type") != "null"))
    if "const" in node or "enum" in node:
        return " or ".join(f"`{value}`" for value in node.get("enum", [node.get("const")]))
    if node["type"] == "array":
        items = node.get("prefixItems") or [node["items"]]
        count = str(len(items)) if "prefixItems" in node else "list of"
        inner = _type(items[0])
        return f"{count} × {inner}" if inner[0].isdigit() else f"{count} {_plural(inner)}"
    if node["type"] == "object":
        return f"name → {_type(node['additionalProperties'])}"
    if node.get("format") == "path":
        return "path"
    words = {"string": "text", "boolean": "`true` or `false`", "integer": "whole number", "number": "number"}
    return words[node["type"]] + _range(node)


def _plural(text: str) -> str:
    """`number, 0 to 1` → `numbers, 0 to 1`."""
    noun, comma, rest = text.partition(",")
    return f"{noun}s{comma}{rest}"


def _range(node: Node) -> str:
    """The range of a number; every one of these settings that has a lower end has an upper one."""
    if "exclusiveMinimum" in node:
        return f", above {node['exclusiveMinimum']:g}, to {node['maximum']:g}"
    return f", {node['minimum']:g} to {node['maximum']:g}" if "minimum" in node else ""


def _default(node: Node) -> str:
    value = node.get("default")
    if value is None:
        return "left out"
    if value == "":
        return "empty"
    return f"`{value}`" if isinstance(value, str) else f"`{json.dumps(value)}`"


def _line(text: str) -> str:
    """Running text as one line that may stand in a table."""
    return " ".join(text.split()).replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8", newline="\n")
