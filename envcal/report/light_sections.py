"""The map's half of the page: the map, its lights, their spectra, the uplift and the spectral image."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from envcal import exr, lights_file, spectral_exr, uplift_file
from envcal.config import LIGHT_TYPES, parse_wavelengths
from envcal.errors import EnvcalError
from envcal.provenance import CAMERA_RGB
from envcal.report import plots, previews
from envcal.unit import unit_of

LONGEST_MAP = 1600
#: What is near a light's brightest region, in heights of the map.
_NEAR = 0.02
#: Below this a light's spectrum is a guess that a person should look at.
LOW_CONFIDENCE = 0.5
_EXACT, _FALLBACK = 0, 2
_STATUS = ("exact", "black", "fallback", "closest", "missing")
_FIRST_NOTABLE = 2
_STATUS_COLOURS = ("#4a4a4a", "#000000", "#0072b2", "#e69f00", "#ff00c8")
_STATUS_MEANING = (
    "the pixel's colour, under its light",
    "no radiance",
    "the pixel's colour, but under D65: its own light cannot show it",
    "a colour no light can show, moved to the closest that one can",
    "clipped in every frame: no radiance at all",
)
#: Where a method means something else.
_OTHER_MEANING = {
    "scaled": {
        "exact": "the pixel's colour, under D65",
        "closest": "a colour this method cannot show, moved to the nearest",
    },
    "lattice": {
        "fallback": "dark and outside the lattice of its light: the pixel's colour, in that of D65",
        "closest": "outside the lattice of its light: moved to the nearest colour in it",
    },
}
_KNOWN_TYPES = (*LIGHT_TYPES, "discharge", "measured")


def environment_map(output: Path) -> dict[str, Any] | None:
    """The panorama at several exposures: as the eye adapts, the shadows, and down to the brightest lamp."""
    path = output / "panorama" / "environment.exr"
    if not path.is_file():
        return None
    small = previews.reduced(path, dict.fromkeys("RGB", "mean"), longest=LONGEST_MAP)
    matrix = previews.srgb_matrix(str(small.header.attributes.get("envcalSpace", CAMERA_RGB)))
    gain, lamps = previews.exposure(small.rgb, matrix), previews.brightest_gain(small.rgb, matrix)
    steps = [("as adapted", gain), ("shadows, +3 EV", 8 * gain)]
    stops = float(np.log2(gain / lamps))
    if stops > 5:
        steps.append((f"highlights, −{stops / 2:.1f} EV", float(np.sqrt(gain * lamps))))
    if stops > 1:
        steps.append((f"lamps, −{stops:.1f} EV", lamps))
    height, width = small.header.size
    return {
        "width": width,
        "height": height,
        "space": small.header.attributes.get("envcalSpace"),
        "missing": bool(small.missing.any()),
        "stops": stops,
        "unit": unit_of(path, small.header.attributes),
        "views": [
            {
                "name": name,
                "picture": previews.jpeg(
                    previews.display(small.rgb, matrix, gain=value, missing=small.missing), quality=82 if k else 86
                ),
            }
            for k, (name, value) in enumerate(steps)
        ],
    }


def read_lights(output: Path) -> lights_file.Lights | None:
    """The lights of the map."""
    path = output / "cluster" / "lights.json"
    if not path.is_file():
        return None
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        value = None
    return lights_file.parse(value, place=path)


def lights(output: Path, found: lights_file.Lights) -> dict[str, Any]:
    """The clusters over the map, the table of lights, their emission spectra and their chromaticities."""
    grid = _grid(found.wavelengths)
    emissions = [np.asarray(light.emission, np.float64) for light in found.lights]
    lines = [
        plots.Curve(f"{light.cluster} {_kind(light.type)}", emission, light.cluster)
        for light, emission in zip(found.lights, emissions, strict=True)
        if emission.shape == grid.shape
    ]
    return {
        "lights": found.lights,
        "colours": {light.cluster: plots.colour_of(light.cluster) for light in found.lights},
        "low": LOW_CONFIDENCE,
        "space": found.space,
        "spectra": plots.curves(grid, lines, name="emissions", ylabel="power per nm, equal luminance"),
        "diagram": _diagram(found),
        **_cluster_pictures(output, found),
    }


def _grid(wavelengths: str) -> npt.NDArray[np.float64]:
    start, stop, step = parse_wavelengths(wavelengths)
    return np.linspace(start, stop, round((stop - start) / step) + 1)


def _kind(kind: str) -> str:
    """A light's type for a label in a plot; what a file calls otherwise is no more than a light there."""
    return kind if kind in _KNOWN_TYPES else "light"


