"""What pydantic found wrong → one line for each mistake, with file, line and what to write instead."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from envcal.config.models import Pipeline, Settings


def told(
    path: Path,
    tree: Any,
    error: ValidationError,
    set_by: Mapping[tuple[str, ...], str],
    model: type[Settings] = Pipeline,
) -> list[str]:
    """One line per mistake, in the order of the file. A value that fails every branch of a union is told once."""
    found: dict[tuple[str | int, ...], list[str]] = {}
    for item in _worth_telling(tree, error, model):
        where = _path_in(tree, item["loc"])
        if item["type"] == "extra_forbidden" or item["type"] == "missing":
            where = tuple(item["loc"]) if _exists(tree, item["loc"][:-1]) else where
        found.setdefault(where, []).append(_explain(item, where, model))
    lines = []
    for where, texts in found.items():
        if any(other[: len(where)] == where and other != where for other in found):
            continue  # the union as a whole fails because of the mistake inside it, which has a line of its own
        keys = tuple(str(k) for k in where)
        source = next((t for k, t in set_by.items() if keys[: len(k)] == k), None)
        place = f"--set {source}" if source else f"{path}:{line_of(tree, where)}"
        name = ".".join(keys) or "the file as a whole"
        reasons = dict.fromkeys(texts if len(texts) == 1 else [t for t in texts if t != "is missing"])
        message = f"{place}: {name}: {', or '.join(reasons)}"
        lines.append((line_of(tree, where), message if message.endswith("?") else message + "."))
    return [text for _, text in sorted(lines, key=lambda pair: pair[0])]


def _worth_telling(tree: Any, error: ValidationError, model: type[Settings]) -> list[Mapping[str, Any]]:
    """All mistakes; beside a setting that no mapping has, those that another of several mappings would have are no news."""
    every: list[Mapping[str, Any]] = [dict(item) for item in error.errors(include_url=False, include_context=True)]

    def of_another(item: Mapping[str, Any]) -> bool:
        if item["type"] != "extra_forbidden":
            return False
        where = _path_in(tree, item["loc"])
        return bool(where) and where[-1] in _known(model, where[:-1])

    rest = [item for item in every if not of_another(item)]
    return rest if any(item["type"] == "extra_forbidden" for item in rest) else every


def _exists(tree: Any, loc: Sequence[str | int]) -> bool:
    return len(_path_in(tree, loc)) == len(loc)


def _path_in(tree: Any, loc: Sequence[str | int]) -> tuple[str | int, ...]:
    """The part of pydantic's location that is in the file: it also names branches of unions and models."""
    node: Any = tree
    path: list[str | int] = []
    for key in loc:
        if (isinstance(node, dict) and key in node) or (isinstance(node, list) and key in range(len(node))):
            node = node[key]  # type: ignore[index, unused-ignore]
            path.append(key)
    return tuple(path)


def line_of(tree: Any, where: Sequence[str | int]) -> int:
    """Line of a setting in its file, or of the nearest that holds it."""
    node: Any = tree
    line = 1
    for key in where:
        try:
            position = node.lc
            line = (position.key(key) if isinstance(node, dict) else position.item(key))[0] + 1
            node = node[key]
        except (KeyError, AttributeError, IndexError, TypeError):
            break
    return int(line)


def _explain(item: Mapping[str, Any], where: Sequence[str | int], model: type[Settings]) -> str:
    kind = item["type"]
    if kind == "extra_forbidden":
        known = _known(model, where[:-1])
        if where[-1] in known:
            return "cannot stand beside the other settings there; give one or the other"
        near = difflib.get_close_matches(str(where[-1]), known, n=1, cutoff=0.5)
        hint = f"did you mean `{near[0]}`?" if near else f"known here: {', '.join(known)}"
        return f"is not a setting; {hint}"
    if kind == "missing":
        return "is missing"
    if kind == "value_error":
        return str(item["ctx"]["error"])
    if kind == "literal_error" and not isinstance(item["input"], str):
        field = _field(model, where)
        expected = " ".join((field.description or "").split()).rstrip(".") if field else item["ctx"]["expected"]
        return f"is {_short(item['input'])}; expected {expected}"
    if kind == "literal_error":
        choices = item["ctx"]["expected"]
        near = difflib.get_close_matches(
            str(item["input"]), [c.strip("'") for c in choices.replace(" or ", ", ").split(", ")], n=1
        )
        return f"is {item['input']!r}; it can be {choices}" + (f"; did you mean {near[0]!r}?" if near else "")
    if kind == "model_type":
        field = _field(model, where)
        own = (
            [one for one in _inner_models(field.annotation) if one.__name__ == item["ctx"]["class_name"]]
            if field
            else []
        )
        keys = ", ".join(f"{name}: …" for one in own for name in one.model_fields)
        return f"expected {{{keys}}}" if keys else f"is {_short(item['input'])}; expected settings by name"
    message = item["msg"][0].lower() + item["msg"][1:]
    return f"{message}, not {_short(item['input'])}"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "…"


def _model_at(model: type[BaseModel], where: Sequence[str | int]) -> type[BaseModel] | None:
    """The model of the settings at a place of the tree."""
    current: type[BaseModel] | None = model
    for key in where:
        if current is not None and not isinstance(key, int):
            field = current.model_fields.get(key)
            current = None if field is None else _inner_model(field.annotation)
    return current


def _known(model: type[BaseModel], where: Sequence[str | int]) -> list[str]:
    """The settings at a place, of any of the mappings that may stand there."""
    field = _field(model, where) if where and not isinstance(where[-1], int) else None
    inner = _model_at(model, where)
    models = _inner_models(field.annotation) if field is not None else [] if inner is None else [inner]
    return list(dict.fromkeys(name for one in models for name in one.model_fields))


def _field(model: type[BaseModel], where: Sequence[str | int]) -> FieldInfo | None:
    inner = _model_at(model, where[:-1]) if where else None
    return None if inner is None else inner.model_fields.get(str(where[-1]))


def _inner_model(annotation: Any) -> type[BaseModel] | None:
    return next(iter(_inner_models(annotation)), None)


def _inner_models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _inner_models(part)]
