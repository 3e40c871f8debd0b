"""What `run.json` says of a run, checked, and what follows from it for the page."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from envcal.errors import EnvcalError


class StageRecord(BaseModel):
    """The record of one stage, as the runner writes it."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    seconds: float = Field(default=0.0, ge=0, allow_inf_nan=False)
    settings: dict[str, Any] = {}
    inputs: list[tuple[str, str]] = []
    outputs: dict[str, str] = {}
    summary: str = ""
    figures: dict[str, Any] = {}
    warnings: list[str] = []


@dataclass(frozen=True, slots=True)
class Warned:
    """A warning and the stage that gave it."""

    stage: str
    text: str


def parse(records: Mapping[str, Any], *, place: Path) -> dict[str, StageRecord]:
    """Check the records; an `EnvcalError` names what is damaged. The report's own record is left out."""
    found = {}
    for name, record in records.items():
        if name == "report":
            continue
        try:
            found[name] = StageRecord.model_validate(record)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(part) for part in ("stages", name, *first["loc"]))
            raise EnvcalError(f"{place}: {where}: {first['msg']}. Run `envcal run` again.") from None
    return found


def stale(records: Mapping[str, StageRecord], order: Sequence[str]) -> list[str]:
    """Return the stages whose files were made from others than those that stand there now, in order.

    That is so when a run was stopped before them (`--until`) after something had changed.
    """
    current = {digest for record in records.values() for digest in record.outputs.values()}
    old: list[str] = []
    for name in order:
        record = records.get(name)
        if record is None or name == order[0]:
            continue
        if any(file.endswith(".exr") and digest not in current for file, digest in record.inputs):
            old.append(name)
            current -= set(record.outputs.values())
    return old


def changed_settings(records: Mapping[str, StageRecord]) -> list[tuple[str, str, str]]:
    """Return (setting, value, default) wherever a stage was run with another value than the default."""
    from envcal.config import Pipeline

    changes: dict[str, tuple[str, str, str]] = {}
    for record in records.values():
        for group, value in record.settings.items():
            field = Pipeline.model_fields.get(group)
            if field is None:
                continue
            default = field.default
            if isinstance(default, BaseModel) and isinstance(value, dict):
                usual = default.model_dump(mode="json")
                for name, chosen in value.items():
                    if name in usual and chosen != usual[name]:
                        changes[f"{group}.{name}"] = (f"{group}.{name}", _text(chosen), _text(usual[name]))
            elif value != default:
                changes[group] = (group, _text(value), _text(default))
    return list(changes.values())


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    return "left out" if value is None else json.dumps(value, ensure_ascii=False)
