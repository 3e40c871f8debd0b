"""Rooms and skies whose spectra are known, lit by any lamps, and the relight test on them.

A room is light transport: the radiance at a pixel is the sum, over groups of lamps, of their emission times what the
room makes of it. So one room serves for every lamp, and the truth is there for every pixel: its spectrum, and how much
of its luminance each lamp contributes.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from uplift.cct import planck
from uplift.difference import delta_e_2000
from uplift.illuminants import cct_duv_of, measured_emission
from uplift.illuminants.fluorescent import NAMES as FLUORESCENT_NAMES
from uplift.illuminants.led import NAMES as LED_NAMES
from uplift.pixels import spectra_of, uplift_pixels
from uplift.scaled import uplift_scaled
from uplift.spectrum import Observer, RGBSpace, illuminant, normalised, rgb_space
from uplift.table import build_table

Float64 = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

GROUPS = ("ceiling", "floor lamps", "window")
SAMPLED_PIXELS = 240
SAMPLED_REFLECTANCES = 40
INCANDESCENT_K = (1900, 2000, 2100, 2200, 2400, 2600, 2700, 2856, 3000, 3200)


@dataclass(frozen=True, slots=True, eq=False)
class Lamp:
    """A lamp to light a room with."""

    kind: str  # led, fluorescent, incandescent, discharge, daylight
    name: str
    emission: Float64  # [N], Y = 1
    cct: float
    duv: float
    in_library: bool  # whether the product interpolates between this very spectrum and others


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """Spectral light transport of a room."""

    name: str
    transport: npt.NDArray[np.float32]  # [groups, H, W, M]
    to_grid: Float64  # [M, N]: linear interpolation to the observer's grid


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A map, and what is true of it."""

    name: str
    rgb: Image  # [H, W, 3]
    lamps: tuple[Lamp, ...]
    parts: Float64  # [lamps, H, W]: luminance that each lamp contributes
    spectra: Float64  # [P, N] of the sampled pixels
    places: npt.NDArray[np.int64]  # [P] flat indices of them


@cache
def solid_angle(height: int) -> Float64:
    """Return the share of the sphere in each row of a lat-long map, summing to 1."""
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    out: Float64 = (edges[:-1] - edges[1:]) / 2
    return out


def sampled(height: int, width: int, count: int = SAMPLED_PIXELS) -> npt.NDArray[np.int64]:
    """Return flat indices of pixels spread evenly over the sphere (Fibonacci's spiral)."""
    k = np.arange(count) + 0.5
    row = np.minimum(np.arccos(1 - 2 * k / count) / np.pi * height, height - 1).astype(np.int64)
    column = (k * (np.sqrt(5) - 1) / 2 % 1.0 * width).astype(np.int64)
    out: npt.NDArray[np.int64] = row * width + column
    return out


