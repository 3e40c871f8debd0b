"""The emitter against Mitsuba's own environment map, in one run: time, noise, start-up, and whose radiance is right.

`python -m benchmarks render [--size 4096x2048] [--spp 64]`
"""

from __future__ import annotations

import argparse
import gc
import json
import tempfile
import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.maps import lit_map, size
from envcal import exr
from envcal.errors import EnvcalError
from envcal.uplift_file import ATTRIBUTE, CHANNELS, About, Emission
from uplift.illuminants import family_emission
from uplift.pixels import uplift_pixels
from uplift.spectrum import illuminant, observer, rgb_space
from uplift.table import build_table

VARIANT = "llvm_ad_spectral"
_SRGB_OF_2020 = np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]])
_WIDTH = 256
_NOISE_SPP = 16
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; return 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks render", description=__doc__)
    parser.add_argument("--size", type=size, default=(4096, 2048), help="of the map (default 4096x2048)")
    parser.add_argument("--spp", type=int, default=64, help="samples a pixel of the timed pictures")
    parser.add_argument("--repeat", type=int, default=5, help="rounds; the fastest counts")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    chosen = parser.parse_args(arguments)
    try:
        import envcal.mitsuba

        envcal.mitsuba.set_variant(VARIANT)
    except EnvcalError as error:
        print(f"skipped: {error}")
        figures: dict[str, Any] = {"skipped": [str(error)]}
    else:
        figures = measure(*chosen.size, spp=chosen.spp, repeat=chosen.repeat)
    if chosen.json:
        chosen.json.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    return 0


def measure(width: int, height: int, *, spp: int, repeat: int) -> dict[str, Any]:
    """Print and return the figures of a map of this size."""
    with tempfile.TemporaryDirectory() as folder:
        ours, theirs = _write_maps(Path(folder), width, height)
        kinds = {
            "envcal": {"type": "envcal", "filename": str(ours)},
            "envmap": {"type": "envmap", "filename": str(theirs)},
        }
        print(f"{width}×{height} map, {VARIANT}, {_WIDTH}×{_WIDTH} pixels, {spp} samples a pixel\n")
        figures = {"start_up_s": _start_up(kinds, repeat), **_pictures(kinds, spp=spp, repeat=repeat)}
    figures |= {"furnace": _furnace(), "constant": _against_constant(spp), "sun_and_sky": _sun_and_sky()}
    return figures


