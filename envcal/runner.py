"""Run rows of the table of stages: skip what is unchanged, record what was done, go on after a kill.

A stage is up to date when its key (settings, digests of inputs, version and source of envcal) is the one on record
and every output still has the digest on record. The record, `run.json`, is written after each stage, so a killed run
goes on at the stage it was in.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from envcal import __version__, atomic
from envcal.config import Loaded
from envcal.config.loading import LAMP_OFF
from envcal.errors import EnvcalError
from envcal.lens_data import database_files
from envcal.reporter import Reporter
from envcal.spd import in_library

RECORD = "run.json"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a stage has to say: `figures` for people and scripts (JSON), a one-line `summary`, and warnings."""

    summary: str
    figures: Mapping[str, Any]
    warnings: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Run:
    """One run: its settings, its folder, the digests known so far and the records of the stages done."""

    loaded: Loaded
    reporter: Reporter
    records: dict[str, Any] = field(default_factory=dict)
    digests: dict[Path, str] = field(default_factory=dict)

    def path(self, name: str) -> Path:
        """Return where an output such as `merge/reference.exr` stands."""
        return self.loaded.output / name

    def digest(self, path: Path) -> str:
        """Return the digest of a file, read once a run unless a stage has rewritten it."""
        if path not in self.digests:
            self.digests[path] = atomic.digest(path)
        return self.digests[path]


@dataclass(frozen=True, slots=True)
class Stage:
    """A row of the table: what the stage reads, writes and depends on.

    `inputs` and `outputs` are names below the output folder; `{shot}` stands for every shot, `{map}` for the shots
    of the environment, `{frames}` for all RAW frames, `{darkroom}` for the dark frame, the flat field and the lens database,
    `{chart}` and `{lamp}` for the files that `correct` and `balance` name, `{pair}` for the merged shots with the lamp on and
    off, and `{spectra}` for measured spectra and further profiles that the
    settings name.
    `settings` names the parts of the settings on which the result depends.
    """

    name: str
    light: str
    settings: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    work: Callable[[Run], Outcome]


def expand(names: Sequence[str], run: Run) -> list[Path]:
    """Return the paths that names such as `merge/{shot}.exr` stand for in a run."""
    loaded, paths = run.loaded, []
    for name in names:
        if name == "{frames}":
            paths += [frame for frames in loaded.shots.values() for frame in frames]
        elif name == "{darkroom}":
            paths += [loaded.path.parent / path for path in loaded.settings.merge.files]
            database = loaded.settings.merge.lens_database
            paths += [] if database is None else database_files(loaded.path.parent / database)
        elif name == "{chart}":
            patches = loaded.settings.correct.patches
            paths += [] if patches is None else [loaded.path.parent / patches]
        elif name == "{lamp}":
            balance = loaded.settings.balance
            named = [loaded.path.parent / path for path in (balance.spectrum, balance.camera) if path is not None]
            # A camera may also be a name.
            paths += [path for path in named if path.is_file()]
        elif name == "{pair}":
            paths += [run.path(f"merge/{shot}.exr") for shot in ("reference", LAMP_OFF) if loaded.lamp_off]
        elif name == "{spectra}":
            paths += [light.spd for light in loaded.lights if light.spd is not None]
            library, sky_model = loaded.settings.cluster.library, loaded.settings.cluster.sky_model
            paths += [] if library is None else in_library(library)
            paths += [] if sky_model is None else [sky_model]
            paths += [loaded.folder / name for name in loaded.settings.cluster.profiles]
        elif "{shot}" in name:
            paths += [run.path(name.format(shot=shot)) for shot in loaded.shots]
        elif "{map}" in name:
            paths += [run.path(name.format(map=shot)) for shot in map_shots(loaded)]
        else:
            paths.append(run.path(name))
    return paths


def map_shots(loaded: Loaded) -> tuple[str, ...]:
    """Return the names of the shots the map is made of: the environment's, or the reference."""
    return tuple(loaded.environments) or ("reference",)


def run_pipeline(
    loaded: Loaded,
    stages: Sequence[Stage],
    *,
    reporter: Reporter,
    until: str | None = None,
    first: str | None = None,
    force: bool = False,
) -> dict[str, Any]:
    """Bring every stage up to date, in order, and return the record that stands in `run.json`.

    `until` names the last stage to do, `first` the first to do again even if unchanged, `force` does all again.
    """
    names = [stage.name for stage in stages]
    last = names.index(until) if until else len(stages) - 1
    again = 0 if force else names.index(first) if first else len(stages)
    with _locked(loaded.output):
        atomic.sweep(loaded.output)
        run = Run(loaded, reporter, records=_records(loaded.output / RECORD))
        for number, stage in enumerate(stages[: last + 1]):
            _bring_up_to_date(run, stage, again=number >= again)
        for stale in [name for name in run.records if name not in names]:
            del run.records[stale]
        return _write_record(run)


