"""Maps and lamps to measure with: made from random smooth reflectances, or read from a folder of measured ones."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from uplift.illuminants import FAMILIES, family_emission
from uplift.spectrum import Observer, RGBSpace, rgb_weights

Float64 = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

FIVE_FAMILIES = ("daylight", "sunset", "led", "fluorescent", "incandescent")
KINDS = ("reflectances", "colours", "dark", "saturated", "bright")


def size(text: str) -> tuple[int, int]:
    """Return (width, height) of "4096x2048", for argparse."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdigit() and int(part) > 1 for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r} is no size; expected WIDTHxHEIGHT, as 4096x2048")
    return int(parts[0]), int(parts[1])


def lamps(per_family: int, observer: Observer) -> list[tuple[str, str, Float64]]:
    """Return (family, name, emission [N]) of `per_family` lamps of each of the five families, even in mired."""
    out = []
    for family in FIVE_FAMILIES:
        low, high = FAMILIES[family].low_k, FAMILIES[family].high_k
        mireds = np.linspace(1 / low, 1 / high, per_family) if per_family > 1 else [(1 / low + 1 / high) / 2]
        for cct in 1 / np.asarray(mireds):
            kelvin = float(np.clip(cct, low, high))
            out.append((family, f"{family} {kelvin:.0f} K", family_emission(family, kelvin, observer)))
    return out


def smooth_reflectances(count: int, observer: Observer, rng: np.random.Generator) -> Float64:
    """Return reflectances [count, N] in 0.02 … 1: mixtures of three bumps, broad and narrow."""
    centres, widths = rng.uniform(400, 700, (count, 3, 1)), rng.uniform(25, 150, (count, 3, 1))
    bumps = np.exp(-0.5 * ((observer.wavelengths_nm - centres) / widths) ** 2) * rng.random((count, 3, 1))
    out: Float64 = 0.02 + 0.98 * bumps.sum(axis=1) / 3
    return out


def lit_map(
    width: int, height: int, emissions: list[Float64], *, observer: Observer, space: RGBSpace, seed: int = 0
) -> tuple[Image, npt.NDArray[np.uint32]]:
    """Return an HDR map [height, width, 3] and its clusters: a strip of smooth reflectances under each lamp.

    Objects are 16 pixels wide and lit by a gradient; noise of 1 % keeps neighbours different, as in a photograph.
    """
    rng = np.random.default_rng(seed)
    cluster = np.broadcast_to((np.arange(width) * len(emissions) // width).astype(np.uint32), (height, width)).copy()
    reflectances = smooth_reflectances(512, observer, rng)
    colours = np.stack([reflectances @ rgb_weights(light, observer, space).T for light in emissions])
    small = rng.integers(0, 512, ((height + 15) // 16, (width + 15) // 16))
    rgb = np.empty((height, width, 3), np.float32)
    for row in range(height):
        objects = np.repeat(small[row // 16], 16)[:width]
        light = np.exp(3 * np.sin(2 * np.pi * np.arange(width) / width * 3 + row / height))
        noise = 1 + 0.01 * rng.standard_normal((width, 3), np.float32)
        rgb[row] = colours[cluster[row], objects] * light[:, None] * noise
    return np.maximum(rgb, 0), cluster


def random_map(
    kind: str, width: int, height: int, emission: Float64, *, observer: Observer, space: RGBSpace, seed: int
) -> Image:
    """Return a random map [height, width, 3] of one of `KINDS`, seen under (or unrelated to) a lamp."""
    rng = np.random.default_rng(seed)
    shape = (height, width, 3)
    if kind == "reflectances":
        reflectances = smooth_reflectances(height * width, observer, rng)
        rgb = (reflectances @ rgb_weights(emission, observer, space).T).reshape(shape)
    elif kind == "colours":
        rgb = rng.random(shape)
    elif kind == "dark":
        rgb = rng.random(shape) * 10 ** rng.uniform(-9, -3, (height, width, 1))
    elif kind == "saturated":
        rgb = rng.random(shape) ** 4
    else:
        rgb = rng.random(shape) * 10 ** rng.uniform(0, 5, (height, width, 1))
    return np.maximum(rgb, 0).astype(np.float32)


def relit_rooms(folder: Path, emission: Float64, *, observer: Observer, space: RGBSpace) -> Iterator[tuple[str, Image]]:
    """Yield (name, map) of every `truth/room*.npz` with all of its lamps replaced by one."""
    weights = rgb_weights(emission, observer, space)
    for path in sorted((folder / "truth").glob("room*.npz")):
        with np.load(path) as room:
            transport, grid = room["transport"].astype(np.float32).sum(axis=0), room["wavelengths"]
        # Linear between the room's wavelengths, as one matrix: resampling every pixel would cost more than its uplift.
        to_grid = np.stack([np.interp(observer.wavelengths_nm, grid, row) for row in np.eye(grid.size)])
        yield path.stem, (transport @ (to_grid @ weights.T).astype(np.float32)).astype(np.float32)


def real_maps(folder: Path) -> Iterator[tuple[str, Image, str]]:
    """Yield (name, map, space) of every `real/*.hdr`, taken for linear sRGB."""
    from envcal.maps import read_map

    for path in sorted((folder / "real").glob("*.hdr")):
        found = read_map(path, space="sRGB")  # whatever its header says: some say that all primaries are zero
        yield path.stem, found.image, found.space


def inside_locus(rgb: npt.NDArray[np.floating], *, observer: Observer, space: RGBSpace) -> Float64:
    """Return how far chromaticities [...] lie inside the convex hull of the observer's wavelengths, negative outside.

    Only colours outside have no non-negative spectrum on the observer's grid. Found by scipy, not by the uplift.
    """
    from scipy.spatial import ConvexHull

    hull = ConvexHull(observer.cmfs[:, :2] / observer.cmfs.sum(axis=1, keepdims=True))
    xyz = np.asarray(rgb, dtype=np.float64) @ space.xyz_from_rgb.T
    total = xyz.sum(axis=-1)
    xy = xyz[..., :2] / np.where(total > 0, total, 1.0)[..., None]
    distance = -(xy @ hull.equations[:, :2].T + hull.equations[:, 2]).max(axis=-1)
    return np.where(total > 0, distance, -1.0)
