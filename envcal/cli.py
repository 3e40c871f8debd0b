"""The command line: one command for the whole pipeline and one per stage.

Everything heavy is imported inside the commands, so that `envcal --help` answers at once.
"""

from __future__ import annotations

import atexit
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from envcal import __version__
from envcal.errors import EnvcalError

if TYPE_CHECKING:
    from envcal.config import DeclaredLight
    from envcal.runner import Outcome

Command = TypeVar("Command", bound=Callable[..., Any])

STAGE_NAMES = ("merge", "correct", "balance", "panorama", "cluster", "uplift", "spectra", "report")
SPACES = ("ITU-R BT.2020", "sRGB", "P3-D65", "ACEScg", "ACES2065-1", "Adobe Wide Gamut RGB")
INDOOR = ("auto", "led", "fluorescent", "incandescent")
#: What shells expect of a program that was stopped by Ctrl-C.
INTERRUPTED = 130
FILE = click.Path(path_type=Path)


class _Group(click.Group):
    """Turns a mistake in the input or in the settings into one message and exit status 1."""

    def invoke(self, ctx: click.Context) -> Any:
        _let_numba_cache()
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            click.echo("envcal: stopped. Nothing is half-written; `envcal run` goes on where it stopped.", err=True)
            ctx.exit(INTERRUPTED)
        except (EnvcalError, ValueError) as error:
            if not _is_ours(error):
                raise
            click.echo(f"envcal: {error}" if "\n" not in str(error) else f"envcal: mistakes found:\n{error}", err=True)
            ctx.exit(1)


def _let_numba_cache() -> None:
    """Give numba a folder for its compiled code where neither the installation nor the home folder can be written.

    Without one it refuses to work at all. The folder is this process's own, since what numba loads from it is code.
    """
    home = Path.home() if os.environ.get("HOME") or os.name == "nt" else None
    writable = any(folder is not None and os.access(folder, os.W_OK) for folder in (Path(__file__).parent, home))
    if "NUMBA_CACHE_DIR" not in os.environ and not writable:
        folder = tempfile.mkdtemp(prefix="envcal-")
        os.environ["NUMBA_CACHE_DIR"] = folder
        atexit.register(shutil.rmtree, folder, ignore_errors=True)


def _is_ours(error: Exception) -> bool:
    """Whether an error is a message for people; a ValueError of anybody else is our own mistake."""
    kinds = {EnvcalError.__name__, "CalibrateError", "UpliftError"}
    return any(kind.__name__ in kinds for kind in type(error).__mro__)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="envcal")
def main() -> None:
    """Bracketed RAW photographs in, a calibrated spectral environment map out.

    `envcal run pipeline.yaml` does everything; each stage is also a command of its own.
    """


def _exr_name(_context: click.Context, _option: click.Parameter, path: Path) -> Path:
    if path.suffix.lower() != ".exr":
        raise click.BadParameter(f"{path} does not end in .exr, and that is what is written there")
    return path


def _output(what: str) -> Callable[[Command], Command]:
    return click.option(
        "-o", "--output", "out", required=True, type=FILE, callback=_exr_name, help=f"Where to write the {what}."
    )


def _set(example: str) -> Callable[[Command], Command]:
    return click.option(
        "--set",
        "overrides",
        multiple=True,
        metavar="KEY=VALUE",
        help=f"Any setting that a pipeline.yaml has for this stage, such as {example}. Paths start from here.",
    )


def _photometry(example: str) -> Callable[[Command], Command]:
    return click.option(
        "--photometry",
        multiple=True,
        metavar="KEY=VALUE",
        help=f"Absolute units, as under `photometry` in a pipeline.yaml, such as {example} (default: relative).",
    )


_json = click.option("--json", "as_json", is_flag=True, help="Print the figures as JSON on stdout.")
_profile = click.option("--profile", type=FILE, help="Apply this profile instead of calibrating on this shot.")
_space = click.option(
    "--space",
    type=click.Choice(SPACES),
    help="Linear RGB space of the map, where its header does not say (default: sRGB).",
)
_indoor = click.option("--indoor", type=click.Choice(INDOOR), help="What undeclared indoor lights are (default: auto).")
_library = click.option(
    "--library",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Folder of your own measured spectra.",
)
_lights = click.option("--lights", "lights_path", type=FILE, help="lights.yaml: what is known of the lights.")


