"""Commands that carry an uplift file into renderers."""

from __future__ import annotations

from pathlib import Path

import click

from envcal.cli.group import main
from envcal.cli.options import FILE, SPACES, finish, json_option


def _size(_context: click.Context, _option: click.Parameter, text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdigit() and 16 <= int(part) <= 8192 for part in parts):
        raise click.BadParameter(f"{text!r} is not WIDTHxHEIGHT with sides from 16 to 8192, such as 960x540")
    return int(parts[0]), int(parts[1])


@main.command()
@click.argument("uplift_path", metavar="UPLIFT", type=FILE)
@click.option("-o", "--output", "folder", required=True, type=FILE, help="Folder for the scene and its pictures.")
@click.option("--size", callback=_size, metavar="WIDTHxHEIGHT", help="Of the pictures (default: 960x540).")
@click.option("--spp", type=click.IntRange(8, 65536), help="Samples a pixel (default: 256).")
@click.option("--variant", default="auto", show_default=True, help="Mitsuba variant; auto: LLVM, or scalar and small.")
@click.option("--no-render", is_flag=True, help="Only write the scene.")
@json_option
def mitsuba(
    uplift_path: Path,
    folder: Path,
    size: tuple[int, int] | None,
    spp: int | None,
    variant: str,
    no_render: bool,
    as_json: bool,
) -> None:
    """Write a small scene around an UPLIFT file for Mitsuba 3, and render it if Mitsuba is installed.

    The same scene lit by the map's RGB alone, and the colour difference of the two, come with it. In the output folder
    of a run, under mitsuba/, the pictures go into the report.
    """
    from envcal.reporter import Reporter
    from envcal.scene.make import make_scene

    with Reporter().progress("mitsuba") as progress:
        outcome = make_scene(
            uplift_path, folder, size=size, spp=spp, variant=variant, render=not no_render, progress=progress
        )
    finish(outcome, as_json=as_json, out=folder)


@main.command()
@click.argument("uplift_path", metavar="UPLIFT", type=FILE)
@click.option("-o", "--output", "folder", required=True, type=FILE, help="Folder for the files.")
@click.option(
    "--to",
    "form",
    required=True,
    type=click.Choice(["rgb", "pbrt", "basis"]),
    help="rgb: a lat-long map; pbrt: lights of pbrt-v4; basis: passes of Mitsuba without a plugin.",
)
@click.option("--space", type=click.Choice(SPACES), help="Of --to rgb (default: ACEScg).")
@click.option("--half", is_flag=True, help="16-bit floats, for rgb and pbrt.")
@json_option
def export(uplift_path: Path, folder: Path, form: str, space: str | None, half: bool, as_json: bool) -> None:
    """Write an UPLIFT file in a form that other renderers read, with a README.md of what is lost."""
    from envcal.reporter import Reporter

    if space is not None and form != "rgb":
        raise click.UsageError("--space belongs to --to rgb; pbrt gets linear Rec. 2020, basis gets coefficients.")
    if half and form == "basis":
        raise click.UsageError("--half belongs to colours; coefficients need full floats.")
    with Reporter().progress("export") as progress:
        if form == "rgb":
            from envcal.export.rgb import export_rgb

            outcome = export_rgb(uplift_path, folder, space=space or "ACEScg", half=half, progress=progress)
        elif form == "pbrt":
            from envcal.export.pbrt import export_pbrt

            outcome = export_pbrt(uplift_path, folder, half=half, progress=progress)
        else:
            from envcal.export.basis import export_basis

            outcome = export_basis(uplift_path, folder, progress=progress)
    finish(outcome, as_json=as_json, out=folder)
