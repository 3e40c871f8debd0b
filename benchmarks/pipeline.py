"""From RAW files to spectra: the whole pipeline on synthetic captures, beside what is true of the rooms they show.

    python -m benchmarks pipeline [--rooms 8] [--width 1280] [--json FILE]

Each room is photographed as seven RAW frames with a chart and a D65 module in view, under two lamps whose spectra are published
measurements or CIE tables, by one of the two cameras whose sensitivities colour-science has. `envcal`'s own pipeline runs on the
files: with nothing said, with the camera's sensitivities, with the kinds of both lamps declared, with their spectra, and with these but one light a
pixel (`uplift.mixtures: false`). What it makes is judged by spectra that no code of the pipeline has seen:

- *map*: mean ΔE2000 between the calibrated map and the XYZ of the place, a white diffuser at the chart being white;
- *relight*: mean ΔE2000 of 33 measured reflectances lit by each pixel's spectrum and by the true one, so all errors together: noise,
  demosaicing, chart, camera, lamp, lights, uplift. Its floor, from the true colours, lamps and shares, says what is the uplift's own;
- *usual*: the same for the unconstrained uplift (a reflectance under D65, in sRGB) of the same calibrated map, which is what renderers do.

Pixels are spread evenly over the sphere; those that mix an emitter with something else, and lamps themselves, are left out of both.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.rooms import relight, sampled
from samples import spectra as published
from samples.capture import Capture, CaptureSettings, make_capture, write_capture
from samples.places import CEILING, STANDING, Room
from samples.sensor import Camera
from samples.truth import Truth
from uplift.spectrum import Observer, RGBSpace, observer, rgb_space

Float64 = npt.NDArray[np.float64]

NIKON, SIGMA = "Nikon 5100 (NPL)", "Sigma SDMerill (NPL)"


@dataclass(frozen=True, slots=True)
class Case:
    """A room: the spectra of its ceiling panel and its standing globe, what a person would call them, and the camera."""

    panel: str
    globe: str
    kinds: tuple[str, str]
    camera: str


CASES = (
    Case("LED-B4", "A", ("led", "incandescent"), NIKON),
    Case("F32T8/TL841 (Triphosphor)", "60 A/W (Soft White)", ("FL11", "incandescent"), NIKON),
    Case("LED-B3", "LED-B1", ("led", "led"), SIGMA),
    Case("FL2", "Luxeon WW 2880", ("fluorescent", "led"), NIKON),
    Case("D65", "LED-V1", ("daylight", "led"), NIKON),
    Case("PHOS-2", "A", ("led", "incandescent"), SIGMA),
    Case("3-LED-4 (455/547/623)", "LED-B2", ("led", "led"), NIKON),
    Case("LED-V2", "LED-V2", ("led", "led"), NIKON),
)
#: What is told of the lights and of the camera, the less first.
WAYS = ("nothing", "camera", "declared", "spectra", "unmixed")
PIXELS = 4000
REFLECTANCES = 33


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """The pixels that are judged [P], and what is true of them."""

    rows: npt.NDArray[np.int64]
    columns: npt.NDArray[np.int64]
    spectra: Float64  # [P, N], a white diffuser at the chart having Y = 1
    rgb: Float64  # [P, 3] linear BT.2020 of them


def main(arguments: list[str] | None = None) -> int:
    """Photograph, run, judge, print; return 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks pipeline", description=__doc__.splitlines()[0])
    parser.add_argument("--rooms", type=int, default=len(CASES), help=f"at most {len(CASES)}")
    parser.add_argument("--width", type=int, default=1280, help="of the lat-long frames; the chart is a ninth of it")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    given = parser.parse_args(arguments)
    found = []
    print(__doc__.split("\n\n", 2)[2])
    for number, case in enumerate(CASES[: given.rooms]):
        found.append(measured(number, case, given.width))
        _print(found[-1])
    _print_means(found)
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=1), encoding="utf-8")
    return 0


