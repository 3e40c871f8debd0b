"""A rendered scene under the true spectra of a room, under our uplift and under the usual one: mean ΔE2000 of the picture.

`python -m benchmarks relit_render [--size 64x36] [--spp 64] [--rooms room0 …] [--lamps …] [--emitter] [--pictures FOLDER]`

Needs Mitsuba and the folder of spectral rooms that the environment variable ENVCAL_DATA names.

Light goes through a scene linearly in its environment, so the paths are traced once for each room (`paths.py`), and every picture
is made of the same ones, band by band: under the room's own spectra, transport times lamp; under the spectra of the uplift
file, declared by kind and CCT or by the lamp's measured spectrum; and under those of the scaled uplift. Noise is common to
all. With `--emitter` Mitsuba renders ours and the scaled one, too, by the emitter `envcal` and by its own spectral envmap: what
these differ by from the pictures of the paths, in standard errors of the noise, stands at the end of the row.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks import paths
from benchmarks.maps import size
from envcal.errors import EnvcalError
from envcal.reflectances import colour_checker
from uplift.illuminants import FAMILIES, cct_duv_of
from uplift.radiance import spectra_of
from uplift.scaled import uplift_scaled
from uplift.spectrum import Observer, illuminant, normalised, observer, rgb_space, xyz_of

Float64 = npt.NDArray[np.float64]
Float32 = npt.NDArray[np.float32]

ROOMS = ("room0", "room3", "room5")
#: The spectra that the families `led` and `fluorescent` interpolate, and the kind that is declared.
KNOWN = {f"LED-B{k}": "led" for k in range(1, 6)} | {f"FL{k}": "fluorescent" for k in range(1, 7)}
#: Lamps whose spectra the families do not know: by CIE name, or of the folder's led19_measured.csv. FL11 is three-band, and
#: what `fluorescent` declares is halophosphate.
FOREIGN = {
    "CIE S025 LED-PT-119": "led",
    "CIE S025 PhLED_3": "led",
    "FL3.2": "fluorescent",
    "FL11": "fluorescent",
}
LAMPS = KNOWN | FOREIGN
EYES = observer()
SPACE = "ITU-R BT.2020"
WAYS = ("declared", "measured", "scaled")
#: Renders are compared over squares of so many pixels a side.
_BLOCK = 4
_HEADING = f"{'':27} {'ΔE2000 of the picture':^32} | {'of what is lit':^32}"
_COLUMNS = " | ".join(["declared measured scaled    ratio"] * 2)


@dataclass(frozen=True, slots=True)
class Row:
    """ΔE2000 of the pictures of one room under one lamp against the truth, for each of `WAYS`.

    `mean` is that of the whole picture, `lit` leaves the background out, `noise` is what `mean` would lose with endless samples. `emitter` is,
    for declared and scaled, the RMS difference of Mitsuba's own render from the picture, in standard errors; 1 is noise alone.
    """

    room: str
    lamp: str
    kind: str
    clusters: int
    mean: dict[str, float]
    lit: dict[str, float]
    noise: dict[str, float]
    emitter: dict[str, float] = field(default_factory=dict)

    @property
    def known(self) -> bool:
        """Whether the families interpolate this lamp's spectrum."""
        return self.lamp in KNOWN

    def ratio(self, way: str) -> float:
        """Of the whole picture, to the scaled uplift."""
        return self.mean[way] / self.mean["scaled"]


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; return 0, also where there is nothing to measure with."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks relit_render", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--size", type=size, default=(64, 36), help="of the picture (default 64x36)")
    parser.add_argument("--spp", type=int, default=64, help="paths a pixel (default 64)")
    parser.add_argument("--rooms", nargs="+", default=list(ROOMS), help="names of truth/*.npz")
    parser.add_argument("--lamps", nargs="+", default=list(LAMPS), choices=list(LAMPS), metavar="LAMP")
    parser.add_argument("--emitter", action="store_true", help="render with Mitsuba's emitters, too, for comparison")
    parser.add_argument("--pictures", type=Path, help="write the pictures into this folder")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    chosen = parser.parse_args(arguments)
    folder = os.environ.get("ENVCAL_DATA")
    if not folder:
        print("skipped: the environment variable ENVCAL_DATA names no folder of rooms")
        return 0
    try:
        from envcal.mitsuba import set_variant

        set_variant("llvm_ad_rgb")
    except EnvcalError as error:
        print(f"skipped: {error}")
        return 0
    rows = []
    print(f"picture {chosen.size[0]}×{chosen.size[1]}, {chosen.spp} paths a pixel, the same for all; against the truth")
    print(_HEADING)
    print(f"{'':27} {_COLUMNS}" + (" | emitter, envmap: standard errors" if chosen.emitter else ""))
    with tempfile.TemporaryDirectory() as scratch:
        for room in chosen.rooms:
            for row in relit(Path(folder), room, chosen.lamps, Path(scratch), chosen):
                rows.append(row)
                errors = " | " + " ".join(f"{value:.2f}" for value in row.emitter.values()) if row.emitter else ""
                print(f"{row.room:6} {row.lamp:20} {_figures(row.mean)} | {_figures(row.lit)}{errors}", flush=True)
    summary(rows)
    if chosen.json:
        chosen.json.write_text(json.dumps([asdict(row) for row in rows], indent=1), encoding="utf-8")
    return 0