def lamps(folder: Path, observer: Observer) -> list[Lamp]:
    """Return the lamps of the figures: LED, fluorescent, incandescent, discharge; of the library and others."""
    found: list[tuple[str, str, Float64, bool]] = [
        ("led", name, illuminant(name, observer), name in ("LED-B1", "LED-B2", "LED-B3", "LED-B4", "LED-B5"))
        for name in LED_NAMES
    ]
    with (folder / "led19_measured.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    wavelengths = np.array([float(cell) for cell in rows[0][7:]])
    found += [
        ("led", row[3], measured_emission(wavelengths, [float(v) for v in row[7:]], observer), False)
        for row in rows[1:]
        if "CIE LED-B" not in row[3]
    ]
    halophosphate = tuple(f"FL{i}" for i in range(1, 7))
    found += [("fluorescent", name, illuminant(name, observer), name in halophosphate) for name in FLUORESCENT_NAMES]
    found += [
        ("incandescent", f"{kelvin} K", normalised(planck(observer.wavelengths_nm, kelvin), observer), True)
        for kelvin in INCANDESCENT_K
    ]
    found += [("discharge", f"HP{i}", illuminant(f"HP{i}", observer), False) for i in range(1, 6)]
    return [Lamp(kind, name, emission, *cct_duv_of(emission, observer), own) for kind, name, emission, own in found]


def rooms(folder: Path, observer: Observer) -> list[Room]:
    """Return every `truth/room*.npz`."""
    out = []
    for path in sorted((folder / "truth").glob("room*.npz")):
        with np.load(path) as file:
            grid = file["wavelengths"]
            to_grid = np.stack([np.interp(observer.wavelengths_nm, grid, row) for row in np.eye(grid.size)])
            out.append(Room(path.stem, file["transport"].astype(np.float32), to_grid))
    return out


def lit(
    room: Room,
    lights: Mapping[int, tuple[Lamp, float]],
    *,
    observer: Observer,
    space: RGBSpace,
    count: int = SAMPLED_PIXELS,
) -> Scene:
    """Return a room whose groups of lamps (number → lamp and strength) are on, the others off."""
    height, width = room.transport.shape[1:3]
    rgb = np.zeros((height, width, 3), np.float32)
    places = sampled(height, width, count)
    spectra = np.zeros((len(places), observer.wavelengths_nm.size))
    unique: dict[str, Lamp] = {lamp.name: lamp for lamp, _ in lights.values()}
    parts = {name: np.zeros((height, width)) for name in unique}
    for group, (lamp, strength) in lights.items():
        emission = strength * lamp.emission
        matrix = room.to_grid @ (emission[:, None] * observer.cmfs * observer.step_nm) @ space.rgb_from_xyz.T
        own = room.transport[group] @ matrix.astype(np.float32)
        rgb += own
        parts[lamp.name] += np.maximum(own @ space.luminance_weights, 0.0)
        spectra += (
            room.transport[group].reshape(-1, len(room.to_grid))[places].astype(np.float64) @ room.to_grid
        ) * emission
    called = " + ".join(f"{lamp.name} ({GROUPS[group]})" for group, (lamp, _) in lights.items())
    return Scene(f"{room.name}: {called}", rgb, tuple(unique.values()), np.stack(list(parts.values())), spectra, places)


def skies(folder: Path, observer: Observer, space: RGBSpace) -> list[Scene]:
    """Return every `truth/outdoor*.npz`; their spectra end at 720 nm, and hold their last value beyond."""
    out = []
    for path in sorted((folder / "truth").glob("outdoor*.npz")):
        with np.load(path) as file:
            radiance, grid = file["radiance"].astype(np.float32) * float(file["scale"]), file["wavelengths"]
        to_grid = np.stack([np.interp(observer.wavelengths_nm, grid, row) for row in np.eye(grid.size)])
        matrix = to_grid @ (observer.cmfs * observer.step_nm) @ space.rgb_from_xyz.T
        rgb = (radiance @ matrix.astype(np.float32)).astype(np.float32)
        height, width = rgb.shape[:2]
        places = sampled(height, width)
        spectra = radiance.reshape(-1, len(grid))[places].astype(np.float64) @ to_grid
        luminance = np.maximum(rgb @ space.luminance_weights, 0.0).astype(np.float64)
        out.append(Scene(path.stem, rgb, (), luminance[None], spectra, places))
    return out


@cache
def atlas(folder: Path, observer: Observer) -> Float64:
    """Return reflectances [K, N]: every 37th of the Munsell atlas, its ends held."""
    with np.load(folder / "munsell_glossy_1485.npz") as file:
        chosen = file["reflectance"][:: len(file["reflectance"]) // SAMPLED_REFLECTANCES][:SAMPLED_REFLECTANCES]
        return np.stack([np.interp(observer.wavelengths_nm, file["wavelength"], row) for row in chosen])


def relight(spectra: Float64, truth: Float64, reflectances: Float64, *, observer: Observer, space: RGBSpace) -> float:
    """Return the mean ΔE2000 [pixels × reflectances] between reflectances lit by two sets of spectra [P, N].

    Every pair is scaled by the luminance of the true light, as an eye adapted to it would see it.
    """
    cmfs = observer.cmfs @ space.rgb_from_xyz.T * observer.step_nm
    weights = reflectances.T[:, :, None] * cmfs[:, None, :]  # [N, K, 3]
    luminance = truth @ observer.cmfs[:, 1] * observer.step_nm
    lit = luminance > 0
    pair = [np.tensordot(s[lit] / luminance[lit, None], weights, axes=1) for s in (truth, spectra)]
    return float(np.nanmean(delta_e_2000(pair[0], pair[1], space)))


def scaled_error(scene: Scene, reflectances: Float64, *, observer: Observer, space: RGBSpace) -> float:
    """Return the relight error of what renderers do today: a reflectance under D65, in sRGB."""
    narrow = rgb_space("sRGB", observer=observer)
    rgb = scene.rgb.reshape(1, -1, 3)[:, scene.places].astype(np.float64)
    up = uplift_scaled(rgb @ (narrow.rgb_from_xyz @ space.xyz_from_rgb).T, observer=observer, space=narrow)
    found = spectra_of(up.coefficients, up.scale, up.emission, up.emissions, observer.wavelengths_nm, observer=observer)
    return relight(np.asarray(found[0], np.float64), scene.spectra, reflectances, observer=observer, space=space)


def error(
    scene: Scene,
    labels: npt.NDArray[np.uint32],
    emissions: Sequence[Float64],
    reflectances: Float64,
    *,
    observer: Observer,
    space: RGBSpace,
) -> float:
    """Return the relight error of the uplift of a scene under the emissions [k][N] of its clusters."""
    rgb = scene.rgb.reshape(1, -1, 3)[:, scene.places].astype(np.float64)
    tables = [build_table(emission, observer=observer, space=space) for emission in emissions]
    up = uplift_pixels(rgb, labels.reshape(1, -1)[:, scene.places], tables)
    found = spectra_of(up.coefficients, up.scale, up.emission, up.emissions, observer.wavelengths_nm, observer=observer)
    return relight(np.asarray(found[0], np.float64), scene.spectra, reflectances, observer=observer, space=space)
