"""A rendered scene under the true spectra of a room, under our uplift and under the usual one: mean ΔE2000 of the picture.

`python -m benchmarks relit_render [--size 96x54] [--spp 1024] [--rooms room0 …] [--lamps …] [--pictures FOLDER]`

Needs Mitsuba and the folder of spectral rooms that the environment variable ENVCAL_DATA names.

The truth is a render in bands that no uplift touches: the room's transport is a map of 81 bands, rendered three at a time by
an RGB variant, whose channels are plain numbers; times the lamp's spectrum and the observer they give the picture. Ours is
rendered with the emitter `envcal`, the other with Mitsuba's own spectral envmap of the same RGB.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.maps import size
from envcal.errors import EnvcalError
from envcal.reflectances import colour_checker
from uplift.illuminants import cct_duv_of
from uplift.spectrum import Observer, illuminant, normalised, observer, rgb_space, xyz_of

Float64 = npt.NDArray[np.float64]

ROOMS = ("room0", "room3", "room5")
#: The kind that is declared, and the lamp: of the CIE by name, or of the folder's led19_measured.csv. None of the second
#: kind, and no FL3.x, is among the spectra that the families interpolate; LED-B3 and FL2 are.
LAMPS = {
    "LED-B3": "led",
    "CIE S025 LED-PT-119": "led",
    "CIE S025 PhLED_3": "led",
    "FL2": "fluorescent",
    "FL3.2": "fluorescent",
    "FL11": "fluorescent",
}
EYES = observer()
SPACE = "ITU-R BT.2020"


WAYS = ("declared", "measured", "scaled")


@dataclass(frozen=True, slots=True)
class Row:
    """ΔE2000 of the pictures of one room under one lamp against the truth, for each of `WAYS`.

    `mean` is that of the whole picture, `lit` leaves the background out, `noise` is the part of `mean` that is noise.
    """

    room: str
    lamp: str
    kind: str
    clusters: int
    mean: dict[str, float]
    lit: dict[str, float]
    noise: dict[str, float]

    @property
    def ratio(self) -> float:
        """Declared kind and CCT to the scaled uplift, noise and all."""
        return self.mean["declared"] / self.mean["scaled"]

    def without_noise(self, way: str) -> float:
        """The mean that is left when the noise is taken off in squares."""
        return float(np.sqrt(max(self.mean[way] ** 2 - self.noise[way] ** 2, 0.0)))


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; return 0, also where there is nothing to measure with."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks relit_render", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--size", type=size, default=(96, 54), help="of the picture (default 96x54)")
    parser.add_argument("--spp", type=int, default=1024, help="samples a pixel (default 1024)")
    parser.add_argument("--rooms", nargs="+", default=list(ROOMS), help="names of truth/*.npz")
    parser.add_argument("--lamps", nargs="+", default=list(LAMPS), choices=list(LAMPS), metavar="LAMP")
    parser.add_argument("--pictures", type=Path, help="write the pictures into this folder")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    chosen = parser.parse_args(arguments)
    folder = os.environ.get("ENVCAL_DATA")
    if not folder:
        print("skipped: the environment variable ENVCAL_DATA names no folder of rooms")
        return 0
    try:
        from envcal.scene.render import mitsuba

        mitsuba()
    except EnvcalError as error:
        print(f"skipped: {error}")
        return 0
    rows = []
    print(
        f"picture {chosen.size[0]}×{chosen.size[1]}, {chosen.spp} samples a pixel; ΔE2000 against the render of the truth"
    )
    print("the mean of the whole picture | of what is lit in it | of the whole, noise taken off in squares")
    print(f"{'':28}{' | '.join(['declared measured scaled ratio'] * 3)}")
    with tempfile.TemporaryDirectory() as scratch:
        for room in chosen.rooms:
            for row in relit(Path(folder), room, chosen.lamps, Path(scratch), chosen):
                rows.append(row)
                clean = {way: row.without_noise(way) for way in WAYS}
                parts = " | ".join(_figures(values) for values in (row.mean, row.lit, clean))
                print(f"{row.room:6} {row.lamp:20} {parts}", flush=True)
    for kind in sorted({row.kind for row in rows}):
        of_kind = [row for row in rows if row.kind == kind]
        total = {way: sum(row.mean[way] for row in of_kind) for way in WAYS}
        each = ", ".join(f"{row.ratio:.2f}" for row in of_kind)
        print(
            f"ratio {kind}, declared : scaled = {total['declared'] / total['scaled']:.2f} (each {each}); "
            f"measured : scaled = {total['measured'] / total['scaled']:.2f}"
        )
    if chosen.json:
        chosen.json.write_text(json.dumps([asdict(row) for row in rows], indent=1), encoding="utf-8")
    return 0


def _figures(values: dict[str, float]) -> str:
    ratio = values["declared"] / values["scaled"] if values["scaled"] > 0 else float("nan")
    return f"{values['declared']:8.3f} {values['measured']:8.3f} {values['scaled']:6.3f} {ratio:5.2f}"


def lamp(name: str, folder: Path, eyes: Observer) -> Float64:
    """Return the emission [N], Y = 1, of one of `LAMPS`."""
    if name.startswith(("LED-", "FL")):
        return illuminant(name, eyes)
    with (folder / "led19_measured.csv").open(encoding="utf-8", newline="") as handle:
        rows = list(csv.DictReader(handle))
    row = next(row for row in rows if row["name"] == name)
    grid = [float(key) for key in row if key and key.isdigit()]
    values = [float(row[key]) for key in row if key and key.isdigit()]
    return normalised(np.interp(eyes.wavelengths_nm, grid, values), eyes)


def transport_of(folder: Path, room: str) -> npt.NDArray[np.float32]:
    """Return the room's transport [H, W, N] on our grid, all of its lamps lit alike."""
    with np.load(folder / "truth" / f"{room}.npz") as data:
        transport, grid = data["transport"].astype(np.float32).sum(axis=0), data["wavelengths"]
    to_grid = np.stack([np.interp(EYES.wavelengths_nm, grid, row) for row in np.eye(grid.size)])
    return np.asarray(transport @ to_grid.astype(np.float32), np.float32)