def _finish(outcome: Outcome, *, as_json: bool, out: Path) -> None:
    from envcal.reporter import Reporter

    reporter = Reporter(quiet=as_json)
    reporter.say(f"{outcome.summary} → {out}")
    for text in outcome.warnings:
        reporter.warn(text)
    if as_json:
        _print_json({"summary": outcome.summary, "figures": outcome.figures, "warnings": list(outcome.warnings)})


def _print_json(value: Any) -> None:
    click.echo(json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False))


@main.command()
@click.argument("pipeline", type=FILE)
@click.option("--until", type=click.Choice(STAGE_NAMES), help="Stop after this stage.")
@click.option("--from", "first", type=click.Choice(STAGE_NAMES), help="Do this stage and all later ones again.")
@click.option("--force", is_flag=True, help="Do every stage again.")
@click.option(
    "--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Change a setting, such as uplift.method=scaled."
)
@_json
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
        _print_json(record)
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
@click.argument("frames", nargs=-1, required=True, type=FILE)
@_output("merged radiance (.exr)")
@_set("align=true")
@_json
def merge(frames: Sequence[Path], out: Path, overrides: Sequence[str], as_json: bool) -> None:
    """Merge a bracket of RAW FRAMES to radiance in camera RGB."""
    from envcal.config import MergeSettings, stage_settings
    from envcal.reporter import Reporter
    from envcal.steps.merge import merge as work
    from envcal.steps.merge import refuse_unknown_names

    settings = stage_settings(MergeSettings, "merge", overrides)
    refuse_unknown_names(settings, {out.stem: tuple(frames)})
    with Reporter().progress("merge") as progress:
        outcome = work(frames, out, settings, progress=progress)
    _finish(outcome, as_json=as_json, out=out)


@main.command()
@click.argument("merged", type=FILE)
@_output("corrected radiance (.exr)")
@_profile
@click.option(
    "--chart",
    metavar="X,Y,X,Y,X,Y,X,Y",
    help="The chart's corners in pixels instead of a search: top left (dark skin), top right, bottom right, bottom left.",
)
@click.option("--space", type=click.Choice(SPACES), help=f"Working RGB space of a new profile (default: {SPACES[0]}).")
@_set("fit=auto")
@_json
def correct(
    merged: Path,
    out: Path,
    profile: Path | None,
    chart: str | None,
    space: str | None,
    overrides: Sequence[str],
    as_json: bool,
) -> None:
    """Find the colour chart in MERGED and correct the colours by it, or apply a profile.

    A profile found here is written beside the output, as OUT.profile.json.
    """
    from envcal import profile as profiles
    from envcal.config import CorrectSettings, stage_settings
    from envcal.steps.correct import calibrate_on_chart
    from envcal.steps.correct import correct as work

    if profile is not None and (chart is not None or space is not None or overrides):
        raise click.UsageError(
            "--chart, --space and --set belong to a new calibration; a profile brings its own matrix and space."
        )
    settings = stage_settings(CorrectSettings, "correct", overrides, chart=None if chart is None else _corners(chart))
    if profile is None:
        found = calibrate_on_chart(merged, settings, space or SPACES[0])
        found.write(out.with_suffix(".profile.json"))
    else:
        found = profiles.read(profile)
    outcome = work(merged, out, settings, found, applied=None if profile is None else str(profile))
    _finish(_with_warnings(outcome, found.warnings if profile is None else []), as_json=as_json, out=out)


def _corners(text: str) -> Any:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 8:
        raise click.BadParameter(f"{text!r} is not eight numbers x,y,x,y,x,y,x,y", param_hint="--chart")
    return tuple(zip(values[::2], values[1::2], strict=True))