def _write_maps(folder: Path, width: int, height: int) -> tuple[Path, Path]:
    """Write the same lit map as uplift file and as the RGB that Mitsuba's `envmap` reads; return both paths."""
    mi: Any = import_module("mitsuba")

    eyes, space = observer(), rgb_space("ITU-R BT.2020")
    emissions = [illuminant("D65", eyes), illuminant("LED-B3", eyes), family_emission("incandescent", 2856, eyes)]
    rgb, cluster = lit_map(width, height, emissions, observer=eyes, space=space)
    sun = max(1, width // 512)
    rgb[height // 4 : height // 4 + sun, width // 6 : width // 6 + sun] = 2e4
    found = uplift_pixels(rgb, cluster, [build_table(light, observer=eyes, space=space) for light in emissions])
    planes = {f"c{k}": np.ascontiguousarray(found.coefficients[..., k], np.float32) for k in range(3)}
    planes |= exr.rgb_planes(rgb)
    integers = {"cluster": found.emission, "status": found.status}
    whole: dict[str, Any] = planes | {"scale": found.scale.astype(np.float32)}
    whole |= {name: np.ascontiguousarray(plane, np.uint32) for name, plane in integers.items()}
    lights = [
        {"type": "measured", "cct": None, "duv": None, "source": "benchmark", "confidence": 1.0, "emission": e.tolist()}
        for e in found.emissions
    ]
    about = About(
        method="constrained",
        space=space.name,
        observer=eyes.name,
        wavelengths_nm=eyes.wavelengths_nm.tolist(),
        clusters=[Emission.model_validate(light) for light in lights],
        status={},
    )
    chromaticities = (*space.primaries_xy.ravel().tolist(), *space.white_xy.tolist())
    ours, theirs = folder / "uplift.exr", folder / "rgb.exr"
    attributes = {ATTRIBUTE: about.model_dump(mode="json"), "chromaticities": chromaticities, "envmap": True}
    exr.write(ours, {name: whole[name] for name in CHANNELS}, attributes=attributes)
    srgb = np.maximum(rgb @ _SRGB_OF_2020.T.astype(np.float32), 0)
    mi.Bitmap(np.ascontiguousarray(srgb, np.float32)).write(str(theirs))
    return ours, theirs


def _start_up(kinds: dict[str, dict[str, Any]], repeat: int) -> dict[str, float]:
    """Return the CPU seconds of loading each, sampling tables included."""
    mi: Any = import_module("mitsuba")

    def loaded(what: dict[str, Any]) -> None:
        mi.load_dict(what)
        gc.collect()

    for what in kinds.values():
        loaded(what)  # compiles, and warms the disk's cache
    seconds = {name: min(_cpu(partial(loaded, what)) for _ in range(min(repeat, 3))) for name, what in kinds.items()}
    _compare("start-up", "s", seconds)
    return seconds


def _cpu(run: Callable[[], Any]) -> float:
    start = time.process_time()
    run()
    return time.process_time() - start


def _compare(name: str, unit: str, values: dict[str, float]) -> None:
    ours, theirs = values["envcal"], values["envmap"]
    print(f"{name:34} envcal {ours:.4g} {unit}, envmap {theirs:.4g} {unit}, ratio {ours / theirs:.3f}")


def _scene(light: Any, depth: int) -> Any:
    """A grey and a mirror ball on a floor; with depth 1 the map alone is seen."""
    mi: Any = import_module("mitsuba")

    turn = mi.ScalarTransform4f
    film = {"type": "hdrfilm", "width": _WIDTH, "height": _WIDTH, "rfilter": {"type": "box"}}
    look = turn().look_at([0, 1.5, 5], [0, 0, 0], [0, 1, 0])
    grey = {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.5}}
    return mi.load_dict(
        {
            "type": "scene",
            "light": light,
            "integrator": {"type": "path", "max_depth": depth},
            "sensor": {"type": "perspective", "fov": 60, "to_world": look, "film": film},
            "grey": {"type": "sphere", "center": [-1.1, 0, 0], "bsdf": grey},
            "mirror": {"type": "sphere", "center": [1.1, 0, 0], "bsdf": {"type": "conductor"}},
            "floor": {"type": "rectangle", "to_world": turn().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(4)},
        }
    )


def _render(scene: Any, spp: int, seed: int) -> npt.NDArray[np.float64]:
    mi: Any = import_module("mitsuba")

    return np.array(mi.render(scene, spp=spp, seed=seed), np.float64)


def _noise_scene(light: Any) -> Any:
    """A grey ball on a floor that fills the picture, so that all noise is that of lighting grey things."""
    mi: Any = import_module("mitsuba")
    film = {"type": "hdrfilm", "width": _WIDTH, "height": _WIDTH, "rfilter": {"type": "box"}}
    look = mi.ScalarTransform4f().look_at([0, 6, 3], [0, 0, 0], [0, 1, 0])
    floor = mi.ScalarTransform4f().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(20)
    grey = {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.5}}
    return mi.load_dict(
        {
            "type": "scene",
            "light": light,
            "integrator": {"type": "path", "max_depth": 4},
            "sensor": {"type": "perspective", "fov": 40, "to_world": look, "film": film},
            "ball": {"type": "sphere", "bsdf": grey},
            "floor": {"type": "rectangle", "to_world": floor, "bsdf": grey},
        }
    )


def _pictures(kinds: dict[str, dict[str, Any]], *, spp: int, repeat: int) -> dict[str, Any]:
    """Return the CPU seconds a picture and the variance a sample of each emitter.

    Only one stands in memory at a time, for the renderer compiles code for every emitter there is.
    """
    mi: Any = import_module("mitsuba")
    seconds: dict[str, list[list[float]]] = {name: [[], []] for name in kinds}
    luminances: dict[str, list[npt.NDArray[np.float64]]] = {name: [] for name in kinds}
    for turn in range(2):
        for name, what in kinds.items():
            light = mi.load_dict(what)
            for which, depth in enumerate((1, 4)):
                scene = _scene(light, depth)
                _render(scene, spp, 0)
                for k in range(repeat):
                    start = time.process_time()
                    _render(scene, spp, 1 + k)
                    seconds[name][which].append(time.process_time() - start)
                del scene
            scene = _noise_scene(light)
            for k in range(2 * repeat):
                image = _render(scene, _NOISE_SPP, turn * 2 * repeat + k)
                luminances[name].append(image @ _LUMINANCE)
            del scene, light
            gc.collect()
    seen = {name: min(times[0]) for name, times in seconds.items()}
    traced = {name: min(times[1]) for name, times in seconds.items()}
    noise = {
        name: float(np.mean(np.var(images, axis=0, ddof=1) / np.mean(images, axis=0) ** 2)) * _NOISE_SPP
        for name, images in luminances.items()
    }
    _compare("time, map alone", "s", seen)
    _compare("time, path tracing", "s", traced)
    _compare("relative variance a sample", "", noise)
    return {"map_alone_s": seen, "path_tracing_s": traced, "variance": noise}


