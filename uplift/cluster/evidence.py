"""Which pixels speak for the lamps: the lamps themselves where they are seen, else the brightest surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from uplift.sky import Sky

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]

WORK_WIDTH = 1024  # columns of the map on which statistics are made
# Above this many times (greatest irradiance)/π a pixel is taken for a lamp seen directly. Measured on 54 relit rooms of
# one to three lamps: with 4 all numbers of lamps came out right, with 2 up to 11 walls beside a lamp were called lamps.
LAMP_ABOVE_DIFFUSE = 4.0
GLOW_RADIUS = 10.0 / 360.0  # of the width: how far the glow of a lamp reaches on what stands beside it
GLOW_BELOW = 0.25  # of the brightest within that radius: below it a pixel is glow, not lamp
BLOCKS = (8, 16)  # of the map, in which the brightest surfaces are looked for
WHITE_BELOW = 0.7  # of the brightest of a block: below it a surface is taken to be coloured or turned away
DIM_BLOCK = 0.5  # of the average light of a block: darker blocks say nothing
MIN_LAMP_LIGHT = 0.02  # share of all light that must be seen directly; else surfaces are the evidence


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The map on which statistics are made: at most 1024 columns; NaN, infinities and negative values are 0."""

    rgb: Floats  # [h, w, 3]
    luminance: Floats  # [h, w]
    solid_angle: Floats  # [h, w], as a share of the sphere
    light: Floats  # [h, w] luminance times solid angle
    sky: Bools | None  # [h, w]; None: there is none


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Pixels that speak for the lamps: positions in the working map, colours and weights."""

    rgb: Floats  # [P, 3]
    weight: Floats  # [P]
    place: npt.NDArray[np.int64]  # [P] flat index into the working map
    direct: bool
    above: float = np.inf  # luminance above which a pixel is a lamp seen directly

    def kept(self, those: Bools) -> Evidence:
        """Return the part of the evidence that `those` [P] names."""
        return Evidence(self.rgb[those], self.weight[those], self.place[those], self.direct, self.above)


def view_of(image: Image, luminance_weights: Floats, sky: Sky | None) -> View:
    """Return the working view of a map, and its sky on it."""
    height, width = image.shape[:2]
    small = image
    if width > WORK_WIDTH:
        size = (WORK_WIDTH, max(1, round(height * WORK_WIDTH / width)))
        # an average with a NaN in it is NaN; such pixels are few, and their neighbours speak for them
        small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)
    fine = np.isfinite(small).all(axis=2, keepdims=True)
    rgb = np.maximum(np.where(fine, small, 0.0), 0.0).astype(np.float64)
    mask = None
    if sky is not None and sky.present:
        size = (rgb.shape[1], rgb.shape[0])
        mask = np.asarray(cv2.resize(sky.mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0)
    edges = np.cos(np.pi * np.arange(len(rgb) + 1) / len(rgb))
    rows = (edges[:-1] - edges[1:]) / (2.0 * rgb.shape[1])
    solid_angle = np.repeat(rows[:, np.newaxis], rgb.shape[1], axis=1)
    luminance = np.maximum(rgb @ luminance_weights, 0.0)
    return View(rgb, luminance, solid_angle, luminance * solid_angle, mask)


def daylight(view: View) -> Floats:
    """RGB [3] of what the sky and the sun in it give to a level surface."""
    assert view.sky is not None
    cosine = np.maximum(np.cos(np.pi * (np.arange(len(view.rgb)) + 0.5) / len(view.rgb)), 0.0)
    weight = view.solid_angle * cosine[:, np.newaxis] * view.sky
    out: Floats = (view.rgb * weight[..., np.newaxis]).sum(axis=(0, 1))
    return out / max(float(weight.sum()), 1e-300)


def _greatest_irradiance(view: View) -> float:
    """The greatest irradiance any orientation receives at the camera, over π: a white card's greatest luminance."""
    size = (min(64, view.luminance.shape[1]), min(32, view.luminance.shape[0]))
    small = np.asarray(cv2.resize(view.light, size, interpolation=cv2.INTER_AREA), np.float64)
    small *= view.light.sum() / small.sum()
    ways = _ways(size[1], size[0])
    # every other way is tried: between two of them, 8 degrees apart at most, an irradiance grows by a thousandth
    tried = ways.reshape(size[1], size[0], 3)[::2, ::2].reshape(-1, 3)
    cosines = tried @ ways.T
    np.maximum(cosines, 0.0, out=cosines)
    return float(4.0 * (cosines @ small.ravel().astype(np.float32)).max())  # 4π of the sphere over π