def _diagram(found: lights_file.Lights) -> str:
    from uplift.cct import planckian_uv, uv_of_xy
    from uplift.spectrum import observer, xyz_of

    seen = observer(*parse_wavelengths(found.wavelengths), name=found.observer)
    points = []
    for light in found.lights:
        if len(light.emission) != seen.wavelengths_nm.size:
            continue
        xyz = xyz_of(light.emission, seen)
        u, v = uv_of_xy(xyz[:2] / xyz.sum())
        measured, bar = None, None
        if light.cct_seen is not None and light.duv_seen is not None:
            iu, iv = plots.isotherm(light.cct_seen, np.array([light.duv_seen]))[0]
            measured = (float(iu), float(iv))
            if light.cct_sigma:
                sigma = min(light.cct_sigma, 0.6 * light.cct_seen)
                along = planckian_uv(np.linspace(light.cct_seen - sigma, light.cct_seen + sigma, 15))
                bar = along + (np.array(measured) - planckian_uv(light.cct_seen))
        points.append(plots.Point(light.cluster, measured, (float(u), float(v)), bar))
    return plots.chromaticities(points, name="diagram")


def _cluster_pictures(output: Path, found: lights_file.Lights) -> dict[str, Any]:
    path = output / "cluster" / "clusters.exr"
    if not path.is_file():
        return {"map": None, "sky": None}
    ways: dict[str, Literal["mean", "centre", "max"]] = dict.fromkeys("RGB", "mean")
    small = previews.reduced(path, {**ways, "cluster": "centre", "sky": "centre"}, longest=LONGEST_MAP)
    matrix = previews.srgb_matrix(found.space)
    gain = previews.exposure(small.rgb, matrix)
    labels = small.planes["cluster"]
    grey = previews.luminance(small.rgb, matrix).astype(np.float32)
    shown = previews.display(np.repeat(grey[..., np.newaxis], 3, axis=2), np.eye(3), gain=gain)
    tint = np.array([_rgb(colour) for colour in plots.PALETTE])[labels % len(plots.PALETTE)]
    mixed = np.round(0.8 * shown * (0.3 + 0.7 * tint / 255) + 0.2 * tint).astype(np.uint8)
    border = _borders(labels)
    mixed[border] = mixed[border] // 2 + 110
    sky = small.planes["sky"] > 0
    weight = np.sin(np.pi * (np.arange(sky.shape[0]) + 0.5) / sky.shape[0])[:, np.newaxis]
    pictures: dict[str, Any] = {
        "map": previews.jpeg(previews.hatched(mixed, small.missing), quality=86),
        "missing": bool(small.missing.any()),
        "sky": None,
        "sky_share": float((sky * weight).sum() / (weight.sum() * sky.shape[1])),
    }
    if sky.any():
        dim = (0.35 * shown).astype(np.uint8)
        tinted = np.where(sky[..., np.newaxis], np.maximum(shown, 40) // 2 + np.array([20, 70, 120], np.uint8), dim)
        tinted[_borders(sky.astype(np.uint8))] = 255
        pictures["sky"] = previews.jpeg(tinted.astype(np.uint8)[::2, ::2])
    return pictures


def _rgb(css: str) -> tuple[int, int, int]:
    return (int(css[1:3], 16), int(css[3:5], 16), int(css[5:7], 16))


def _borders(labels: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """Pixels whose right or lower neighbour has another label; the map's seam is no border."""
    border = labels != np.roll(labels, -1, axis=1)
    border[:-1] |= labels[:-1] != labels[1:]
    return border


def uplift(output: Path, figures: dict[str, Any], found: lights_file.Lights | None) -> dict[str, Any] | None:
    """Counts by status, where the pixels that are not exact are, and spectra of some pixels."""
    path = output / "uplift" / "environment.exr"
    if not path.is_file():
        return None
    header, about = uplift_file.read_any_about(path)
    height, width = header.size
    ways: dict[str, Literal["mean", "centre", "max"]] = dict.fromkeys(uplift_file.channels(about), "centre")
    ways["status"] = "max"
    if "status" not in header.channels:
        del ways["status"]
    small = previews.reduced(path, ways, longest=LONGEST_MAP // 2)
    picture, present = _status_map(small.planes["status"]) if "status" in ways else (None, set())
    counts, sphere, errors = (figures.get(key, {}) for key in ("status", "solid_angle", "delta_e_by_status"))
    meanings = _OTHER_MEANING.get(about.method, {})
    return {
        "width": width,
        "height": height,
        "about": about,
        "status": [
            {
                "name": name,
                "meaning": meanings.get(name, meaning),
                "colour": colour,
                "count": counts.get(name),
                "sphere": sphere.get(name),
                "error": errors.get(name, {}).get("max") if counts.get(name) else None,
                "on_map": k in present,
            }
            for k, (name, meaning, colour) in enumerate(zip(_STATUS, _STATUS_MEANING, _STATUS_COLOURS, strict=True))
        ],
        "map": picture,
        "pixels": _pixel_spectra(small, about, found, uplift_file.Radiance(path, about, about.wavelengths_nm)),
    }


def _status_map(status: npt.NDArray[Any]) -> tuple[str | None, set[int]]:
    """A map of the pixels by status, if any is not exact under its own light, and which statuses there are."""
    present = {int(k) for k in np.unique(status)}
    if max(present) < _FIRST_NOTABLE:
        return None, present
    colours = np.array([_rgb(colour) for colour in _STATUS_COLOURS], np.uint8)
    return previews.png(colours[np.minimum(status, len(_STATUS) - 1)]), present


def _pixel_spectra(
    small: previews.Reduced,
    about: uplift_file.About | uplift_file.LatticeAbout,
    found: lights_file.Lights | None,
    radiance_of: uplift_file.Radiance,
) -> list[dict[str, Any]]:
    """For each light: its emission, and the spectra of a pixel where it is brightest and of one of median brightness."""
    planes = small.planes
    matrix = previews.srgb_matrix(about.space)
    y = np.nan_to_num(previews.luminance(small.rgb, matrix), nan=0.0)
    wavelengths = np.asarray(about.wavelengths_nm)
    emissions = about.emissions()
    # The scaled method puts every pixel under D65, whatever lights there are.
    named = {light.cluster: light for light in found.lights} if found and about.method != "scaled" else {}
    shown = []
    for k, emission in enumerate(emissions):
        solved = np.isin(planes["status"].ravel(), (_EXACT, _FALLBACK)) if "status" in planes else True
        inside = np.flatnonzero(
            (planes["cluster"].ravel() == k) & (planes["scale"].ravel() > 0) & (y.ravel() > 0) & solved
        )
        if not inside.size:
            continue
        order = inside[np.argsort(y.ravel()[inside], kind="stable")]
        light = named.get(k)
        picks = {
            "brightest region": _near(order, y, light.at) if light else int(order[-1]),
            "median brightness": int(order[len(order) // 2]),
        }
        lines = [plots.Curve("emission", emission / emission.max(), k, "dotted")]
        places = []
        for number, (label, where) in enumerate(picks.items()):
            row, column = divmod(where, y.shape[1])
            spectrum = radiance_of({name: planes[name][row, column] for name in radiance_of.channels})
            lines.append(
                plots.Curve(label, spectrum / max(spectrum.max(), 1e-300), k, "solid" if not number else "dashed")
            )
            places.append(
                {
                    "label": label,
                    "x": column * small.step + small.step // 2,
                    "y": row * small.step + small.step // 2,
                    "colour": _patch_colour(small.rgb[row, column], matrix),
                }
            )
        shown.append(
            {
                "title": f"{k} {light.name or light.type}" if light else about.clusters[k].source,
                "colour": plots.colour_of(k),
                "places": places,
                "plot": plots.curves(
                    wavelengths, lines, name=f"pixels-{k}", ylabel="radiance, peak = 1", legend=False, small=True
                ),
            }
        )
    return shown


def _near(order: npt.NDArray[np.int64], y: npt.NDArray[np.float64], at: tuple[float, float]) -> int:
    """A pixel that stands for the bright ones near a place (u, v), among pixels in the `order` of their luminance `y`.

    It is the median of those at least half as bright as the brightest: edges ring, the middle of a lamp does not.
    """
    height, width = y.shape
    rows, columns = np.divmod(order, width)
    across = np.abs((columns + 0.5) / width - at[0])
    distance = np.hypot(2 * np.minimum(across, 1 - across), (rows + 0.5) / height - at[1])
    near = order[distance <= max(_NEAR, float(distance.min()))]
    bright = near[y.ravel()[near] >= y.ravel()[near[-1]] / 2]
    return int(bright[len(bright) // 2])


def _patch_colour(rgb: npt.NDArray[Any], matrix: previews.Floats) -> str:
    """A pixel's colour at a brightness at which it can be told."""
    peak = float(np.max(rgb @ matrix.T))
    return previews.css_colour(rgb * (0.9 / peak) if peak > 0 else rgb, matrix)


def spectra(output: Path) -> dict[str, Any] | None:
    """The spectral image: its bands, and three of them as pictures."""
    path = output / "spectra" / "environment.exr"
    if not path.is_file():
        return None
    header = exr.header(path)
    bands = {}
    for name in header.channels:
        match = re.fullmatch(r"S0\.(\d+),(\d+)nm", name)
        if match:
            bands[float(f"{match[1]}.{match[2]}")] = name
    wavelengths = sorted(bands)
    if not wavelengths:
        raise EnvcalError(f"{path}: holds no spectral band. Run `envcal spectra` again.")
    asked = dict.fromkeys(_nearest(wavelengths, near) for near in (450, 550, 650))
    small = previews.reduced(path, {bands[w]: "mean" for w in asked}, longest=560)
    views = []
    for wavelength in asked:
        plane = np.asarray(small.planes[bands[wavelength]], np.float32)
        image = np.repeat(plane[..., np.newaxis], 3, axis=2)
        gain = previews.exposure(image, np.eye(3))
        shown = previews.display(image, np.eye(3), gain=gain, missing=small.missing)
        views.append({"wavelength": wavelength, "picture": previews.jpeg(shown)})
    height, width = header.size
    return {
        "file": "spectra/environment.exr",
        "bytes": path.stat().st_size,
        "width": width,
        "height": height,
        "first": wavelengths[0],
        "last": wavelengths[-1],
        "count": len(wavelengths),
        "kind": {"f2": "half", "f4": "float"}.get(header.channels[bands[wavelengths[0]]], "unsigned"),
        "unit": header.attributes.get("bandUnit") or header.attributes.get("unit", "relative"),
        "layout": header.attributes.get("spectralLayoutVersion"),
        "example": spectral_exr.channel(wavelengths[0]),
        "missing": bool(small.missing.any()),
        "views": views,
    }


def _nearest(values: Sequence[float], wanted: float) -> float:
    return min(values, key=lambda value: abs(value - wanted))
