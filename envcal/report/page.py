"""Gather what a run has left and write the page."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from envcal import __version__, atomic
from envcal.errors import EnvcalError
from envcal.report import run_record
from envcal.report.run_record import StageRecord, Warned
from envcal.runner import Outcome

PAGE = "report.html"
TEMPLATE = Path(__file__).with_name("page.html.j2")
#: Sections in the order of the light: the anchor and the heading.
SECTIONS = {
    "map": "The map",
    "warnings": "Warnings",
    "merge": "Merged shots",
    "chart": "Chart",
    "lamp": "Lamp",
    "shots": "Corrected and balanced",
    "lights": "Lights",
    "uplift": "Uplift",
    "spectra": "Spectral image",
    "scene": "A scene in its light",
    "times": "Times and files",
}
Found = TypeVar("Found")


def write_report(output: Path, records: Mapping[str, Any]) -> Outcome:
    """Write `report.html` into `output` from the files there and the `stages` of its record.

    What a run stopped early has not made is left out; a file that cannot be read is left out with a warning. The
    page is one file without links to others, and the same run gives the same bytes.
    """
    from envcal.stages import STAGES

    lights_of_table = {stage.name: stage.light for stage in STAGES if stage.name != "report"}
    parsed = run_record.parse(records, place=output / "run.json")
    known = {name: parsed[name] for name in lights_of_table if name in parsed}
    gathered = _gather(output, known)
    problems: list[str] = gathered.pop("problems")
    page = _render(
        **gathered,
        **_head(known, list(lights_of_table), problems),
        stages=[_stage_row(output, name, light, known.get(name)) for name, light in lights_of_table.items()],
        version=__version__,
    )
    atomic.write_text(output / PAGE, page)
    size = len(page.encode())
    shown = [name for name in SECTIONS if gathered.get(name) is not None]
    return Outcome(f"a page of {size / 1e6:.1f} MB", {"file": PAGE, "bytes": size, "sections": shown}, problems)


def _gather(output: Path, records: Mapping[str, StageRecord]) -> dict[str, Any]:
    from envcal.report import capture_sections as capture
    from envcal.report import light_sections as light
    from envcal.report.scene_section import scene

    problems: list[str] = []

    def tried(work: Callable[[], Found]) -> Found | None:
        try:
            return work()
        except (EnvcalError, ValueError) as error:  # a file that was tampered with fails in the rooms' own checks
            problems.append(f"left out of the page: {error}")
            return None

    def figures(stage: str) -> dict[str, Any]:
        return records[stage].figures if stage in records else {}

    calibration = tried(lambda: capture.read_profile(output))
    found = tried(lambda: light.read_lights(output))
    return {
        "map": tried(lambda: light.environment_map(output)),
        "merge": tried(lambda: capture.merge(output, records.get("merge"))),
        "calibration": calibration,
        "chart": tried(lambda: capture.chart(output, calibration)) if calibration else None,
        "lamp": tried(lambda: capture.lamp(output, calibration)) if calibration else None,
        "shots": tried(lambda: capture.before_and_after(output)) or None,
        "lights": tried(lambda: light.lights(output, found)) if found else None,
        "uplift": tried(lambda: light.uplift(output, figures("uplift"), found)),
        "spectra": tried(lambda: light.spectra(output)),
        "scene": tried(lambda: scene(output, _digest(records, "uplift", "uplift/environment.exr"))),
        "figures": {name: record.figures for name, record in records.items()},
        "problems": problems,
    }


def _digest(records: Mapping[str, StageRecord], stage: str, file: str) -> str | None:
    return records[stage].outputs.get(file) if stage in records else None


def _head(records: Mapping[str, StageRecord], order: list[str], problems: list[str]) -> dict[str, Any]:
    """The verdict, every warning, and the settings that were changed."""
    old = run_record.stale(records, order)
    warnings = [Warned(name, text) for name, record in records.items() for text in record.warnings]
    warnings += [
        Warned(name, "made from files that have changed since. Run `envcal run` to the end to bring it up to date.")
        for name in old
    ]
    warnings += [Warned("report", text) for text in problems]
    return {
        "warnings": warnings,
        "stale": old,
        "done": len(records) - len(old),
        "of": len(order),
        "seconds": sum(record.seconds for record in records.values()),
        "changed": run_record.changed_settings(records),
    }


def _stage_row(output: Path, name: str, light: str, record: StageRecord | None) -> dict[str, Any]:
    root = output.resolve()

    def size(file: str) -> int | None:
        path = (root / file).resolve()
        return path.stat().st_size if path.is_relative_to(root) and path.is_file() else None

    files = (
        [{"name": file, "digest": digest, "bytes": size(file)} for file, digest in record.outputs.items()]
        if record
        else []
    )
    return {"name": name, "light": light, "record": record, "files": files}


def _render(**values: Any) -> str:
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    # Names of files, lamps and shots come from strangers: everything is escaped but our own plots.
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters.update(
        num=_number, percent=_percent, seconds=_seconds, size=_size, count=_count, basename=_basename, svg=Markup
    )
    text = environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(sections=SECTIONS, **values)
    return text.encode("utf-8", "replace").decode("utf-8")


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _number(value: Any, digits: int = 2) -> str:
    """A number with `digits` decimals; tiny ones with an exponent; a dash for what is none."""
    if not _is_number(value):
        return "–"
    if value and abs(value) < 0.5 * 10**-digits:
        mantissa, exponent = f"{value:.1e}".split("e")
        text = f"{mantissa}e{int(exponent)}"
    else:
        text = f"{value:.{digits}f}"
    return text.replace("-", "−")


def _percent(value: Any, digits: int = 1) -> str:
    if not _is_number(value):
        return "–"
    least = 10**-digits
    return f"< {least:.{digits}f} %" if 0 < 100 * value < least else f"{100 * value:.{digits}f} %".replace("-", "−")


def _count(value: Any) -> str:
    return f"{value:,}".replace(",", " ") if _is_number(value) else "–"


def _basename(name: str) -> str:
    """The last part of a path of any system: where the frames stand is nobody's business."""
    return name.replace("\\", "/").rsplit("/", 1)[-1]


def _seconds(value: Any) -> str:
    if not _is_number(value):
        return "–"
    return f"{value:.2f} s" if value < 10 else f"{value:.1f} s" if value < 120 else f"{value / 60:.1f} min"


def _size(value: Any) -> str:
    if not _is_number(value):
        return "–"
    return (
        f"{value / 1e3:.0f} kB" if value < 1e6 else f"{value / 1e6:.1f} MB" if value < 1e9 else f"{value / 1e9:.2f} GB"
    )
