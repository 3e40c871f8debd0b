"""A command for every stage."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from envcal.cli.group import main
from envcal.cli.options import (
    FILE,
    SPACES,
    finish,
    indoor_option,
    json_option,
    library_option,
    lights_option,
    output_option,
    photometry_option,
    profile_option,
    set_option,
    space_option,
)
from envcal.cli.overwriting import refuse_own_input

if TYPE_CHECKING:
    from envcal.config import DeclaredLight
    from envcal.runner import Outcome


@main.command()
@click.argument("frames", nargs=-1, required=True, type=FILE)
@output_option("merged radiance (.exr)")
@set_option("align=true")
@json_option
def merge(frames: Sequence[Path], out: Path, overrides: Sequence[str], as_json: bool) -> None:
    """Merge a bracket of RAW FRAMES to radiance in camera RGB."""
    from envcal.config import MergeSettings, stage_settings
    from envcal.reporter import Reporter
    from envcal.steps.merge import merge as work
    from envcal.steps.merge import refuse_unknown_names

    settings = stage_settings(MergeSettings, "merge", overrides)
    refuse_unknown_names(settings, {out.stem: tuple(frames)})
    refuse_own_input(out, [*frames, settings.dark_frame, settings.flat_field, settings.lens_database])
    with Reporter().progress("merge") as progress:
        outcome = work(frames, out, settings, progress=progress)
    finish(outcome, as_json=as_json, out=out)


@main.command()
@click.argument("merged", type=FILE)
@output_option("corrected radiance (.exr)")
@profile_option
@click.option(
    "--chart",
    metavar="X,Y,X,Y,X,Y,X,Y",
    help="The chart's corners in pixels instead of a search: top left (dark skin), top right, bottom right, bottom left.",
)
@click.option("--space", type=click.Choice(SPACES), help=f"Working RGB space of a new profile (default: {SPACES[0]}).")
@set_option("fit=auto")
@json_option
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
    profile_out = out.with_suffix(".profile.json")
    refuse_own_input(out, [merged, profile, settings.patches], beside=[profile_out] if profile is None else [])
    if profile is None:
        found = calibrate_on_chart(merged, settings, space or SPACES[0])
        found.write(profile_out)
    else:
        found = profiles.read(profile)
    outcome = work(merged, out, settings, found, applied=None if profile is None else str(profile))
    finish(_with_warnings(outcome, found.warnings if profile is None else []), as_json=as_json, out=out)


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
@output_option("balanced radiance (.exr)")
@profile_option
@click.option("--lamp", metavar="X,Y,W,H", help="The lamp's rectangle in pixels instead of a search.")
@click.option(
    "--camera",
    metavar="NAME|FILE",
    help="The camera's spectral sensitivities (CSV, or JSON as of rawtoaces), to measure the chart's light with.",
)
@photometry_option("patch='{patch: white, luminance: 215}'")
@click.option(
    "--pair",
    nargs=2,
    type=FILE,
    metavar="ON OFF",
    help="Merged brackets of this view with the lamp on and off, each with its noise (`--set deviation=true`).",
)
@set_option("spectrum=module.csv")
@json_option
def balance(
    corrected: Path,
    out: Path,
    profile: Path | None,
    lamp: str | None,
    camera: str | None,
    photometry: Sequence[str],
    pair: tuple[Path, Path] | None,
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

    if profile is not None and (lamp is not None or camera is not None or pair is not None or photometry or overrides):
        raise click.UsageError(
            "--lamp, --camera, --pair, --photometry and --set belong to the search for the lamp; a profile brings its own "
            "gains, its chart's light and its unit."
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
    profile_out = out.with_suffix(".profile.json")
    read = [corrected, profile, settings.spectrum, None if camera is None else Path(camera), *(pair or ())]
    refuse_own_input(out, read, beside=[profile_out] if profile is None else [])
    if profile is None:
        found = calibrate_on_lamp(corrected, settings, absolute, pair=pair)
        found.write(profile_out)
    else:
        found = profiles.read(profile)
    outcome = work(corrected, out, settings, found, applied=None if profile is None else str(profile))
    finish(_with_warnings(outcome, found.warnings if profile is None else []), as_json=as_json, out=out)


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
@output_option("lat-long map (.exr)")
@photometry_option("horizontal_illuminance=540")
@json_option
def panorama(shots: Sequence[Path], out: Path, photometry: Sequence[str], as_json: bool) -> None:
    """Turn SHOTS into one lat-long map; for the time being a lat-long shot passes through."""
    from envcal.config import PanoramaSettings, PhotometrySettings, stage_settings
    from envcal.steps.panorama import panorama as work

    absolute = stage_settings(PhotometrySettings, "photometry", photometry)
    if photometry and absolute.of_map is None:
        raise click.UsageError("what is known of the exposure or the chart belongs to `envcal balance`.")
    refuse_own_input(out, shots)
    finish(work(shots, out, PanoramaSettings(), absolute), as_json=as_json, out=out)


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
    tell_lost: bool = True,
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
        tell_lost=tell_lost,
    )


@main.command()
@click.argument("map_path", metavar="MAP", type=FILE)
@output_option("clusters (.exr)")
@indoor_option
@lights_option
@library_option
@click.option(
    "--profile",
    "profile_paths",
    type=FILE,
    multiple=True,
    help="Profile of a chart shot in this place: its light's measured spectrum is used. May be given several times.",
)
@space_option
@set_option("most=2")
@json_option
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
    refuse_own_input(out, [map_path, lights_path, *profile_paths], beside=[lights_out])
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
    finish(outcome, as_json=as_json, out=out)


@main.command()
@click.argument("map_path", metavar="MAP", type=FILE)
@output_option("uplift file (.exr)")
@click.option("--clusters", type=FILE, help="What `envcal cluster` found in this map; left out: it is done here.")
@indoor_option
@lights_option
@library_option
@click.option(
    "--method",
    type=click.Choice(["constrained", "scaled", "lattice"]),
    help="Under the light of each pixel (constrained, the default); or for comparison the usual uplift under D65, or "
    "the paper's lattice.",
)
@space_option
@set_option("precision=float")
@json_option
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
    from envcal.runner import Outcome
    from envcal.steps.cluster import lights_figures
    from envcal.steps.uplift import read_lights
    from envcal.steps.uplift import uplift as work

    if clusters is not None and (indoor is not None or lights_path is not None or library is not None):
        raise click.UsageError(
            "--indoor, --lights and --library belong to the search for lights; give them to `envcal cluster`."
        )
    refuse_own_input(out, [map_path, clusters, lights_path])
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
                tell_lost=False,
            )
            more = [*found.warnings]
            if not as_json:
                click.echo(found.summary)
        lights = lights_figures(read_lights(clusters))
        outcome = work(read_map(map_path, space=space), clusters, out, settings, progress=progress)
    outcome = Outcome(outcome.summary, {**outcome.figures, **lights}, outcome.warnings)
    finish(_with_warnings(outcome, more), as_json=as_json, out=out)


@main.command()
@click.argument("uplift_path", metavar="UPLIFT", type=FILE)
@output_option("spectral image (.exr)")
@click.option("--wavelengths", default="380:780:5", show_default=True, help="start:stop:step, or a list, in nm.")
@click.option("--half", is_flag=True, help="16-bit floats.")
@json_option
def spectra(uplift_path: Path, out: Path, wavelengths: str, half: bool, as_json: bool) -> None:
    """Write the spectral radiance of an UPLIFT file in the spectral EXR layout."""
    from envcal.config import SpectraSettings, parse_bands
    from envcal.reporter import Reporter
    from envcal.steps.spectra import spectra as work

    try:
        parse_bands(wavelengths)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--wavelengths") from None
    refuse_own_input(out, [uplift_path])
    with Reporter().progress("spectra") as progress:
        outcome = work(uplift_path, out, SpectraSettings(wavelengths=wavelengths, half=half), progress=progress)
    finish(outcome, as_json=as_json, out=out)
