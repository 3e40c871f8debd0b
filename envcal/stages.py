"""THE ORDER OF THE LIGHT: every stage of the pipeline, a row each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from envcal.config.loading import LAMP_OFF
from envcal.runner import Outcome, Run, Stage, map_shots


def _merge(run: Run) -> Outcome:
    from envcal.steps.merge import merge, refuse_unknown_names, rooted

    settings = rooted(run.loaded.settings.merge, run.loaded.path.parent)
    refuse_unknown_names(settings, run.loaded.shots)
    # What changed between lamp on and lamp off is judged by the noise of both.
    noisy = ("reference", LAMP_OFF) if run.loaded.lamp_off else ()
    known = settings.model_copy(update={"deviation": True})
    return _each(
        run,
        run.loaded.shots,
        lambda shot, progress: merge(
            run.loaded.shots[shot],
            run.path(f"merge/{shot}.exr"),
            known if shot in noisy else settings,
            progress=progress,
        ),
    )


def _correct(run: Run) -> Outcome:
    from envcal.steps.correct import calibrate_on_chart, correct

    settings = run.loaded.settings.correct
    profile = calibrate_on_chart(
        run.path("merge/reference.exr"),
        settings,
        run.loaded.settings.working_space,
        folder=run.loaded.path.resolve().parent,
    )
    profile.write(run.path("correct/profile.json"))
    outcome = _each(
        run,
        run.loaded.shots,
        lambda shot, _: correct(run.path(f"merge/{shot}.exr"), run.path(f"correct/{shot}.exr"), settings, profile),
    )
    return Outcome(outcome.summary, outcome.figures, [*profile.warnings, *outcome.warnings])


def _balance(run: Run) -> Outcome:
    from envcal.steps.balance import balance, calibrate_on_lamp

    settings = run.loaded.settings.balance
    pair = (run.path("merge/reference.exr"), run.path(f"merge/{LAMP_OFF}.exr")) if run.loaded.lamp_off else None
    profile = calibrate_on_lamp(
        run.path("correct/reference.exr"),
        settings,
        run.loaded.settings.photometry,
        folder=run.loaded.folder,
        pair=pair,
    )
    profile.write(run.path("balance/profile.json"))
    outcome = _each(
        run,
        run.loaded.shots,
        lambda shot, _: balance(run.path(f"correct/{shot}.exr"), run.path(f"balance/{shot}.exr"), settings, profile),
    )
    return Outcome(outcome.summary, outcome.figures, [*profile.warnings, *outcome.warnings])


def _panorama(run: Run) -> Outcome:
    from envcal.steps.panorama import panorama

    shots = [run.path(f"balance/{shot}.exr") for shot in map_shots(run.loaded)]
    settings = run.loaded.settings
    return panorama(shots, run.path("panorama/environment.exr"), settings.panorama, settings.photometry)


def _cluster(run: Run) -> Outcome:
    from envcal import profile
    from envcal.maps import read_map
    from envcal.steps.cluster import calibration_error, cluster

    settings = run.loaded.settings
    reference = profile.read(run.path("balance/profile.json"))
    further = {str(name): profile.read(run.loaded.folder / name) for name in settings.cluster.profiles}
    return cluster(
        read_map(run.path("panorama/environment.exr")),
        run.path("cluster/clusters.exr"),
        run.path("cluster/lights.json"),
        settings.cluster,
        declared=run.loaded.lights,
        wavelengths=settings.wavelengths,
        observer_name=settings.observer,
        calibration=calibration_error(reference),
        profiles={"the reference": reference, **further},
    )


def _uplift(run: Run) -> Outcome:
    from envcal.maps import read_map
    from envcal.steps.uplift import uplift

    source = read_map(run.path("panorama/environment.exr"))
    with run.reporter.progress("uplift") as progress:
        return uplift(
            source,
            run.path("cluster/clusters.exr"),
            run.path("uplift/environment.exr"),
            run.loaded.settings.uplift,
            progress=progress,
            reported=True,
        )


def _spectra(run: Run) -> Outcome:
    from envcal.steps.spectra import spectra

    with run.reporter.progress("spectra") as progress:
        return spectra(
            run.path("uplift/environment.exr"),
            run.path("spectra/environment.exr"),
            run.loaded.settings.spectra,
            progress=progress,
        )


def _report(run: Run) -> Outcome:
    from envcal.report import write_report

    return write_report(run.loaded.output, run.records)


STAGES: tuple[Stage, ...] = (
    Stage(
        name="merge",
        light="RAW bracket → radiance in camera RGB",
        settings=("merge",),
        inputs=("{frames}", "{darkroom}"),
        outputs=("merge/{shot}.exr",),
        work=_merge,
    ),
    Stage(
        name="correct",
        light="chart found in the reference shot → camera to working RGB, applied to every shot",
        settings=("correct", "working_space"),
        inputs=("merge/{shot}.exr", "{chart}"),
        outputs=("correct/{shot}.exr", "correct/profile.json"),
        work=_correct,
    ),
    Stage(
        name="balance",
        light="lamp of known spectrum found in the reference shot → von Kries, applied to every shot",
        settings=("balance", "photometry"),
        inputs=("correct/{shot}.exr", "{lamp}", "{pair}"),
        outputs=("balance/{shot}.exr", "balance/profile.json"),
        work=_balance,
    ),
    Stage(
        name="panorama",
        light="shots → one lat-long map",
        settings=("panorama", "photometry"),
        inputs=("balance/{map}.exr",),
        outputs=("panorama/environment.exr",),
        work=_panorama,
    ),
    Stage(
        name="cluster",
        light="map → sky, clusters, CCT, light spectra",
        settings=("cluster", "wavelengths", "observer"),
        inputs=("panorama/environment.exr", "balance/profile.json", "{spectra}"),
        outputs=("cluster/clusters.exr", "cluster/lights.json"),
        work=_cluster,
    ),
    Stage(
        name="uplift",
        light="map + lights → coefficients per pixel",
        settings=("uplift",),
        inputs=("panorama/environment.exr", "cluster/clusters.exr"),
        outputs=("uplift/environment.exr",),
        work=_uplift,
    ),
    Stage(
        name="spectra",
        light="coefficients → spectral radiance",
        settings=("spectra",),
        inputs=("uplift/environment.exr",),
        outputs=("spectra/environment.exr",),
        work=_spectra,
    ),
    Stage(
        name="report",
        light="everything → a page",
        settings=(),
        inputs=(
            "merge/{shot}.exr",
            "correct/{shot}.exr",
            "correct/profile.json",
            "balance/{shot}.exr",
            "balance/profile.json",
            "panorama/environment.exr",
            "cluster/clusters.exr",
            "cluster/lights.json",
            "uplift/environment.exr",
            "spectra/environment.exr",
        ),
        outputs=("report.html",),
        work=_report,
    ),
)


def _each(run: Run, shots: Iterable[str], work: Callable[..., Outcome]) -> Outcome:
    """Do the work for every shot; figures by shot, warnings together, the reference's summary.

    What is said alike of several shots, after the name of each one's file, is said once, with their number.
    """
    outcomes: dict[str, Outcome] = {}
    for shot in shots:
        with run.reporter.progress(shot) as progress:
            outcomes[shot] = work(shot, progress)
    first = next(iter(outcomes.values()))
    more = f" (and {len(outcomes) - 1} more shot{'s' if len(outcomes) > 2 else ''})" if len(outcomes) > 1 else ""
    said: dict[str, list[str]] = {}
    for shot, outcome in outcomes.items():
        for text in outcome.warnings:
            said.setdefault(text.removeprefix(f"{shot}.exr: "), []).append(shot)
    warnings = [f"{_named(alike, len(outcomes))}{text}" for text, alike in said.items()]
    figures = {"shots": {shot: dict(outcome.figures) for shot, outcome in outcomes.items()}}
    return Outcome(first.summary + more, figures, warnings)


def _named(shots: Sequence[str], count: int) -> str:
    """What stands before a warning: the shots that it is about, three of them by name; of a capture of one shot nothing."""
    if count == 1:
        return ""
    names = ", ".join(shots[:3]) + (", …" if len(shots) > 3 else "")
    return f"{names}: " if len(shots) == 1 else f"{len(shots)} of {count} shots ({names}): "
