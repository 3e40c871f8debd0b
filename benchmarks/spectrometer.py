"""The chart as a spectrometer: what the measured spectra are worth, and how often the kind of lamp is right.

`python -m benchmarks spectrometer [--lamps spd_houser.mat] [--json FILE]`. It needs the environment variable ENVCAL_DATA: a
folder with `camera_sensitivities.npz`, `led19_measured.csv`, `truth/room*.npz` and `munsell_glossy_1485.npz`. Each published lamp
that the prior holds is measured with a prior that knows neither it nor any other published lamp within 5 % of its
spectrum. `--lamps` names the 401 lamps of Houser et al. (Opt. Express 21, 2013) as Debian's psychtoolbox-3-common has them;
those within 5 % of a published one, or of the same product, are left out. Readings have 1 % noise on every value, the lamp's
too; an unknown camera is one that the model of cameras was fitted without.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks import rooms as relit
from uplift.spectrometer import FAMILIES, Reading, anchored, chart_reflectances, measure_light, reading_of
from uplift.spectrometer.camera import CameraModel, fitted_model, model_of
from uplift.spectrometer.lamps import PUBLISHED, lamps, planck, published
from uplift.spectrometer.prior import Prior, prior_of
from uplift.spectrometer.refusal import MOST_CHI2
from uplift.spectrum import illuminant, normalised, observer, rgb_space

Float64 = npt.NDArray[np.float64]
EYES = observer()
SPACE = rgb_space("ITU-R BT.2020")
NOISE = 0.01
ALIKE = 0.05  # rms difference over rms: nearer ones are the same lamp
#: The set's labels that say what a lamp is; what fits none (theoretical spectra, names without a meaning) is left out.
KINDS = (
    ("led", r"LED|NGL|Cree|Lumileds|Soraa|Xicato|RGB model|RGB product|4 peak|Booth|B-Y|Luxeon|PHOS-\d"),
    ("fluorescent", r"FL\b|CIE F\d|F3\.\d|FL3|F32|F34|F40|luoresc|TL8|TL9|TL7"),
    ("incandescent", r"ncandesc|alogen|60WA19|Reveal|75W Soft|75 W Rough|MCRI-35: A$|Tru Aim|Houser: 2|Houser: 3000"),
    ("discharge", r"HPS|Mercury|Metal Halide|HP\d$|MHC|SDW|CDM|cdm|MH100W|White SON|C100S|H38"),
    ("daylight", r"D65|Houser: [5-8]"),
)
#: Products that colour-science has from the same catalogue, whatever their distance.
SAME_PRODUCT = r"AE 9200|TL830|TL835|TL841|TL850|TL865|C50|C75|F40CWX|F40DX|F40N"


@dataclass(frozen=True, slots=True, eq=False)
class Tested:
    """A lamp to be measured, and the published lamps that its prior must not know."""

    family: str
    name: str
    emission: Float64
    left_out: frozenset[str] = frozenset()


@cache
def _published() -> tuple[tuple[str, str, Float64], ...]:
    return tuple((family, name, published(name, EYES)) for family, names in PUBLISHED.items() for name in names)


def alike(emission: Float64) -> frozenset[str]:
    """Names of the published lamps that are this lamp."""
    size = np.linalg.norm(emission)
    return frozenset(name for _, name, known in _published() if np.linalg.norm(known - emission) < ALIKE * size)


def measured_leds(folder: Path) -> list[Tested]:
    """The measured LEDs of the folder that are no CIE illuminants."""
    return [
        Tested("led", lamp.name, lamp.emission)
        for lamp in relit.lamps(folder, EYES)
        if lamp.kind == "led" and not lamp.name.startswith("LED-") and lamp.cct < 12_000 and not alike(lamp.emission)
    ]


def left_out_lamps() -> list[Tested]:
    """Every published lamp, once each, with a prior that does not know it."""
    return [Tested(family, name, known, alike(known)) for family, name, known in _published()]


def houser(path: Path) -> list[Tested]:
    """The lamps of the set that the prior does not know."""
    from scipy.io import loadmat

    data = loadmat(path)
    out = []
    for label, values in zip(data["labels_houser"][0], data["spd_houser"].T, strict=True):
        name = " ".join(str(label[0]).split())
        kind = next((kind for kind, pattern in KINDS if re.search(pattern, name)), None)
        wavelengths = np.arange(380.0, 781.0, 5.0)
        emission = normalised(np.maximum(np.interp(EYES.wavelengths_nm, wavelengths, values), 0.0), EYES)
        if kind and not re.search(SAME_PRODUCT, name) and not alike(emission):
            out.append(Tested(kind, name, emission))
    return out


def natural(folder: Path) -> list[Tested]:
    """Daylight of another model than the prior's (Hosek and Wilkie's skies, and sun and sky together), and filaments.

    The filaments are Planck's with an emissivity that falls by up to 12 % over the visible; the prior's vary alike, so they test
    the noise rather than the prior.
    """
    out = []
    for path in sorted((folder / "truth").glob("outdoor*.npz")):
        with np.load(path) as file:
            grid, radiance = file["wavelengths"], file["radiance"].astype(np.float64)
            spectra = [("total", file["total_spd"].astype(np.float64))]
        height, width = radiance.shape[:2]
        rng = np.random.default_rng(1)
        for _ in range(8):
            row, column = rng.integers(0, height // 2), rng.integers(0, width)
            spectra.append((f"sky at {row}, {column}", radiance[row, column]))
        for name, values in spectra:
            on_grid = np.maximum(np.interp(EYES.wavelengths_nm, grid, values), 0.0)
            out.append(Tested("daylight", f"{path.stem}: {name}", normalised(on_grid, EYES)))
    rng = np.random.default_rng(5)
    for kelvin in rng.uniform(1900.0, 3400.0, 20):
        fall = 1.0 - 0.12 * rng.random() * (EYES.wavelengths_nm - 570.0) / 200.0
        filament = planck(np.array([kelvin]), EYES.wavelengths_nm)[0] * fall
        out.append(Tested("incandescent", f"filament {kelvin:.0f} K", normalised(filament, EYES)))
    return out


def cameras(folder: Path, count: int) -> tuple[list[int], Float64]:
    """Numbers of `count` cameras spread over the set, and all sensitivities [K, N, 3], anchored to D65."""
    with np.load(folder / "camera_sensitivities.npz") as file:
        curves = np.asarray(file["ssf"], np.float64)
    grid = np.arange(380.0, 781.0, 5.0)
    every = [
        anchored(np.stack([np.interp(EYES.wavelengths_nm, grid, np.maximum(c, 0.0)) for c in one.T], -1), EYES)
        for one in curves
    ]
    return [int(k) for k in np.linspace(0, len(every) - 1, count).round()], np.array(every)


def model_without(curves: Float64, number: int) -> CameraModel:
    """A model of cameras that has not seen one of them; as many directions as the shipped one."""
    from uplift.spectrometer.camera_table import DIRECTIONS

    return model_of(*fitted_model(np.delete(curves, number, 0), EYES.wavelengths_nm, len(DIRECTIONS)), EYES)


def prior_without(lamp: Tested) -> Prior:
    """The prior that does not know a lamp; of those made for one lamp only the last is kept in memory."""
    if lamp.left_out and prior_of.cache_info().currsize > 3:
        prior_of.cache_clear()
        lamps.cache_clear()
    return prior_of(EYES, lamp.left_out)


def read(light: Float64, curves: Float64, seed: int) -> Reading:
    """What a camera reads of the chart under a light, with noise on every value."""
    chance = np.random.default_rng(seed)
    exact = np.einsum("pn,nc,n->pc", chart_reflectances(EYES), curves, light)
    lamp = np.einsum("nc,n->c", curves, illuminant("D65", EYES))
    noisy = exact * (1.0 + NOISE * chance.standard_normal((24, 3)))
    return reading_of(noisy, NOISE * np.abs(noisy), lamp * (1.0 + NOISE * chance.standard_normal(3)))


def relights(
    folder: Path, every: list[Tested], chosen: list[int], curves: Float64, each: int
) -> Iterator[dict[str, Any]]:
    """Relight errors of each lamp with `each` cameras: scaled, with the true and with the measured spectra."""
    places, models = relit.rooms(folder, EYES), {k: model_without(curves, k) for k in chosen}
    surfaces = relit.atlas(folder, EYES)
    context = {"observer": EYES, "space": SPACE}
    for number, lamp in enumerate(every):
        source = relit.Lamp(lamp.family, lamp.name, lamp.emission, 0.0, 0.0, in_library=False)
        scenes = [relit.lit(room, dict.fromkeys(range(3), (source, 1.0)), count=100, **context) for room in places]  # type: ignore[arg-type]
        labels = [np.zeros(scene.rgb.shape[:2], np.uint32) for scene in scenes]
        scaled = [relit.scaled_error(scene, surfaces, **context) for scene in scenes]  # type: ignore[arg-type]

        def errors(emission: Float64, scenes: Any = scenes, labels: Any = labels) -> list[float]:
            pairs = zip(scenes, labels, strict=True)
            return [relit.error(scene, own, [emission], surfaces, **context) for scene, own in pairs]  # type: ignore[arg-type]

        true = errors(lamp.emission)
        for turn in range(each):
            camera = chosen[(number + turn * 3) % len(chosen)]
            reading = read(lamp.emission, curves[camera], seed=1000 * number + camera)
            prior = prior_without(lamp)
            found = {
                "known": measure_light(reading, camera=curves[camera], observer=EYES, prior=prior),
                "unknown": measure_light(reading, camera=models[camera], observer=EYES, prior=prior),
            }
            row: dict[str, Any] = {
                "family": lamp.family,
                "name": lamp.name,
                "camera": camera,
                "scaled": scaled,
                "true": true,
            }
            for key, light in found.items():
                # What was refused is not used: the light then has no better spectrum than the scaled uplift gives it.
                row[key] = scaled if light.refused else errors(light.emission)
                row[f"{key}_refused"] = bool(light.refused)
                row[f"{key}_sure"] = light.camera_loss
            yield row


def kinds(every: list[Tested], chosen: list[int], curves: Float64, *, known: bool) -> dict[str, Any]:
    """The family that each lamp is taken for with each camera, and how probable it was said to be."""
    truth, found, misfits = [], [], []
    refused = dict.fromkeys(chosen, 0)
    models = {} if known else {k: model_without(curves, k) for k in chosen}
    for number, lamp in enumerate(every):
        prior = prior_without(lamp)
        for camera in chosen:
            reading = read(lamp.emission, curves[camera], seed=1000 * number + camera)
            instrument = curves[camera] if known else models[camera]
            light = measure_light(reading, camera=instrument, observer=EYES, prior=prior)
            truth.append(FAMILIES.index(lamp.family))
            found.append([light.families[name] for name in FAMILIES])
            misfits.append(light.chi2)
            refused[camera] += bool(light.refused)
    return {
        **judged_kinds(np.array(truth), np.array(found)),
        "lamps": len(every),
        "largest_chi2": max(misfits),
        "refused": sum(refused.values()),
        "refused_of_camera": refused,
    }


def judged_kinds(truth: npt.NDArray[np.int64], found: Float64) -> dict[str, Any]:
    """How often the most probable family was right [S] by the probabilities `found` [S, 5], and whether these are true.

    `ece` is the expected calibration error over 15 bins of equal width (C. Guo et al., "On calibration of modern neural
    networks", ICML 2017); `log_loss` the mean of -log of the right family's probability.
    """
    right, surest = found.argmax(axis=1) == truth, found.max(axis=1)
    bins, ece = [], 0.0
    for k in range(15):
        inside = (surest > k / 15) & (surest <= (k + 1) / 15)
        if inside.any():
            ece += float(inside.mean() * abs(surest[inside].mean() - right[inside].mean()))
    for low, high in (
        (0.2, 0.5),
        (0.5, 0.6),
        (0.6, 0.7),
        (0.7, 0.8),
        (0.8, 0.9),
        (0.9, 0.97),
        (0.97, 0.995),
        (0.995, 1.01),
    ):
        inside = (surest >= low) & (surest < high)
        if inside.any():
            bins.append([float(surest[inside].mean()), float(right[inside].mean()), int(inside.sum())])
    by_family = {
        name: [float(right[truth == k].mean()), int((truth == k).sum())]
        for k, name in enumerate(FAMILIES)
        if (truth == k).any()
    }
    said = np.maximum(found[np.arange(truth.size), truth], 1e-12)
    return {
        "readings": truth.size,
        "right": by_family,
        "reliability": bins,
        "ece": ece,
        "log_loss": float(-np.log(said).mean()),
    }


def gmean(values: Any) -> float:
    """Geometric mean."""
    return float(np.exp(np.mean(np.log(np.asarray(values)))))


def report(figures: dict[str, Any]) -> str:
    """Return the figures as text."""
    lines = []
    rows = figures.get("relight", [])
    if rows:
        scaled = np.array([row["scaled"] for row in rows])
        ratios = {key: np.array([row[key] for row in rows]) / scaled for key in ("true", "known", "unknown")}
        floor = gmean(ratios["true"])
        lines.append(
            f"relight error ÷ that of the scaled uplift, {len({r['name'] for r in rows})} lamps, "
            f"{len({r['camera'] for r in rows})} cameras, {scaled.size} maps:"
        )
        for key, ratio in ratios.items():
            lines.append(
                f"  {key:8} geometric mean {gmean(ratio):.3f}, gain of the true spectrum {(1 - gmean(ratio)) / (1 - floor):.0%}, "
                f"worst {ratio.max():.2f}; maps above 1.2: {(ratio > 1.2).mean():.1%}, of which the true spectrum is too: "
                f"{((ratio > 1.2) & (ratios['true'] > 1.2)).mean():.1%}; worst ÷ true {(ratio / np.maximum(ratios['true'], 1)).max():.2f}"
            )
            for family in FAMILIES:
                own = np.array([row["family"] == family for row in rows])
                if own.any():
                    lines.append(
                        f"    {family:13} {gmean(ratio[own]):.3f}, worst {ratio[own].max():.2f} ({own.sum()} readings)"
                    )
        lines += [
            f"  {key}: {np.mean([row[f'{key}_refused'] for row in rows]):.1%} refused" for key in ("known", "unknown")
        ]
        lost = gmean([row["unknown_sure"] for row in rows])
        lines.append(
            f"  not knowing the camera makes the standard deviation {lost:.2f} times as large (geometric mean)"
        )
    for key in ("kinds_known", "kinds_unknown"):
        if key in figures:
            own = figures[key]
            lines.append(
                f"{key}: {own['lamps']} lamps, {own['readings']} readings, {own['refused']} refused, chi² ≤ {own['largest_chi2']:.2f} (limit {MOST_CHI2}), "
                f"expected calibration error {own['ece']:.3f}, log loss {own['log_loss']:.3f}"
            )
            some = ", ".join(f"{name}: {count}" for name, count in own["refused_of_camera"].items() if count)
            lines.append(f"  refused of each camera, of {own['lamps']}: {some or 'none'}")
            lines += [f"  {name:13} {share:.1%} of {count}" for name, (share, count) in own["right"].items()]
            lines += [f"  said {said:.3f}, right {right:.3f} ({count})" for said, right, count in own["reliability"]]
    if "held_out" in figures:
        own = figures["held_out"]
        lines.append(f"temper and weight of LEDs chosen on either half of the lamps: {own['chosen']}")
        for key in ("held_out", "shipped"):
            judged = own[key]
            right = ", ".join(f"{name} {share:.1%} of {count}" for name, (share, count) in judged["right"].items())
            lines.append(
                f"  {key}: {right}; expected calibration error {judged['ece']:.3f}, log loss {judged['log_loss']:.3f}"
            )
    for case, (rightly, count) in figures.get("refusals", {}).items():
        lines.append(f"refusal of {case}: named rightly {rightly} of {count}")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; return 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks spectrometer", description=__doc__)
    parser.add_argument("--lamps", type=Path, metavar="MAT", help="spd_houser.mat of psychtoolbox-3-common")
    parser.add_argument("--cameras", type=int, default=11, help="cameras (default 11)")
    parser.add_argument("--each", type=int, default=2, help="cameras for each lamp of the relight test (default 2)")
    parser.add_argument("--every", type=int, default=1, help="take every n-th lamp only")
    parser.add_argument(
        "--only", choices=("relight", "kinds", "kinds-unknown", "held-out", "refusals"), help="measure this alone"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    chosen = parser.parse_args(arguments)
    named = os.environ.get("ENVCAL_DATA")
    if named is None:
        print("ENVCAL_DATA is not set: cameras, lamps and rooms are needed; nothing is measured")
        return 0
    folder = Path(named)
    numbers, curves = cameras(folder, chosen.cameras)
    figures: dict[str, Any] = {}
    more = houser(chosen.lamps) if chosen.lamps else []
    fresh = [*measured_leds(folder), *more] if more else [*measured_leds(folder), *left_out_lamps()]
    if chosen.only in (None, "relight"):
        tested = _spread(fresh, 40 if more else 1000)[:: chosen.every]
        figures["relight"] = list(relights(folder, tested, numbers, curves, chosen.each))
    everything = [*fresh, *(left_out_lamps() if more else []), *natural(folder)][:: chosen.every]
    if chosen.only in (None, "kinds"):
        figures["kinds_known"] = kinds(everything, numbers, curves, known=True)
    if chosen.only == "kinds-unknown":
        figures["kinds_unknown"] = kinds(everything, numbers, curves, known=False)
    if chosen.only == "held-out":
        from benchmarks.kinds_held_out import held_out, measured

        figures["held_out"] = held_out(measured(everything, numbers, curves))
    if chosen.only == "refusals":
        from benchmarks import chart_refusals

        figures["refusals"] = chart_refusals.named(curves, numbers[1:7:5])
    print(report(figures))
    if chosen.json:
        chosen.json.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    return 0


def _spread(every: list[Tested], most: int) -> list[Tested]:
    """At most so many lamps of each family, evenly over the list."""
    out = []
    for family in FAMILIES:
        own = [lamp for lamp in every if lamp.family == family]
        out += own[:: max(1, -(-len(own) // most))]
    return out


if __name__ == "__main__":
    sys.exit(main())
