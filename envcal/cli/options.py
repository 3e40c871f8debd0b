"""Options that several commands share, and how a command ends."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from envcal.runner import Outcome

Command = TypeVar("Command", bound=Callable[..., Any])

STAGE_NAMES = ("merge", "correct", "balance", "panorama", "cluster", "uplift", "spectra", "report")
SPACES = ("ITU-R BT.2020", "sRGB", "P3-D65", "ACEScg", "ACES2065-1", "Adobe Wide Gamut RGB")
INDOOR = ("auto", "led", "fluorescent", "incandescent")
FILE = click.Path(path_type=Path)


def _exr_name(_context: click.Context, _option: click.Parameter, path: Path) -> Path:
    if path.suffix.lower() != ".exr":
        raise click.BadParameter(f"{path} does not end in .exr, and that is what is written there")
    return path


def output_option(what: str) -> Callable[[Command], Command]:
    return click.option(
        "-o", "--output", "out", required=True, type=FILE, callback=_exr_name, help=f"Where to write the {what}."
    )


def set_option(example: str) -> Callable[[Command], Command]:
    return click.option(
        "--set",
        "overrides",
        multiple=True,
        metavar="KEY=VALUE",
        help=f"Any setting that a pipeline.yaml has for this stage, such as {example}. Paths start from here.",
    )


def photometry_option(example: str) -> Callable[[Command], Command]:
    return click.option(
        "--photometry",
        multiple=True,
        metavar="KEY=VALUE",
        help=f"Absolute units, as under `photometry` in a pipeline.yaml, such as {example} (default: relative).",
    )


json_option = click.option("--json", "as_json", is_flag=True, help="Print the figures as JSON on stdout.")
profile_option = click.option("--profile", type=FILE, help="Apply this profile instead of calibrating on this shot.")
space_option = click.option(
    "--space",
    type=click.Choice(SPACES),
    help="Linear RGB space of the map, where its header does not say (default: sRGB).",
)
indoor_option = click.option(
    "--indoor",
    type=click.Choice(INDOOR),
    help="What indoor lights are of which --lights does not say it; a declared type wins (default: auto).",
)
library_option = click.option(
    "--library",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Folder of your own measured spectra.",
)
lights_option = click.option(
    "--lights",
    "lights_path",
    type=FILE,
    help="lights.yaml: what is known of the lights, as `lights: [{at: [u, v], type: led}]`.",
)


def finish(outcome: Outcome, *, as_json: bool, out: Path) -> None:
    from envcal.reporter import Reporter

    reporter = Reporter(quiet=as_json)
    reporter.say(f"{outcome.summary} → {out}")
    for text in outcome.warnings:
        reporter.warn(text)
    if as_json:
        print_json({"summary": outcome.summary, "figures": outcome.figures, "warnings": list(outcome.warnings)})


def print_json(value: Any) -> None:
    click.echo(json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False))