def relit(folder: Path, room: str, lamps: list[str], scratch: Path, chosen: Any) -> list[Row]:
    """Measure one room under every lamp."""
    import mitsuba as mi

    from envcal import exr
    from envcal.scene import description, pictures
    from envcal.scene.make import native_rows
    from envcal.scene.render import Rendered, render

    scene = scratch / "scene.xml"
    scene.write_text(
        description.scene_xml(width=chosen.size[0], height=chosen.size[1], spp=16).replace(
            "multijitter", "independent"
        ),
        encoding="utf-8",
    )
    transport = transport_of(folder, room)
    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)  # that cyan is outside of sRGB is no matter: its bands are put in its place
    bands, lit = render_bands(scene, transport, scratch, chosen)
    mi.set_variant("llvm_ad_spectral")
    srgb, wide = rgb_space("sRGB"), rgb_space(SPACE)
    rows = []
    for name in lamps:
        emission = lamp(name, folder, EYES)
        true_map = xyz_of(transport * emission, EYES)
        truth = Rendered(*((xyz_of(part * emission, EYES) @ srgb.rgb_from_xyz.T).astype(np.float32) for part in bands))
        gain = pictures.gain_of(truth.image)
        rgb = (true_map @ wide.rgb_from_xyz.T).astype(np.float32)
        exr.write(
            scratch / "scaled.exr",
            exr.rgb_planes(native_rows(np.maximum(true_map @ srgb.rgb_from_xyz.T, 0.0).astype(np.float32))),
            attributes={},
        )
        (scratch / "scaled.xml").write_text(description.scaled_xml("scaled.exr"), encoding="utf-8")
        renders = {"scaled": render(scene, {"lighting": "scaled"}, size=chosen.size, spp=chosen.spp, tame=False)}
        clusters = 0
        for how in ("declared", "measured"):
            clusters = write_uplift(scratch / "uplift.exr", rgb, LAMPS[name], emission, measured=how == "measured")
            (scratch / "uplift.xml").write_text(description.uplift_xml("uplift.exr"), encoding="utf-8")
            renders[how] = render(scene, {"lighting": "uplift"}, size=chosen.size, spp=chosen.spp, tame=False)
        found = {how: pictures.compare(truth, picture, gain=gain) for how, picture in renders.items()}
        rows.append(
            Row(
                room,
                name,
                LAMPS[name],
                clusters,
                {how: found[how].mean for how in WAYS},
                {how: float(found[how].delta_e[lit].mean()) for how in WAYS},
                {how: found[how].noise for how in WAYS},
            )
        )
        if chosen.pictures:
            write_pictures(chosen.pictures / f"{room}_{name.replace(' ', '_')}.png", truth, renders, found, gain)
    return rows