@main.command()
@click.argument("corrected", type=FILE)
@_output("balanced radiance (.exr)")
@_profile
@click.option("--lamp", metavar="X,Y,W,H", help="The lamp's rectangle in pixels instead of a search.")
@click.option(
    "--camera",
    metavar="NAME|FILE",
    help="The camera's spectral sensitivities (CSV, or JSON as of rawtoaces), to measure the chart's light with.",
)
@_photometry("patch='{patch: white, luminance: 215}'")
@_set("spectrum=module.csv")
@_json
def balance(
    corrected: Path,
    out: Path,
    profile: Path | None,
    lamp: str | None,
    camera: str | None,
    photometry: Sequence[str],
    overrides: Sequence[str],
    as_json: bool,
) -> None:
    """Find the D65 lamp in CORRECTED and balance the colours by it, or apply a profile.

    The profile completed here is written beside the output, as OUT.profile.json.
    """
    from envcal import profile as profiles
    from envcal.config import BalanceSettings, PhotometrySettings, stage_settings
    from envcal.steps.balance import balance as work
    from envcal.steps.balance import calibrate_on_lamp

    if profile is not None and (lamp is not None or camera is not None or photometry or overrides):
        raise click.UsageError(
            "--lamp, --camera, --photometry and --set belong to the search for the lamp; a profile brings its own gains, its "
            "chart's light and its unit."
        )
    absolute = stage_settings(PhotometrySettings, "photometry", photometry)
    if absolute.of_map is not None:
        raise click.UsageError("an illuminance at the place of the map belongs to `envcal panorama`.")
    settings = stage_settings(
        BalanceSettings,
        "balance",
        overrides,
        lamp=None if lamp is None else {"rectangle": _rectangle(lamp)},
        camera=camera,
    )
    if profile is None:
        found = calibrate_on_lamp(corrected, settings, absolute)
        found.write(out.with_suffix(".profile.json"))
    else:
        found = profiles.read(profile)
    outcome = work(corrected, out, settings, found, applied=None if profile is None else str(profile))
    _finish(_with_warnings(outcome, found.warnings if profile is None else []), as_json=as_json, out=out)


def _rectangle(text: str) -> tuple[float, float, float, float]:
    try:
        x, y, w, h = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not four numbers x,y,w,h", param_hint="--lamp") from None
    return x, y, w, h


def _with_warnings(outcome: Outcome, more: Sequence[str]) -> Outcome:
    from envcal.runner import Outcome

    return Outcome(outcome.summary, outcome.figures, [*more, *outcome.warnings])


@main.command()
@click.argument("shots", nargs=-1, required=True, type=FILE)
@_output("lat-long map (.exr)")
@_photometry("horizontal_illuminance=540")
@_json
def panorama(shots: Sequence[Path], out: Path, photometry: Sequence[str], as_json: bool) -> None:
    """Turn SHOTS into one lat-long map; for the time being a lat-long shot passes through."""
    from envcal.config import PanoramaSettings, PhotometrySettings, stage_settings
    from envcal.steps.panorama import panorama as work

    absolute = stage_settings(PhotometrySettings, "photometry", photometry)
    if photometry and absolute.of_map is None:
        raise click.UsageError("what is known of the exposure or the chart belongs to `envcal balance`.")
    _finish(work(shots, out, PanoramaSettings(), absolute), as_json=as_json, out=out)


def _declared(path: Path | None, library: Path | None) -> Sequence[DeclaredLight]:
    from envcal.config import load_lights

    return () if path is None else load_lights(path, library)


def _find_lights(
    source: Path,
    out: Path,
    lights_out: Path,
    *,
    profile_paths: Sequence[Path] = (),
    indoor: str | None,
    lights_path: Path | None,
    space: str | None,
    library: Path | None,
    overrides: Sequence[str] = (),
) -> Outcome:
    from envcal import profile as profiles
    from envcal.config import ClusterSettings, Pipeline, stage_settings
    from envcal.maps import read_map
    from envcal.steps.cluster import cluster as work

    settings = stage_settings(ClusterSettings, "cluster", overrides, indoor=indoor, library=library)
    if settings.lights or settings.profiles:
        raise click.UsageError("--set has no lights or profiles; give them with --lights and --profile.")
    defaults = Pipeline.model_fields
    return work(
        read_map(source, space=space),
        out,
        lights_out,
        settings,
        declared=_declared(lights_path, library),
        wavelengths=defaults["wavelengths"].default,
        observer_name=defaults["observer"].default,
        profiles={str(path): profiles.read(path) for path in profile_paths},
    )