def _figures(values: dict[str, float]) -> str:
    ratio = values["declared"] / values["scaled"] if values["scaled"] > 0 else float("nan")
    return f"{values['declared']:8.3f} {values['measured']:8.3f} {values['scaled']:6.3f} {ratio:8.3f}"


def summary(rows: list[Row]) -> None:
    """Print the ratios to the scaled uplift by kind, the lamps that the families know apart from the others."""
    print()
    for known, which in ((True, "lamps of the families' tables"), (False, "foreign lamps")):
        for kind in sorted({row.kind for row in rows if row.known == known}):
            of_kind = [row for row in rows if row.known == known and row.kind == kind]
            parts = []
            for way in WAYS[:2]:
                each = [row.ratio(way) for row in of_kind]
                mean = sum(row.mean[way] for row in of_kind) / sum(row.mean["scaled"] for row in of_kind)
                parts.append(f"{way} : scaled = {mean:.3f} ({min(each):.3f} … {max(each):.3f})")
            print(f"{which}, {kind}: {'; '.join(parts)}")
    if rows:
        print(f"noise in a mean ΔE2000: at most {max(max(row.noise.values()) for row in rows):.3f}")


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


def transport_of(folder: Path, room: str) -> Float32:
    """Return the room's transport [H, W, N] on our grid, all of its lamps lit alike."""
    with np.load(folder / "truth" / f"{room}.npz") as data:
        transport, grid = data["transport"].astype(np.float32).sum(axis=0), data["wavelengths"]
    to_grid = np.stack([np.interp(EYES.wavelengths_nm, grid, row) for row in np.eye(grid.size)])
    return np.asarray(transport @ to_grid.astype(np.float32), np.float32)