def _ways(rows: int, columns: int) -> Image:
    """Unit vectors [rows · columns, 3] of the directions of a lat-long map."""
    theta = np.pi * (np.arange(rows) + 0.5) / rows
    phi = 2.0 * np.pi * ((np.arange(columns) + 0.5) / columns - 0.5)
    parts = [
        np.outer(np.sin(theta), np.sin(phi)),
        np.outer(np.cos(theta), np.ones_like(phi)),
        -np.outer(np.sin(theta), np.cos(phi)),
    ]
    return np.stack(parts, axis=-1).reshape(-1, 3).astype(np.float32)


def greatest_nearby(luminance: Floats, radius: int) -> Floats:
    """Greatest luminance within `radius` pixels of the working map, wrapping in x."""
    radius = max(1, min(radius, luminance.shape[1] // 2))
    padded = np.pad(luminance.astype(np.float32), ((0, 0), (radius, radius)), mode="wrap")
    # a square, not a disc: OpenCV does its rows and columns apart, thirty times as fast
    grown = cv2.dilate(padded, np.ones((2 * radius + 1, 2 * radius + 1), np.uint8))
    return np.asarray(grown[:, radius:-radius], np.float64)


def _evidence(view: View, weight: Floats, chosen: Bools, *, direct: bool, above: float = np.inf) -> Evidence:
    place = np.flatnonzero(chosen & (view.luminance > 0))
    return Evidence(view.rgb.reshape(-1, 3)[place], weight.ravel()[place], place, direct, above)


def bright(view: View) -> Evidence:
    """The paper's: every pixel that is no darker than the average, each by its solid angle."""
    # a map of one colour must not lose half of its pixels to the rounding of its average
    return _evidence(view, view.solid_angle, view.luminance >= view.light.sum() * (1 - 1e-6), direct=False)


def lamps_or_surfaces(view: View) -> Evidence:
    """Lamps seen directly, weighted by their light; where there are none, the locally brightest surfaces."""
    light, luminance = view.light, view.luminance
    nearby = greatest_nearby(luminance, round(GLOW_RADIUS * luminance.shape[1]))
    above = LAMP_ABOVE_DIFFUSE * _greatest_irradiance(view)
    lamps = luminance > above
    lamps &= luminance >= GLOW_BELOW * nearby
    if light[lamps].sum() >= MIN_LAMP_LIGHT * light.sum():
        return _evidence(view, light, lamps, direct=True, above=above)
    return _surfaces(view)


def _surfaces(view: View) -> Evidence:
    """The brightest surfaces of each block of the map, averaged, as one piece of evidence a block.

    What is brightest around is most likely to be white, and the colours of several such surfaces average out; a lamp's
    light is on all of them.
    """
    height, width = view.luminance.shape
    rows = np.minimum(np.arange(height) * BLOCKS[0] // height, BLOCKS[0] - 1)
    columns = np.arange(width) * BLOCKS[1] // width
    block = (rows[:, np.newaxis] * BLOCKS[1] + columns).ravel()
    count = BLOCKS[0] * BLOCKS[1]
    luminance, light = view.luminance.ravel(), view.light.ravel()
    brightest = np.zeros(count)
    np.maximum.at(brightest, block, luminance)
    chosen = (luminance >= WHITE_BELOW * brightest[block]) & (luminance > 0)
    rgb = view.rgb.reshape(-1, 3)
    solid_angle = np.where(chosen, view.solid_angle.ravel(), 0.0)
    colours = np.stack([np.bincount(block, solid_angle * rgb[:, i], count) for i in range(3)], axis=1)
    weight = np.bincount(block, light, count)
    first = np.full(count, len(block), np.int64)
    np.minimum.at(first, block[chosen], np.flatnonzero(chosen))
    lit = (weight > 0) & (weight >= DIM_BLOCK * weight.sum() / count)
    return Evidence(colours[lit], weight[lit], first[lit], direct=False)