@main.command()
@click.argument("map_path", metavar="MAP", type=FILE)
@_output("clusters (.exr)")
@_indoor
@_lights
@_library
@click.option(
    "--profile",
    "profile_paths",
    type=FILE,
    multiple=True,
    help="Profile of a chart shot in this place: its light's measured spectrum is used. May be given several times.",
)
@_space
@_set("most=2")
@_json
def cluster(
    map_path: Path,
    out: Path,
    indoor: str | None,
    lights_path: Path | None,
    library: Path | None,
    profile_paths: Sequence[Path],
    space: str | None,
    overrides: Sequence[str],
    as_json: bool,
) -> None:
    """Find sky, lights and their colour temperatures in MAP (.exr or .hdr, lat-long).

    The lights are also written beside the output, as OUT.lights.json.
    """
    lights_out = out.with_suffix(".lights.json")
    outcome = _find_lights(
        map_path,
        out,
        lights_out,
        profile_paths=profile_paths,
        indoor=indoor,
        lights_path=lights_path,
        space=space,
        library=library,
        overrides=overrides,
    )
    _finish(outcome, as_json=as_json, out=out)


@main.command()
@click.argument("map_path", metavar="MAP", type=FILE)
@_output("uplift file (.exr)")
@click.option("--clusters", type=FILE, help="What `envcal cluster` found in this map; left out: it is done here.")
@_indoor
@_lights
@_library
@click.option(
    "--method",
    type=click.Choice(["constrained", "scaled", "lattice"]),
    help="Under the light of each pixel (constrained, the default); or for comparison the usual uplift under D65, or "
    "the paper's lattice.",
)
@_space
@_set("precision=float")
@_json
def uplift(
    map_path: Path,
    out: Path,
    clusters: Path | None,
    indoor: str | None,
    lights_path: Path | None,
    library: Path | None,
    method: str | None,
    space: str | None,
    overrides: Sequence[str],
    as_json: bool,
) -> None:
    """Give every pixel of MAP (.exr or .hdr, lat-long) a spectrum: three coefficients, a scale and its light.

    With the method lattice it is a mixture of eight spectra instead, from which `envcal spectra` makes bands.
    """
    from envcal.config import UpliftSettings, stage_settings
    from envcal.maps import read_map
    from envcal.reporter import Reporter
    from envcal.steps.uplift import uplift as work

    if clusters is not None and (indoor is not None or lights_path is not None or library is not None):
        raise click.UsageError(
            "--indoor, --lights and --library belong to the search for lights; give them to `envcal cluster`."
        )
    settings = stage_settings(UpliftSettings, "uplift", overrides, method=method)
    more: list[str] = []
    with tempfile.TemporaryDirectory() as folder, Reporter().progress("uplift") as progress:
        if clusters is None:
            clusters = Path(folder) / "clusters.exr"
            found = _find_lights(
                map_path,
                clusters,
                Path(folder) / "lights.json",
                indoor=indoor,
                lights_path=lights_path,
                space=space,
                library=library,
            )
            more = [*found.warnings]
            if not as_json:
                click.echo(found.summary)
        outcome = work(read_map(map_path, space=space), clusters, out, settings, progress=progress)
    _finish(_with_warnings(outcome, more), as_json=as_json, out=out)


@main.command()
@click.argument("uplift_path", metavar="UPLIFT", type=FILE)
@_output("spectral image (.exr)")
@click.option("--wavelengths", default="380:780:5", show_default=True, help="start:stop:step, or a list, in nm.")
@click.option("--half", is_flag=True, help="16-bit floats.")
@_json
def spectra(uplift_path: Path, out: Path, wavelengths: str, half: bool, as_json: bool) -> None:
    """Write the spectral radiance of an UPLIFT file in the spectral EXR layout."""
    from envcal.config import SpectraSettings, parse_bands
    from envcal.reporter import Reporter
    from envcal.steps.spectra import spectra as work

    try:
        parse_bands(wavelengths)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--wavelengths") from None
    with Reporter().progress("spectra") as progress:
        outcome = work(uplift_path, out, SpectraSettings(wavelengths=wavelengths, half=half), progress=progress)
    _finish(outcome, as_json=as_json, out=out)


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
@_json
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
    _finish(outcome, as_json=as_json, out=folder)


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
@_json
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
    _finish(outcome, as_json=as_json, out=folder)


@main.command()
@click.argument("output", type=FILE)
def report(output: Path) -> None:
    """Write the page about a run, report.html, into its OUTPUT folder again."""
    from envcal.report import write_report
    from envcal.runner import read_records

    outcome = write_report(output, read_records(output))
    click.echo(f"{outcome.summary} → {output / 'report.html'}")


if __name__ == "__main__":
    sys.exit(main())
