"""Commands on a whole pipeline.yaml and on what a run left."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import click

from envcal.cli.group import main
from envcal.cli.options import FILE, STAGE_NAMES, json_option, print_json


@main.command()
@click.argument("pipeline", type=FILE)
@click.option("--until", type=click.Choice(STAGE_NAMES), help="Stop after this stage.")
@click.option("--from", "first", type=click.Choice(STAGE_NAMES), help="Do this stage and all later ones again.")
@click.option("--force", is_flag=True, help="Do every stage again.")
@click.option(
    "--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Change a setting, such as uplift.method=scaled."
)
@json_option
def run(
    pipeline: Path, until: str | None, first: str | None, force: bool, overrides: Sequence[str], as_json: bool
) -> None:
    """Run the pipeline; stages whose inputs and settings are unchanged are skipped."""
    from envcal import config
    from envcal.reporter import Reporter
    from envcal.runner import changed_settings, run_pipeline
    from envcal.stages import STAGES

    loaded = config.load(pipeline, overrides=overrides)
    reporter = Reporter(quiet=as_json)
    for name, value in changed_settings(loaded).items():
        reporter.say(f"not the default: {name}: {json.dumps(value, ensure_ascii=False)}")
    record = run_pipeline(loaded, STAGES, reporter=reporter, until=until, first=first, force=force)
    if as_json:
        print_json(record)
    elif until is None:
        reporter.say(f"report     {loaded.output / 'report.html'}")


@main.command()
@click.argument("pipeline", type=FILE)
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Change a setting.")
def check(pipeline: Path, overrides: Sequence[str]) -> None:
    """Check settings and frames; every mistake is listed, with its line, before anything runs."""
    from envcal import config
    from envcal.checks import check_frames

    loaded = config.load(pipeline, overrides=overrides)
    for text in check_frames(loaded):
        click.echo(f"warning: {text}", err=True)
    shots = ", ".join(f"{name} ({len(frames)} frames)" for name, frames in loaded.shots.items())
    click.echo(f"{pipeline}: no mistakes; {shots}")


@main.command()
def schema() -> None:
    """Print the JSON schema of pipeline.yaml, for editors."""
    from envcal import config

    click.echo(config.schema(), nl=False)


@main.command()
@click.argument("output", type=FILE)
def report(output: Path) -> None:
    """Write the page about a run, report.html, into its OUTPUT folder again."""
    from envcal.report import write_report
    from envcal.runner import read_records

    outcome = write_report(output, read_records(output))
    click.echo(f"{outcome.summary} → {output / 'report.html'}")