def _flat_emitter(emission: npt.NDArray[np.float64]) -> Any:
    from envcal.mitsuba import emitter_from
    from envcal.mitsuba.loading import SpectralMap

    shape, grid = (32, 64), observer().wavelengths_nm
    return emitter_from(
        SpectralMap.from_arrays(
            np.zeros((*shape, 3)), np.full(shape, 2.0), wavelengths_nm=grid, emissions=emission[None]
        )
    )


def _furnace() -> float:
    """Return the largest relative error of a constant map's radiance, over random directions and wavelengths."""
    dr: Any = import_module("drjit")
    mi: Any = import_module("mitsuba")

    rng, many = np.random.default_rng(0), 1 << 20
    directions = rng.normal(size=(3, many))
    si = dr.zeros(mi.SurfaceInteraction3f, many)
    si.wi = mi.Vector3f((directions / np.linalg.norm(directions, axis=0)).astype(np.float32))
    si.wavelengths = mi.Spectrum(rng.uniform(381, 779, (4, many)).astype(np.float32))
    level = 1 / 106.8
    found = np.array(_flat_emitter(np.full(81, level)).eval(si), np.float64)
    worst = float(np.abs(found * mi.MI_CIE_Y_NORMALIZATION / level - 1).max())
    print(f"{'furnace':34} largest error {worst:.1e}")
    return worst


def _against_constant(spp: int) -> dict[str, float]:
    """Return how many standard errors the mean picture under a flat map is from that under Mitsuba's `constant`."""
    mi: Any = import_module("mitsuba")

    eyes = observer()
    emission = illuminant("LED-B3", eyes)
    values = ", ".join(str(v) for v in emission / mi.MI_CIE_Y_NORMALIZATION)
    grid = {"wavelength_min": float(eyes.wavelengths_nm[0]), "wavelength_max": float(eyes.wavelengths_nm[-1])}
    native = mi.load_dict({"type": "constant", "radiance": {"type": "regular", "values": values, **grid}})
    means = []
    for light in (_flat_emitter(emission), native):
        runs = np.array([_render(_scene(light, 4), spp, k).mean((0, 1)) for k in range(8)])
        means.append((runs.mean(0), runs.std(0, ddof=1) / np.sqrt(len(runs))))
    (ours, error), (theirs, their_error) = means
    apart = float(np.max(np.abs(ours - theirs) / np.hypot(error, their_error)))
    relative = float(np.max(np.hypot(error, their_error) / theirs))
    print(f"{'against `constant`':34} {apart:.2f} standard errors apart (one is {relative:.1e} of the mean)")
    return {"standard_errors": apart, "relative_standard_error": relative}


def _sun_and_sky() -> dict[str, Any]:
    """Return the radiance half-way between a sun and a sky texel, over its true value, from 400 to 700 nm."""
    dr: Any = import_module("drjit")
    mi: Any = import_module("mitsuba")

    from envcal.mitsuba import emitter_from
    from envcal.mitsuba.loading import SpectralMap

    # The same two colours for both: a sun of 5000 K a hundred times as bright as a sky of 12 000 K.
    eyes, space = observer(), rgb_space("sRGB")
    sun, sky = (family_emission("daylight", k, eyes) for k in (5000.0, 12000.0))
    white = illuminant("D65", eyes)
    colour = [space.rgb_from_xyz @ (eyes.cmfs.T @ light * eyes.step_nm) for light in (sun, sky)]
    rgb = np.empty((16, 32, 3), np.float32)
    rgb[:, :16], rgb[:, 16:] = 100 * colour[0], colour[1]
    found = uplift_pixels(rgb, np.zeros((16, 32), np.uint32), [build_table(white, observer=eyes, space=space)])
    spectral = SpectralMap.from_arrays(
        found.coefficients, found.scale, found.emission, wavelengths_nm=eyes.wavelengths_nm, emissions=found.emissions
    )
    wavelengths = np.linspace(400, 700, 61)
    out: dict[str, Any] = {}
    for name, light in (
        ("envcal", emitter_from(spectral)),
        ("envmap", mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(rgb)})),
    ):
        values = []
        for u in (15.5 / 32, 16 / 32, 16.5 / 32):
            phi = 2 * np.pi * u
            si = dr.zeros(mi.SurfaceInteraction3f, len(wavelengths))
            si.wi = mi.Vector3f(-float(np.sin(phi)), 0.0, float(np.cos(phi)))
            si.wavelengths = mi.Spectrum(mi.Float(wavelengths.astype(np.float32)))
            values.append(np.array(light.eval(si), np.float64)[0])
        ratio = values[1] / ((values[0] + values[2]) / 2)
        out[name] = {"lowest": float(ratio.min()), "highest": float(ratio.max()), "at_400": float(ratio[0])}
        print(
            f"{'half-way between sun and sky':34} {name}: ×{ratio.min():.4f} to ×{ratio.max():.4f} of the mean of both"
        )
    return out