def measured(number: int, case: Case, width: int) -> dict[str, Any]:
    """Photograph a room and run the pipeline on it in every way; return the figures."""
    eyes = observer()
    space = rgb_space("ITU-R BT.2020", observer=eyes)
    lamps = (replace(CEILING, spectrum=case.panel), replace(STANDING, spectrum=case.globe))
    camera = Camera(sensitivities=case.camera, model=f"Synthetic {case.camera.split()[0]}")
    capture = make_capture(CaptureSettings(Room(seed=number, lamps=lamps), width=width, camera=camera, seed=number))
    truth = capture.truth()
    judged = _judged(capture, truth, eyes, space)
    reflectances = np.ascontiguousarray(published.colour_samples()[:: 99 // REFLECTANCES])
    figures: dict[str, Any] = {
        "case": f"{case.panel} + {case.globe}, {case.camera}",
        "pixels": len(judged.rows),
        "true_cct": [float(k) for k in truth.cct_k[:2]],
        "floor": relight(_best(judged, truth, eyes, space), judged.spectra, reflectances, observer=eyes, space=space),
        "usual_of_truth": relight(
            _usual(judged.rgb, eyes, space), judged.spectra, reflectances, observer=eyes, space=space
        ),
        "ways": {},
    }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_capture(folder / "frames", capture)
        for way in WAYS:
            figures["ways"][way] = _run(folder, case, way, truth, judged, reflectances, eyes, space)
        shutil.rmtree(folder / "output")
    return figures


def _judged(capture: Capture, truth: Truth, eyes: Observer, space: RGBSpace) -> Judged:
    height, width = truth.labels.shape
    places = sampled(height, width, PIXELS)
    rows, columns = places // width, places % width
    surface = (truth.seen[rows, columns].max(axis=1) == 0) & (truth.xyz[rows, columns, 1] > 0)
    rows, columns = rows[surface], columns[surface]
    assert truth.patch_xyz is not None
    white = truth.patch_xyz[18, 1] / published.xyz_of(published.chart_reflectances()[18] * _equal())[1]
    cube = capture.view.radiance()[rows, columns].astype(np.float64) * (published.LUMENS_PER_WATT / white)
    rgb = cube @ eyes.cmfs * eyes.step_nm @ space.rgb_from_xyz.T
    return Judged(rows, columns, cube, rgb)


def _equal() -> Float64:
    return published.of_luminance_one(np.ones(len(published.WAVELENGTHS_NM)))


def _run(
    folder: Path,
    case: Case,
    way: str,
    truth: Truth,
    judged: Judged,
    reflectances: Float64,
    eyes: Observer,
    space: RGBSpace,
) -> dict[str, Any]:
    """Run the pipeline on the frames in `folder`, knowing what `way` says, and judge the map and its spectra."""
    from envcal import config, exr
    from envcal.reporter import Reporter
    from envcal.runner import run_pipeline
    from envcal.stages import STAGES
    from envcal.uplift_file import Radiance, read_any_about
    from uplift.difference import delta_e_2000

    settings = folder / "pipeline.yaml"
    settings.write_text(_yaml(folder, case, way, truth), encoding="utf-8")
    loaded = config.load(settings)
    record = run_pipeline(loaded, STAGES, reporter=Reporter(quiet=True), until="uplift")
    stages = record["stages"]
    path = folder / "output" / "uplift" / "environment.exr"
    _, about = read_any_about(path)
    spectral = Radiance(path, about, eyes.wavelengths_nm)
    _, planes = exr.read(path, [*spectral.channels, "R", "G", "B"])
    at = (judged.rows, judged.columns)
    mine = np.asarray(spectral({name: planes[name][at] for name in spectral.channels}), np.float64)
    rgb = np.stack([planes[name][at] for name in "RGB"], axis=-1).astype(np.float64)
    scale = float(np.median(rgb @ space.luminance_weights / (judged.rgb @ space.luminance_weights)))
    rgb, mine = rgb / scale, mine / scale
    lights = stages["cluster"]["figures"]["lights"]
    return {
        "map": float(np.nanmean(delta_e_2000(judged.rgb, rgb, space))),
        "scale": scale,
        "relight": relight(mine, judged.spectra, reflectances, observer=eyes, space=space),
        "usual": relight(_usual(rgb, eyes, space), judged.spectra, reflectances, observer=eyes, space=space),
        "chart": stages["correct"]["figures"]["shots"]["reference"]["delta_e"]["mean"],
        "lights": [(light["cct_seen"], light["cct_sigma"], light["type"], light["source"]) for light in lights],
        "warnings": [text for stage in stages.values() for text in stage["warnings"]],
        "seconds": sum(stage["seconds"] for stage in stages.values()),
    }


def _yaml(folder: Path, case: Case, way: str, truth: Truth) -> str:
    text = "capture:\n  reference: frames/*.dng\noutput: output\n"
    if way != "nothing":
        text += f"balance:\n  camera: {case.camera}\n"
    if way in ("nothing", "camera"):
        return text
    text += "cluster:\n  chart_spectrum: off\n  lights:\n"
    height, width = truth.labels.shape
    names = (case.panel, case.globe)
    text = "uplift: {mixtures: false}\n" + text if way == "unmixed" else text
    for lamp in range(1 if case.panel == case.globe else 2):
        rows, columns = np.nonzero(truth.labels == lamp)
        place = f"at: [{np.median(columns + 0.5) / width:.4f}, {np.median(rows + 0.5) / height:.4f}]"
        if way == "declared":
            text += f"    - {{{place}, type: {case.kinds[lamp]}}}\n"
            continue
        table = "\n".join(
            f"{nm:g},{value:.9g}"
            for nm, value in zip(published.WAVELENGTHS_NM, published.lamp(names[lamp]), strict=True)
        )
        (folder / f"lamp{lamp}.csv").write_text(f"wavelength,power\n{table}\n", encoding="utf-8")
        text += f"    - {{{place}, spd: lamp{lamp}.csv}}\n"
    return text


def _usual(rgb: Float64, eyes: Observer, space: RGBSpace) -> Float64:
    """The spectra [P, N] of the unconstrained uplift of linear BT.2020 [P, 3], in sRGB under D65."""
    from uplift.radiance import spectra_of
    from uplift.scaled import uplift_scaled

    narrow = rgb_space("sRGB", observer=eyes)
    up = uplift_scaled((rgb @ (narrow.rgb_from_xyz @ space.xyz_from_rgb).T)[None], observer=eyes, space=narrow)
    found = spectra_of(up.coefficients, up.scale, up.emission, up.emissions, eyes.wavelengths_nm, observer=eyes)
    return np.asarray(found[0], np.float64)


def _best(judged: Judged, truth: Truth, eyes: Observer, space: RGBSpace) -> Float64:
    """The spectra [P, N] of the constrained uplift of the true colours, each pixel under the lamp that gives most of it."""
    from uplift.pixels import uplift_pixels
    from uplift.radiance import spectra_of
    from uplift.spectrum import normalised
    from uplift.table import build_table

    tables = [build_table(normalised(one, eyes), observer=eyes, space=space) for one in truth.emission[:2]]
    labels = truth.dominant[judged.rows, judged.columns].clip(0).astype(np.uint32)
    up = uplift_pixels(judged.rgb[None], labels[None], tables)
    found = spectra_of(up.coefficients, up.scale, up.emission, up.emissions, eyes.wavelengths_nm, observer=eyes)
    return np.asarray(found[0], np.float64)


def _print(one: dict[str, Any]) -> None:
    print(f"\n{one['case']}: lamps of {' and '.join(f'{k:.0f}' for k in one['true_cct'])} K, {one['pixels']} pixels")
    print(f"  floor {one['floor']:.2f}, usual uplift of the true colours {one['usual_of_truth']:.2f}")
    for way, figures in one["ways"].items():
        lights = "; ".join(f"{cct:.0f} ± {sigma:.0f} K {kind}" for cct, sigma, kind, _ in figures["lights"])
        print(
            f"  {way:9} chart {figures['chart']:.2f}  map {figures['map']:.2f}  scale {figures['scale']:.3f}  relight "
            f"{figures['relight']:.2f}  usual {figures['usual']:.2f}  ratio {figures['relight'] / figures['usual']:.2f}  {lights}"
            f"  ({len(figures['warnings'])} warnings, {figures['seconds']:.1f} s)",
            flush=True,
        )


def _print_means(found: Sequence[dict[str, Any]]) -> None:
    print(f"\nmean over {len(found)} rooms; ratio: geometric mean (worst)")
    for way in WAYS:
        those = [one["ways"][way] for one in found]
        ratio = np.array([one["relight"] / one["usual"] for one in those])
        print(
            f"  {way:9} map {np.mean([one['map'] for one in those]):.2f}  relight {np.mean([one['relight'] for one in those]):.2f}  "
            f"usual {np.mean([one['usual'] for one in those]):.2f}  ratio {np.exp(np.log(ratio).mean()):.2f} ({ratio.max():.2f})"
        )


if __name__ == "__main__":
    sys.exit(main())