def relit(folder: Path, room: str, lamps: list[str], scratch: Path, chosen: Any) -> list[Row]:
    """Measure one room under every lamp."""
    from envcal.mitsuba import set_variant
    from envcal.scene import pictures

    scene = scratch / "scene.xml"
    transport = transport_of(folder, room)
    set_variant("llvm_ad_rgb")
    traced, lit = trace(scene, transport, chosen)
    set_variant("llvm_ad_spectral")
    srgb, wide = rgb_space("sRGB"), rgb_space(SPACE)
    patches = np.stack(list(colour_checker(EYES.wavelengths_nm).values()))
    seen = traced.pictures(transport, patches)
    rows = []
    for name in lamps:
        emission, kind = lamp(name, folder, EYES), LAMPS[name]
        true_map = xyz_of(transport * emission, EYES)
        rgb = (true_map @ wide.rgb_from_xyz.T).astype(np.float32)
        narrow = np.maximum(true_map @ srgb.rgb_from_xyz.T, 0.0).astype(np.float32)
        groups = {"truth": xyz_of(seen * emission, EYES) @ srgb.rgb_from_xyz.T}
        radiance, clusters = {"scaled": scaled_spectra(narrow)}, 0
        for way in ("measured", "declared"):
            clusters = write_uplift(scratch / "uplift.exr", rgb, kind, emission, measured=way == "measured")
            radiance[way] = spectra_in(scratch / "uplift.exr")
        for way in WAYS:
            groups[way] = xyz_of(traced.pictures(radiance[way], patches), EYES) @ srgb.rgb_from_xyz.T
        emitter = {}
        if chosen.emitter:
            for way, lighting in (("declared", "uplift"), ("scaled", "scaled")):
                rendered = by_emitter(scene, lighting, narrow, chosen)
                emitter[way] = standard_errors(groups[way], rendered)
        found_truth = as_rendered(groups["truth"])
        gain = pictures.gain_of(found_truth.image)
        found = {way: pictures.compare(found_truth, as_rendered(groups[way]), gain=gain) for way in WAYS}
        rows.append(
            Row(
                room,
                name,
                kind,
                clusters,
                {way: found[way].mean for way in WAYS},
                {way: float(found[way].delta_e[lit].mean()) for way in WAYS},
                {way: found[way].noise for way in WAYS},
                emitter,
            )
        )
        if chosen.pictures:
            write_pictures(chosen.pictures / f"{room}_{name.replace(' ', '_')}.png", groups, found, gain)
    return rows


def trace(scene_file: Path, transport: Float32, chosen: Any) -> tuple[paths.Paths, npt.NDArray[np.bool_]]:
    """Write the scene, return its paths in a room of `transport` [H, W, N], and where there is no background."""
    import mitsuba as mi

    from envcal import exr
    from envcal.scene import description
    from envcal.scene.make import native_rows

    width, height = chosen.size
    text = description.scene_xml(width=width, height=height, spp=16)
    # Paths fall on a pixel or on another, so the film is a plain one in Mitsuba's renders, too.
    for old, new in (("multijitter", "independent"), ("gaussian", "box")):
        assert old in text, old
        text = text.replace(old, new)
    scene_file.write_text(text, encoding="utf-8")
    grey = paths.guide(transport, EYES.cmfs[:, 1])
    exr.write(scene_file.with_name("guide.exr"), exr.rgb_planes(native_rows(grey)), attributes={})
    scene_file.with_name("guide.xml").write_text(description.scaled_xml("guide.exr"), encoding="utf-8")
    mi.set_log_level(mi.LogLevel.Error)  # that cyan is outside of sRGB is no matter: its bands are put in its place
    scene = mi.load_file(str(scene_file), lighting="guide")
    traced = paths.record(scene, shape=transport.shape[:2], size=chosen.size, spp=chosen.spp)
    depth = mi.load_dict({"type": "aov", "aovs": "depth:depth"})
    lit = np.asarray(mi.render(scene, integrator=depth, spp=16))[..., 0] > 0
    return traced, lit


def scaled_spectra(rgb: Float32) -> Float32:
    """Return the spectra [H, W, N] of the scaled uplift of linear sRGB, as Mitsuba's envmap makes them."""
    done = uplift_scaled(rgb, observer=EYES, space=rgb_space("sRGB"))
    parts = (done.coefficients, done.scale, done.emission, done.emissions, EYES.wavelengths_nm)
    return np.asarray(spectra_of(*parts, observer=EYES, dtype=np.float32))


def spectra_in(path: Path) -> Float32:
    """Return the spectra [H, W, N] that an uplift file stands for."""
    from envcal import exr
    from envcal.uplift_file import Radiance, read_any_about

    header, about = read_any_about(path)
    radiance = Radiance(path, about, EYES.wavelengths_nm)
    return np.concatenate([radiance(planes) for _, planes in exr.bands(path, radiance.channels, rows=header.size[0])])