def render_bands(
    scene_file: Path, transport: npt.NDArray[np.float32], scratch: Path, chosen: Any
) -> tuple[tuple[Float64, Float64, Float64], npt.NDArray[np.bool_]]:
    """Return the picture's transport [h, w, N] (whole, even and odd passes), and where there is no background.

    An RGB variant multiplies channels and nothing else, so three bands go through it at a time: as the three channels of
    the map and of every reflectance. It shares no code with the spectral emitters.
    """
    import mitsuba as mi

    from envcal import exr
    from envcal.scene import description
    from envcal.scene.make import native_rows

    width, height = chosen.size
    count = transport.shape[-1]
    patches = np.stack(list(colour_checker(EYES.wavelengths_nm).values()))
    exr.write(scratch / "bands.exr", exr.rgb_planes(native_rows(transport[..., :3])), attributes={})
    (scratch / "bands.xml").write_text(description.scaled_xml("bands.exr"), encoding="utf-8")
    scene = mi.load_file(str(scene_file), lighting="bands", width=str(width), height=str(height))
    params = mi.traverse(scene)
    (data_key,) = (key for key in params.properties if key.endswith("data"))
    values = [f"patch_{k + 1:02d}.bsdf.reflectance.value" for k in range(24)]
    channels = params[data_key].shape[2]
    halves = np.zeros((2, height, width, count))
    passes = max(2, 2 * (-(-width * height * chosen.spp // (1 << 23))))
    for first in range(0, count, 3):
        picked = np.minimum(np.arange(first, first + 3), count - 1)
        rows = native_rows(np.ascontiguousarray(transport[..., picked]))
        data = np.ones((rows.shape[0], rows.shape[1] + 2, channels), np.float32)
        data[..., :3] = np.concatenate([rows[:, -1:], rows, rows[:, :1]], axis=1)
        params[data_key] = mi.TensorXf(data)
        for key, patch in zip(values, patches, strict=True):
            params[key] = mi.Color3f(*(float(v) for v in patch[picked]))
        params.update()
        for k in range(passes):
            image = np.asarray(mi.render(scene, spp=max(1, chosen.spp // passes), seed=1000 + first * passes + k))
            halves[k % 2][..., picked] += image / (passes / 2)
    depth = mi.load_dict({"type": "aov", "aovs": "depth:depth"})
    lit = np.asarray(mi.render(scene, integrator=depth, spp=16))[..., 0] > 0
    return (halves.mean(axis=0), halves[0], halves[1]), lit


def write_uplift(out: Path, rgb: npt.NDArray[np.float32], kind: str, emission: Float64, *, measured: bool) -> int:
    """Find the lights of a map, declare every one of them, and write its uplift file; return how many there are."""
    from envcal import exr, provenance
    from envcal.config import ClusterSettings, DeclaredLight, UpliftSettings
    from envcal.maps import read_map
    from envcal.steps.cluster import cluster
    from envcal.steps.uplift import uplift

    source = out.with_name("map.exr")
    attributes = {**provenance.colour_space(SPACE), "envmap": True}
    exr.write(source, exr.rgb_planes(rgb), attributes=attributes)
    found = read_map(source)
    clusters, lights = out.with_name("clusters.exr"), out.with_name("lights.json")
    settings = ClusterSettings.model_validate({"indoor": kind})

    def search(declared: list[DeclaredLight]) -> list[dict[str, Any]]:
        outcome = cluster(
            found, clusters, lights, settings, declared=declared, wavelengths="380:780:5", observer_name=EYES.name
        )
        return list(outcome.figures["lights"])

    if measured:
        table = out.with_name("lamp.csv")
        table.write_text(
            "".join(f"{w:g},{v:.9g}\n" for w, v in zip(EYES.wavelengths_nm, emission, strict=True)), encoding="utf-8"
        )
        what: dict[str, Any] = {"spd": table}
    else:
        what = {"type": kind, "cct": round(cct_duv_of(emission, EYES)[0])}
    everywhere = [DeclaredLight.model_validate({"at": light["at"], **what}) for light in search([])]
    lights_found = search(everywhere)
    uplift(found, clusters, out, UpliftSettings())
    return len(lights_found)


def write_pictures(out: Path, truth: Any, renders: dict[str, Any], found: dict[str, Any], gain: float) -> None:
    """Write the truth, ours and the scaled render above, their ΔE2000 below, on one scale, enlarged."""
    import cv2

    from envcal.scene import pictures

    worst = max(found.values(), key=lambda one: float(np.percentile(one.delta_e, 99)))
    end = pictures.scale_end(worst)
    top, bottom = [pictures.shown(truth.image, gain=gain)], [np.full((*truth.image.shape[:2], 3), 21, np.uint8)]
    for how in WAYS:
        top.append(pictures.shown(renders[how].image, gain=gain))
        bottom.append(pictures.field(found[how].delta_e, end))
    sheet = np.concatenate([np.concatenate(top, axis=1), np.concatenate(bottom, axis=1)], axis=0)
    out.parent.mkdir(parents=True, exist_ok=True)
    pictures.write_png(out, cv2.resize(sheet, None, fx=3, fy=3, interpolation=cv2.INTER_NEAREST))


if __name__ == "__main__":
    start = time.perf_counter()
    code = main()
    print(f"{time.perf_counter() - start:.0f} s", file=sys.stderr)
    sys.exit(code)