@contextlib.contextmanager
def _locked(output: Path) -> Iterator[None]:
    """Hold the output folder for this process; the system lets go of the lock when the process dies."""
    from filelock import FileLock, Timeout

    try:
        output.mkdir(parents=True, exist_ok=True)
        lock = FileLock(output / ".lock")
        lock.acquire(timeout=0)
    except Timeout:
        raise EnvcalError(
            f"{output}: another envcal is running in this folder. Wait for it, or choose another `output`."
        ) from None
    except OSError as error:
        raise EnvcalError(f"{output}: cannot be used ({error.strerror}). Choose another `output`.") from error
    try:
        yield
    finally:
        lock.release()


def _bring_up_to_date(run: Run, stage: Stage, *, again: bool) -> None:
    inputs = expand(stage.inputs, run)
    outputs = expand(stage.outputs, run)
    settings = settings_of(run.loaded, stage.settings)
    made_of = [[path.name, run.digest(path)] for path in inputs]
    basis: list[Any] = [
        stage.name,
        settings,
        made_of,
        list(run.loaded.shots),
        [p.name for p in outputs],
        source_digest(),
    ]
    if stage.name == "report":
        basis.append({name: record for name, record in run.records.items() if name != "report"})
    key = hashlib.sha256(json.dumps(basis, sort_keys=True).encode()).hexdigest()
    record = run.records.get(stage.name)
    if not again and record and record.get("key") == key and _intact(run, outputs, record):
        run.reporter.say(f"{stage.name:<10} unchanged")
        for text in record["warnings"]:
            run.reporter.warn(f"{stage.name}: {text}")
        return
    started = time.perf_counter()
    outcome = stage.work(run)
    seconds = time.perf_counter() - started
    for path in outputs:
        run.digests.pop(path, None)
    run.records[stage.name] = {
        "key": key,
        "light": stage.light,
        "seconds": round(seconds, 3),
        "settings": settings,
        "inputs": made_of,
        "outputs": {_relative(path, run): run.digest(path) for path in outputs},
        "summary": outcome.summary,
        "figures": dict(outcome.figures),
        "warnings": list(outcome.warnings),
    }
    run.reporter.say(f"{stage.name:<10} {seconds:6.1f} s  {outcome.summary}")
    for text in outcome.warnings:
        run.reporter.warn(f"{stage.name}: {text}")
    _write_record(run)


def _relative(path: Path, run: Run) -> str:
    return path.relative_to(run.loaded.output).as_posix()


def _intact(run: Run, outputs: Sequence[Path], record: Mapping[str, Any]) -> bool:
    known = record.get("outputs", {})
    return all(path.is_file() and known.get(_relative(path, run)) == run.digest(path) for path in outputs)


def settings_of(loaded: Loaded, names: Sequence[str]) -> dict[str, Any]:
    """Return the named parts of the settings as JSON values."""
    dumped = loaded.settings.model_dump(mode="json")
    return {name: dumped[name] for name in names}


def changed_settings(loaded: Loaded) -> dict[str, Any]:
    """Return the settings that differ from their defaults, without the capture and the output folder."""
    dumped = loaded.settings.model_dump(mode="json", exclude_defaults=True)
    return {name: value for name, value in dumped.items() if name not in ("capture", "output")}


@cache
def source_digest() -> str:
    """A digest of envcal's own source: another version, or an edited one, does every stage again."""
    total = hashlib.sha256(__version__.encode())
    for package in ("envcal", "calibrate", "uplift"):
        root = Path(__file__).parent.parent / package
        for path in sorted([*root.rglob("*.py"), *root.rglob("*.j2")]):
            total.update(path.relative_to(root).as_posix().encode())
            total.update(path.read_bytes())
    return total.hexdigest()


def read_records(output: Path) -> dict[str, Any]:
    """The records of a finished run in `output`; an `EnvcalError` if there is none."""
    records = _records(output / RECORD)
    if not records:
        raise EnvcalError(f"{output}: holds no finished run ({RECORD}). Give the output folder of `envcal run`.")
    return records


def _records(path: Path) -> dict[str, Any]:
    """The records of an earlier run; a missing or damaged file only means that every stage is done again."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))["stages"]
        return {name: dict(record) for name, record in found.items() if "key" in record and "warnings" in record}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def _write_record(run: Run) -> dict[str, Any]:
    record = {
        "envcal": __version__,
        "pipeline": run.loaded.path.name,
        "changed_settings": changed_settings(run.loaded),
        "stages": run.records,
    }
    atomic.write_json(run.loaded.output / RECORD, record)
    return record