def by_emitter(scene_file: Path, lighting: str, rgb: Float32, chosen: Any) -> Float64:
    """Return Mitsuba's own pictures [GROUPS, h, w, 3] of the map in uplift.exr, or of `rgb` as its spectral envmap has it."""
    import mitsuba as mi

    from envcal import exr
    from envcal.scene import description
    from envcal.scene.make import native_rows

    if lighting == "scaled":
        exr.write(scene_file.with_name("scaled.exr"), exr.rgb_planes(native_rows(rgb)), attributes={})
    make = description.scaled_xml if lighting == "scaled" else description.uplift_xml
    scene_file.with_name(f"{lighting}.xml").write_text(make(f"{lighting}.exr"), encoding="utf-8")
    scene = mi.load_file(str(scene_file), lighting=lighting)
    each = max(1, chosen.spp // paths.GROUPS)
    return np.stack([np.asarray(mi.render(scene, spp=each, seed=7000 + k), np.float64) for k in range(paths.GROUPS)])


def standard_errors(first: Float64, second: Float64) -> float:
    """Return the RMS difference of two pictures, means over groups [GROUPS, h, w, 3], in standard errors of squares.

    With eight groups on both sides noise alone gives √(14/12) = 1.08 and a little more where it has long tails.
    """
    means, variance = [], []
    for groups in (first, second):
        count, height, width, _ = groups.shape
        cut = groups[:, : height // _BLOCK * _BLOCK, : width // _BLOCK * _BLOCK]
        squares = cut.reshape(count, height // _BLOCK, _BLOCK, width // _BLOCK, _BLOCK, 3).mean(axis=(2, 4))
        means.append(squares.mean(axis=0))
        variance.append(squares.var(axis=0, ddof=1) / count)
    return float(np.sqrt(((means[0] - means[1]) ** 2 / (variance[0] + variance[1])).mean()))


def as_rendered(groups: Float64) -> Any:
    """Return the mean of groups [GROUPS, h, w, 3] and those of even and odd ones."""
    from envcal.scene.render import Rendered

    return Rendered(*(part.mean(axis=0).astype(np.float32) for part in (groups, groups[::2], groups[1::2])))


def write_uplift(out: Path, rgb: Float32, kind: str, emission: Float64, *, measured: bool) -> int:
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
        family = FAMILIES[kind]  # FL1 is three kelvin beyond where the family ends
        what = {"type": kind, "cct": round(float(np.clip(cct_duv_of(emission, EYES)[0], family.low_k, family.high_k)))}
    everywhere = [DeclaredLight.model_validate({"at": light["at"], **what}) for light in search([])]
    lights_found = search(everywhere)
    uplift(found, clusters, out, UpliftSettings())
    return len(lights_found)


def write_pictures(out: Path, groups: dict[str, Float64], found: dict[str, Any], gain: float) -> None:
    """Write the truth, ours and the scaled picture above, their ΔE2000 below, on one scale, enlarged."""
    import cv2

    from envcal.scene import pictures

    worst = max(found.values(), key=lambda one: float(np.percentile(one.delta_e, 99)))
    end = pictures.scale_end(worst)
    images = {way: as_rendered(groups[way]).image for way in ("truth", *WAYS)}
    top = [pictures.shown(image, gain=gain) for image in images.values()]
    bottom = [np.full_like(top[0], 21), *(pictures.field(found[way].delta_e, end) for way in WAYS)]
    sheet = np.concatenate([np.concatenate(top, axis=1), np.concatenate(bottom, axis=1)], axis=0)
    out.parent.mkdir(parents=True, exist_ok=True)
    pictures.write_png(out, cv2.resize(sheet, None, fx=3, fy=3, interpolation=cv2.INTER_NEAREST))


if __name__ == "__main__":
    start = time.perf_counter()
    code = main()
    print(f"{time.perf_counter() - start:.0f} s", file=sys.stderr)
    sys.exit(code)
