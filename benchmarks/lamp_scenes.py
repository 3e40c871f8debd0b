"""Synthetic captures of a chart and a D65 lamp among windows, screens, other lamps, glints and paper; all from a seed.

A picture is a sum of layers: what things reflect of two lights of the scene and of the lamp, and what shines. Every colour
comes from spectra: measured reflectances, lamps of the CIE's tables, Planck and daylight, modelled LEDs, and measured
camera sensitivities. The picture is blurred, a veil of stray light is added, and it falls on a Bayer mosaic in a bracket with shot and
read noise and clipping. Merge, demosaic, chart matrix and correction are those of the pipeline.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.chart_scenes import BOX, chart_texture, warped
from calibrate.exposure import FrameInfo
from samples import spectra

Float64 = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

SCENE_LIGHTS = (
    *("A", "2200 K", "3200 K", "LED-B1", "LED-B2", "LED-B3", "LED-B4", "LED-B5", "LED-BH1", "LED-RGB1", "LED-V1"),
    *("FL2", "FL4", "FL7", "FL11", "FL12", "D50", "D55", "D65", "D75", "9000 K", "12000 K"),
)
LAMPS = ("A", "3200 K", "LED-B1", "LED-B3", "LED-B4", "LED-B5", "FL1", "FL2", "FL7", "FL11", "HP3")
KINDS = ("plain", "plain", "plain", "plain", "plain", "plain", "clipped", "dim", "small", "mixed")
BLACK, WHITE, GAIN, READ_E = 512.0, 16383.0, 3.1, 4.0
#: Chart white in the middle frame, of the white level.
_EXPOSED = 0.3
#: How far a camera is from the published matrix of its model, standard deviation of each channel.
_MATRIX_ERROR = 0.025
#: The box of the chart, across.
CHART_MM = 268.0


@dataclass(frozen=True, slots=True, eq=False)
class LampScene:
    """A picture as the camera would see it without noise, and what is true of it.

    `radiance` [H, W, 3] is camera RGB, chart white about 1 in green; `lamp` [H, W] marks pixels that show nothing but the lamp,
    `place` those at least half covered by it, `camera_lamp` [3] its own light, `camera_d65` [3] what the camera's published matrix says of D65. `readable`: large, bright and unclipped enough that it must be found.
    """

    radiance: Image
    corners: Float64
    lamp: Mask | None
    place: Mask | None
    camera_lamp: Float64
    stops: tuple[int, ...]
    readable: bool
    camera_d65: Float64
    what: str
    others: tuple[tuple[str, float, float], ...]
    facts: dict[str, float] = field(default_factory=dict)


def spectrum(name: str) -> Float64:
    """Return a spectrum [81] of luminance 1: a name of `samples.spectra.lamp`, or kelvin (Planck, daylight from 4500 K)."""
    if not name.endswith(" K"):
        return spectra.lamp(name)
    kelvin = float(name[:-2])
    nm = spectra.WAVELENGTHS_NM
    if kelvin < 4500:
        return spectra.of_luminance_one(nm**-5.0 / np.expm1(1.4388e7 / (nm * kelvin)))
    return _daylight(kelvin)


@functools.lru_cache(maxsize=64)
def _daylight(kelvin: float) -> Float64:
    import colour

    shape = colour.SpectralShape(380, 780, 5)
    xy = colour.temperature.CCT_to_xy_CIE_D(min(kelvin, 24_000.0))
    values = colour.sd_CIE_illuminant_D_series(xy).align(shape).values
    return spectra.of_luminance_one(np.asarray(values, np.float64))


def d65_lamp(rng: np.random.Generator) -> Float64:
    """Return the spectrum [81] of some D65 module: within 0.004 of D65 in x and y, from one of four constructions."""
    target = np.array([0.3127, 0.3290]) + rng.uniform(-0.004, 0.004, 2)
    kind = int(rng.integers(4))
    if kind == 0:
        return spectra.d65_module()
    base = spectra.lamp(("D65", "LED-B4", "LED-B5")[kind - 1])
    parts = [base, *(spectra.led(peak, 22.0) for peak in (rng.uniform(450, 470), rng.uniform(515, 535)))]
    parts.append(spectra.led(float(rng.uniform(620, 640)), 18.0))
    # A fixed share of the red one; the other three by Grassmann's laws, as far as they come out positive.
    xyz = np.array([spectra.xyz_of(part) for part in parts])
    want = np.array([target[0] / target[1], 1.0, (1 - target.sum()) / target[1]])
    red = float(rng.uniform(0.0, 0.05))
    shares = np.linalg.solve(xyz[[0, 1, 2]].T, want - red * xyz[3])
    if (shares < 0).any():
        return spectra.lamp("D65")
    return spectra.of_luminance_one(shares @ np.array(parts[:3]) + red * parts[3])


@functools.cache
def cameras() -> tuple[tuple[str, Float64], ...]:
    """Names and sensitivities [3, 81] of the cameras: those of colour-science, and of ENVCAL_DATA where that is set."""
    import colour

    known = [(name, spectra.camera_sensitivities(name)) for name in colour.MSDS_CAMERA_SENSITIVITIES]
    folder = os.environ.get("ENVCAL_DATA")
    path = Path(folder) / "camera_sensitivities.npz" if folder else None
    if path is not None and path.is_file():
        data = np.load(path)
        known += [
            (str(name), np.asarray(ssf, np.float64).T) for name, ssf in zip(data["camera"], data["ssf"], strict=True)
        ]
    return tuple(known)


@functools.cache
def published_d65(name: str) -> Float64:
    """Return camera RGB [3] of D65, green 1; a matrix that makers of converters publish keeps its white."""
    seen = dict(cameras())[name] @ spectra.lamp("D65")
    return np.asarray(seen / seen[1])


class _Canvas:
    """Layers [H, W, 4, 3]: reflected light of the first and second light of the scene and of the lamp, and emission."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.layers = np.zeros((*size, 4, 3), np.float32)
        self.size = size

    def put(self, polygon: Float64, layers: Float64 | Image, *, soft: float = 0.0) -> Image | None:
        """Put a convex polygon [N, 2] on top: `layers` [4, 3], or [h, w, 4, 3] for its bounding box. Returns its cover."""
        fine = 4
        low = np.maximum(np.floor(polygon.min(axis=0)).astype(int) - 2, 0)
        high = np.minimum(np.ceil(polygon.max(axis=0)).astype(int) + 3, self.size[::-1])
        w, h = high - low
        if w <= 0 or h <= 0:
            return None
        cover = np.zeros((h * fine, w * fine), np.float32)
        points = (polygon - low + 0.5) * fine - 0.5
        cv2.fillConvexPoly(cover, np.round(points * 16).astype(np.int32), 1.0, shift=4)
        cover = cv2.resize(cover, (int(w), int(h)), interpolation=cv2.INTER_AREA)
        if soft:
            cover = np.asarray(cv2.GaussianBlur(cover, (0, 0), soft), np.float32)
        part = self.layers[low[1] : high[1], low[0] : high[0]]
        if layers.ndim == 4:
            layers = cv2.resize(
                np.asarray(layers, np.float32).reshape(*layers.shape[:2], 12),
                (int(w), int(h)),
                interpolation=cv2.INTER_LINEAR,
            ).reshape(h, w, 4, 3)
        part *= 1 - cover[..., None, None]
        part += cover[..., None, None] * np.asarray(layers, np.float32)
        whole = np.zeros(self.size, np.float32)
        whole[low[1] : high[1], low[0] : high[0]] = cover
        return whole


@dataclass(frozen=True, slots=True, eq=False)
class _Stage:
    """The camera and the lights of one scene, each light [81] scaled so that white in the first one is 1 in green."""

    rng: np.random.Generator
    camera: Float64
    lights: tuple[Float64, Float64, Float64]
    unit: float

    def seen(self, spectrum_of: Float64) -> Float64:
        return np.asarray(self.camera @ spectrum_of) / self.unit

    def reflecting(self, reflectance: Float64, gloss: float = 1.0) -> Float64:
        """Layers [4, 3] of a reflectance [81]."""
        rows = [self.seen(reflectance * light) * gloss for light in self.lights]
        return np.array([*rows, np.zeros(3)])

    def shining(self, emitted: Float64, reflectance: float = 0.05) -> Float64:
        layers = self.reflecting(np.full(81, reflectance))
        layers[3] = self.seen(emitted)
        return layers

    def paint(self) -> Float64:
        """A random measured reflectance [81]."""
        samples = _reflectances()
        return np.asarray(samples[int(self.rng.integers(len(samples)))])


@functools.cache
def _reflectances() -> Float64:
    chart = spectra.chart_reflectances()
    return np.concatenate([spectra.colour_samples(), chart, np.repeat(chart[18:23], 4, axis=0)])


def _quad(centre: Float64, width: float, height: float, turn: float) -> Float64:
    c, s = np.cos(turn), np.sin(turn)
    corners = 0.5 * np.array([[-width, -height], [width, -height], [width, height], [-width, height]])
    return np.asarray(centre + corners @ np.array([[c, s], [-s, c]]))


def _disc(centre: Float64, diameter: float, squash: float, turn: float) -> Float64:
    angle = np.linspace(0, 2 * np.pi, 28, endpoint=False)
    ring = 0.5 * diameter * np.stack([np.cos(angle), squash * np.sin(angle)], axis=1)
    c, s = np.cos(turn), np.sin(turn)
    return np.asarray(centre + ring @ np.array([[c, s], [-s, c]]))


def lamp_scene(seed: int, *, lamp: bool = True) -> LampScene:
    """Return the scene of a seed, with a D65 lamp or, with `lamp` off, with everything but it."""
    rng = np.random.default_rng([seed, 5 if lamp else 6])
    kind = str(rng.choice(KINDS)) if lamp else "none"
    size = (480, 720) if rng.random() < 0.8 else (720, 480)
    name, sensitivities = cameras()[int(rng.integers(len(cameras())))]
    first = str(rng.choice(SCENE_LIGHTS))
    second = str(rng.choice(SCENE_LIGHTS)) if rng.random() < 0.4 else first
    own = d65_lamp(rng)
    unit = float(sensitivities[1] @ spectrum(first))
    stage = _Stage(rng, sensitivities, (spectrum(first), spectrum(second), own), unit)
    canvas = _Canvas(size)
    across = float(np.exp(rng.uniform(np.log(120), np.log(300))))
    corners = _chart_place(rng, size, across)
    _furnish(stage, canvas, across)
    others = [] if lamp and rng.random() < 0.15 else _distract(stage, canvas, across, at_least=0 if lamp else 1)
    _draw_chart(stage, canvas, corners)
    shows = place = None
    facts: dict[str, float] = {"across": across}
    brightness, reach = 0.0, np.zeros(2)
    if lamp:
        shows, place, brightness, lamp_facts, reach = _draw_lamp(stage, canvas, kind, own, corners, across)
        facts |= lamp_facts
    radiance = _lit(stage, canvas, corners, reach, second != first, spill=brightness)
    radiance = _through_lens(rng, radiance)
    # The middle frame holds chart white at 0.3; the shortest of a good bracket is four stops down.
    lowest = -4 if kind != "clipped" else int(rng.choice([0, 0, 1]))
    stops = tuple(range(lowest, 4, 2))
    camera_lamp = stage.seen(own) * brightness
    clipped = 1.0
    if shows is not None:
        limit = 0.97 / (_EXPOSED * 2.0 ** stops[0])
        clipped = float((radiance[shows] > limit).any(axis=1).mean()) if shows.any() else 0.0
        facts |= {"clipped": clipped, "pixels": float(shows.sum())}
    readable = (
        shows is not None
        and facts["thin"] >= 7
        and facts["pixels"] >= 100
        and clipped <= 0.05
        and brightness >= 1.5
        and facts["behind"] <= 0.3
        and facts["gap"] > 0.02
    )
    camera_d65 = published_d65(name) * np.exp(rng.normal(0, _MATRIX_ERROR, 3))
    what = f"{kind}, {first}" + (f" and {second}" if second != first else "") + f", {name}"
    return LampScene(
        radiance, corners, shows, place, camera_lamp, stops, readable, camera_d65, what, tuple(others), facts
    )


def _chart_place(rng: np.random.Generator, size: tuple[int, int], across: float) -> Float64:
    turn = rng.normal(0, 0.12) + (np.pi / 2 if rng.random() < 0.1 else 0.0)
    box = (BOX - BOX.mean(axis=0)) / 16.75 * across
    box = box * np.array([np.cos(rng.uniform(0, 0.7)), np.cos(rng.uniform(0, 0.7))])
    keystone = 1 + rng.uniform(-0.06, 0.06) * box[:, :1] / across * 2
    c, s = np.cos(turn), np.sin(turn)
    box = box * keystone @ np.array([[c, s], [-s, c]])
    low, high = box.min(axis=0), box.max(axis=0)
    room = np.array(size[::-1]) - (high - low) - 24
    return np.asarray(box - low + 12 + rng.random(2) * np.maximum(room, 0))


def _furnish(stage: _Stage, canvas: _Canvas, across: float) -> None:
    rng, (height, width) = stage.rng, canvas.size
    canvas.layers[:] = stage.reflecting(stage.paint() * rng.uniform(0.3, 1.0))
    for _ in range(int(rng.integers(10, 60))):
        centre = rng.random(2) * (width, height)
        w, h = np.exp(rng.uniform(np.log(0.05), np.log(1.5), 2)) * across
        layers = stage.reflecting(stage.paint() * rng.uniform(0.3, 1.0), gloss=float(np.exp(rng.normal(0, 0.25))))
        canvas.put(_quad(centre, w, h, rng.uniform(0, np.pi)), layers)


def _draw_chart(stage: _Stage, canvas: _Canvas, corners: Float64) -> None:
    patches = spectra.chart_reflectances()
    border = 0.2 * float(np.hypot(*(corners[1] - corners[0])))
    low = np.maximum(np.floor(corners.min(axis=0) - border).astype(int), 0)
    high = np.minimum(np.ceil(corners.max(axis=0) + border).astype(int), canvas.size[::-1])
    part = canvas.layers[low[1] : high[1], low[0] : high[0]]
    for k, light in enumerate(stage.lights):
        colours = np.array([stage.seen(patch * light) for patch in patches])
        texture = chart_texture(colours, part=1.0, frame=0.04)
        shown, cover = warped(texture, corners - low, (part.shape[0], part.shape[1]))
        part[:, :, k] *= 1 - cover[..., None]
        part[:, :, k] += shown
        part[:, :, 3] *= (1 - cover[..., None]) if k == 0 else 1


def _distract(stage: _Stage, canvas: _Canvas, across: float, *, at_least: int) -> list[tuple[str, float, float]]:
    """Draw some of what might be taken for the lamp; the chart is drawn over them later."""
    rng, (height, width) = stage.rng, canvas.size
    drawn = []
    for _ in range(int(rng.integers(max(at_least, 1), 5))):
        kind = str(rng.choice(["window", "screen", "lamp", "glints", "paper", "paper", "pane"]))
        centre = rng.random(2) * (width, height)
        mm = across / CHART_MM * float(np.exp(rng.uniform(np.log(0.4), np.log(1.2))))
        drawn.append((kind, float(centre[0]), float(centre[1])))
        if kind in ("window", "pane"):
            # Windows are farther away than what stands on the table.
            _window(stage, canvas, centre, mm * float(rng.uniform(0.2, 0.7)), single=kind == "pane")
        elif kind == "screen":
            _screen(stage, canvas, centre, mm)
        elif kind == "lamp":
            shape = int(rng.integers(3))
            emitted = spectrum(str(rng.choice(LAMPS))) * float(np.exp(rng.uniform(np.log(4), np.log(80))))
            if shape == 0:
                outline = _disc(centre, rng.uniform(50, 130) * mm, rng.uniform(0.7, 1.0), rng.uniform(0, np.pi))
            elif shape == 1:
                outline = _quad(centre, rng.uniform(100, 600) * mm, rng.uniform(60, 300) * mm, rng.normal(0, 0.3))
            else:
                outline = _quad(centre, rng.uniform(300, 1200) * mm, rng.uniform(16, 38) * mm, rng.uniform(0, np.pi))
            canvas.put(outline, stage.shining(emitted, 0.5))
        elif kind == "glints":
            light = stage.lights[int(rng.integers(2))]
            for _ in range(int(rng.integers(2, 10))):
                place = centre + rng.normal(0, 0.3 * across, 2)
                bright = float(np.exp(rng.uniform(np.log(1.5), np.log(25))))
                outline = _disc(place, rng.uniform(3, 14), rng.uniform(0.3, 1.0), rng.uniform(0, np.pi))
                canvas.put(outline, stage.shining(light * bright), soft=float(rng.uniform(0.5, 1.5)))
        else:
            neutral = float(rng.uniform(0.8, 0.93)) * (1 - 0.06 * (spectra.WAVELENGTHS_NM < 430))
            layers = stage.reflecting(
                np.asarray(neutral, np.float64), gloss=float(np.exp(rng.uniform(np.log(0.5), np.log(1.5))))
            )
            side = float(rng.choice([74.0, 105.0, 210.0]))
            canvas.put(_quad(centre, side * mm, side * 1.414 * mm, rng.uniform(0, np.pi)), layers)
    return drawn


def _window(stage: _Stage, canvas: _Canvas, centre: Float64, mm: float, *, single: bool) -> None:
    rng = stage.rng
    columns, rows = (1, 1) if single else (int(rng.integers(1, 4)), int(rng.integers(1, 4)))
    pane = (rng.uniform(80, 400) if single else rng.uniform(250, 700), rng.uniform(120, 900))
    bright = float(np.exp(rng.uniform(np.log(2), np.log(50))))
    milky = rng.random() < 0.4
    sky, ground = spectrum(f"{rng.uniform(5000, 16000):.0f} K"), spectrum(f"{rng.uniform(5000, 7000):.0f} K")
    turn = rng.normal(0, 0.1)
    frame = stage.reflecting(np.full(81, rng.uniform(0.05, 0.85)))
    gap = rng.uniform(20, 60)
    canvas.put(_quad(centre, (columns * (pane[0] + gap) + gap) * mm, (rows * (pane[1] + gap) + gap) * mm, turn), frame)
    horizon = rng.uniform(0.2, 0.9)
    c, s = np.cos(turn), np.sin(turn)
    for j in range(rows):
        for i in range(columns):
            offset = np.array([(i - (columns - 1) / 2) * (pane[0] + gap), (j - (rows - 1) / 2) * (pane[1] + gap)]) * mm
            if milky:
                layers: Float64 | Image = stage.shining(sky * bright)
            else:
                high = int(np.clip((horizon * rows - j) * 16, 0, 16))
                layers = np.empty((16, 8, 4, 3), np.float32)
                for y in range(16):
                    for x in range(8):
                        below = ground * stage.paint() * rng.uniform(0.4, 1.2)
                        layers[y, x] = stage.shining((sky * (1 - 0.02 * y) if y < high else below) * bright)
            canvas.put(_quad(centre + offset @ np.array([[c, s], [-s, c]]), pane[0] * mm, pane[1] * mm, turn), layers)


def _screen(stage: _Stage, canvas: _Canvas, centre: Float64, mm: float) -> None:
    rng = stage.rng
    w, h = ((72, 150), (150, 230), (300, 190), (530, 300), (1000, 560))[int(rng.integers(5))]
    kelvin = float(rng.uniform(5500, 9500))
    primaries = [spectra.led(peak, width) for peak, width in ((450, 20.0), (535, 35.0), (620, 25.0))]
    xyz = np.array([spectra.xyz_of(part) for part in primaries])
    gains = np.maximum(np.linalg.solve(xyz.T, spectra.xyz_of(spectrum(f"{kelvin:.0f} K"))), 0)
    white = gains @ np.array(primaries) * float(np.exp(rng.uniform(np.log(0.6), np.log(6))))
    turn = rng.normal(0, 0.15)
    canvas.put(_quad(centre, (w + 14) * mm, (h + 14) * mm, turn), stage.reflecting(np.full(81, 0.04)))
    if rng.random() < 0.2:  # a blank page
        layers: Float64 | Image = stage.shining(white)
    else:
        blocks = np.kron(rng.random((4, 4, 3)) ** 1.5, np.ones((4, 4, 1)))
        blocks[rng.random((16, 16)) < 0.35] = 1.0
        parts = gains[:, None] * np.array(primaries) * (white.max() / (gains @ np.array(primaries)).max())
        layers = np.array([[stage.shining(texel[::-1] @ parts) for texel in line] for line in blocks], np.float32)
    canvas.put(_quad(centre, w * mm, h * mm, turn), layers)


def lamp_form(rng: np.random.Generator) -> tuple[float, float, bool]:
    """Return the sides in mm of some lamp, and whether it is a strip."""
    strip = bool(rng.random() < 0.5)
    return *_sides(rng, strip), strip


def _sides(rng: np.random.Generator, strip: bool) -> tuple[float, float]:
    if strip:
        return float(rng.uniform(8, 18)), float(rng.uniform(90, 320))
    thick = float(rng.uniform(25, 80))
    return thick, thick * float(rng.uniform(1.0, 1.8))


def _placed(
    stage: _Stage,
    canvas: _Canvas,
    form: tuple[float, float, bool, bool],
    before: npt.NDArray[np.float32],
    brightness: float,
    corners: Float64,
    across: float,
) -> Float64:
    """Return the outline of a lamp of a form (thickness, length, round, near the chart), in the picture and off the chart."""
    rng, (height, width) = stage.rng, canvas.size
    thick, long, round_one, near = form
    best = None
    # Who puts up a lamp does not put it before a window; one time in ten it happens all the same.
    careless = rng.random() < 0.1
    for _ in range(300):
        turn = rng.choice([0.0, np.pi / 2]) + rng.normal(0, 0.15) if rng.random() < 0.7 else rng.uniform(0, np.pi)
        outline = (
            _disc(np.zeros(2), thick, float(rng.uniform(0.75, 1.0)), turn)
            if round_one
            else _quad(np.zeros(2), thick, long, turn)
        )
        place = rng.random(2) * (width, height)
        if near:
            place = corners.mean(axis=0) + rng.normal(0, 0.75 * across, 2)
        there = outline + place
        gap = _gap(there, corners)
        if not careless and _shining(before, there) > 0.02 * brightness:
            continue
        inside = (there.min() > 4) and (there[:, 0] < width - 5).all() and (there[:, 1] < height - 5).all()
        if inside and gap > (0.03 if near else 0.6) * across and (not near or gap < 0.6 * across):
            best = there
            break
        if inside and gap > 0.03 * across and best is None:
            best = there
    return _quad(np.array([10 + thick / 2, 10 + thick / 2]), thick, thick, 0.0) if best is None else best


def _draw_lamp(
    stage: _Stage, canvas: _Canvas, kind: str, own: Float64, corners: Float64, across: float
) -> tuple[Mask, Mask, float, dict[str, float], Float64]:
    """Draw strip or module near or far from the chart; return the pixels that show it alone, its Y, facts, its place."""
    rng = stage.rng
    near = rng.random() < 0.6
    strip = rng.random() < 0.5
    mm = across / CHART_MM * (float(rng.uniform(0.85, 1.15)) if near else float(rng.uniform(0.6, 1.3)))
    thick, long = _sides(rng, strip)
    if kind == "small":
        shrink = float(rng.uniform(2.0, 5.0)) / (thick * mm)
        thick, long = thick * min(shrink, 1), max(long * min(shrink, 1), thick * min(shrink, 1))
    elif thick * mm < 8.5:
        # Lamps that the camera hardly resolves are a kind of their own.
        thick = 8.5 / mm
        long = max(long, thick)
    low, high = {"dim": (0.25, 1.2), "mixed": (0.8, 3.0), "clipped": (8.0, 40.0)}.get(kind, (1.6, 30.0))
    brightness = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    reflectance = float(rng.uniform(0.5, 0.8) if kind == "mixed" else rng.uniform(0.1, 0.6))
    round_one = not strip and rng.random() < 0.3
    before = np.ascontiguousarray(canvas.layers[:, :, 3, 1])
    best = _placed(stage, canvas, (thick * mm, long * mm, round_one, near), before, brightness, corners, across)
    fall = float(rng.uniform(0.0, 0.3))
    ripple = float(rng.uniform(0.0, 0.3)) if strip else 0.0
    bezel = float(rng.choice([0.0, rng.uniform(2, 12)])) * mm
    if bezel:
        centre = best.mean(axis=0)
        reach = np.hypot(*(best - centre).T).mean()
        canvas.put(
            centre + (best - centre) * (1 + bezel / reach), stage.reflecting(np.full(81, rng.uniform(0.03, 0.8)))
        )
    grid = 48
    y, x = (np.mgrid[:grid, :grid] + 0.5) / grid * 2 - 1
    along = y if strip else np.hypot(x, y) / np.sqrt(2)
    level = (1 - fall * along**2) * (1 + ripple * np.sin(along * rng.uniform(20, 60)))
    layers = np.tile(stage.reflecting(np.full(81, reflectance)), (grid, grid, 1, 1))
    layers[..., 3, :] = stage.seen(own) * (brightness * level / level.mean())[..., None]
    behind = _shining(before, best + 0.25 * (best - best.mean(axis=0)))
    cover = canvas.put(best, layers)
    assert cover is not None
    # What blur and demosaicing mix with the surround is not the lamp alone.
    shows = cv2.erode((cover > 0.999).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    long_px = float(np.hypot(*(best.max(axis=0) - best.min(axis=0))))
    facts = {
        "strip": float(strip),
        "Y": brightness,
        "reflectance": reflectance,
        "gap": _gap(best, corners) / across,
        "thick_mm": thick,
        "long_mm": min(long, thick) if round_one else long,
        "thin": min(thick * mm, long_px) * (0.75 if round_one else 1.0),
        "behind": behind / brightness,
    }
    return shows, cover > 0.5, brightness, facts, best.mean(axis=0)


def _shining(emission: npt.NDArray[np.float32], polygon: Float64) -> float:
    """The largest emission inside a polygon [N, 2]."""
    mask = np.zeros(emission.shape, np.uint8)
    cv2.fillConvexPoly(mask, np.round(polygon).astype(np.int32), 1)
    return float(emission[mask > 0].max(initial=0.0))


def _gap(one: Float64, other: Float64) -> float:
    """Distance of two convex outlines in pixels, negative where they meet."""
    hull = other.astype(np.float32).reshape(-1, 1, 2)
    own = one.astype(np.float32).reshape(-1, 1, 2)
    share = np.linspace(0, 1, 9)[:, None, None]
    border = (one * (1 - share) + np.roll(one, -1, 0) * share).reshape(-1, 2)
    distances = [-cv2.pointPolygonTest(hull, (float(x), float(y)), True) for x, y in border]
    distances += [-cv2.pointPolygonTest(own, (float(x), float(y)), True) for x, y in other]
    return float(min(distances))


def _lit(stage: _Stage, canvas: _Canvas, corners: Float64, lamp_at: Float64, mixed: bool, *, spill: float) -> Image:
    """Add up the layers under their lights: the first falls off over the picture, the second comes from a side."""
    rng, (height, width) = stage.rng, canvas.size
    y, x = np.mgrid[:height, :width].astype(np.float32)
    centre = corners.mean(axis=0)

    def slope(strength: float) -> Image:
        angle = rng.uniform(0, 2 * np.pi)
        along = ((x - centre[0]) * np.cos(angle) + (y - centre[1]) * np.sin(angle)) / width
        return np.asarray(np.exp(strength * along), np.float32)

    first = slope(float(rng.uniform(0, 0.8)))
    second = slope(float(rng.uniform(0, 2.0))) * (float(rng.uniform(0.02, 0.4)) if mixed else 0.0)
    image = (
        canvas.layers[:, :, 0] * first[..., None] + canvas.layers[:, :, 1] * second[..., None] + canvas.layers[:, :, 3]
    )
    if spill:
        away = np.hypot(x - lamp_at[0], y - lamp_at[1]) / width
        share = spill * float(rng.uniform(0, 0.05)) / (1 + (away / 0.05) ** 2)
        image += canvas.layers[:, :, 2] * share[..., None]
    return np.asarray(image, np.float32)


def _through_lens(rng: np.random.Generator, image: Image) -> Image:
    blurred = cv2.GaussianBlur(image, (0, 0), float(rng.uniform(0.4, 0.9)))
    small = cv2.resize(image, None, fx=0.125, fy=0.125, interpolation=cv2.INTER_AREA)
    veil = cv2.resize(cv2.GaussianBlur(small, (0, 0), 5.0), image.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    share = np.float32(rng.uniform(0.0, 0.01))
    return np.asarray((1 - share) * blurred + share * veil, np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class _Frame:
    info: FrameInfo
    counts: npt.NDArray[np.uint16]

    def mosaic(self) -> npt.NDArray[np.uint16]:
        return self.counts


def bracket(radiance: Image, stops: tuple[int, ...], *, seed: int) -> Iterator[_Frame]:
    """Yield Bayer frames of a radiance [H, W, 3], exposed by `stops` about the middle one, with noise and clipping."""
    rng = np.random.default_rng([seed, 7])
    height, width = radiance.shape[:2]
    mosaic = np.empty((height, width))
    for k, colour in enumerate("RGGB"):
        part = np.s_[k // 2 :: 2, k % 2 :: 2]
        mosaic[part] = radiance[..., "RGB".index(colour)][part]
    for n, stop in enumerate(stops):
        expected = np.clip(mosaic * _EXPOSED * 2.0**stop, 0, 2) * (WHITE - BLACK) * GAIN
        electrons = rng.poisson(expected) + READ_E * rng.standard_normal(mosaic.shape)
        counts = np.clip(np.rint(electrons / GAIN + BLACK), 0, WHITE).astype(np.uint16)
        info = FrameInfo(
            f"{n}.dng", Fraction(2) ** stop / 16, 100.0, 8.0, "Maker One", "", width, height, "RGGB", (BLACK,) * 4,
            (WHITE,) * 4, 14,
        )  # fmt: skip
        yield _Frame(info, counts)


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """What the pipeline makes of a scene before it looks for the lamp: corrected working RGB, chart corners, matrix."""

    image: Image
    corners: Float64
    matrix: Float64


def calibrated(scene: LampScene, *, seed: int, xyz_from_rgb: Float64) -> Calibrated:
    """Photograph a scene and take it through merge, demosaic, chart and correction; CalibrateError if one refuses."""
    from calibrate.chart import chart_from_corners, chart_reference, measure_patches
    from calibrate.correct import apply_matrix, fit_matrix
    from calibrate.demosaic import demosaic
    from calibrate.merge import measure_bracket, merge_mosaics

    frames: list[Any] = list(bracket(scene.radiance, scene.stops, seed=seed))
    merged = merge_mosaics(frames, measured=measure_bracket(frames))
    image = demosaic(merged.mosaic, merged.cfa)
    # The finder of charts has a benchmark of its own; its corners are off by a percent of the width or so.
    across = np.hypot(*(scene.corners[1] - scene.corners[0]))
    corners = scene.corners + np.random.default_rng([seed, 8]).normal(0, 0.004 * across, (4, 2))
    chart = chart_from_corners(corners)
    patches = measure_patches(image, chart.quads)
    fit = fit_matrix(
        patches.rgb,
        chart_reference("BabelColor Average"),
        rgb_from_xyz=np.asarray(np.linalg.inv(xyz_from_rgb), np.float64),
    )
    return Calibrated(apply_matrix(image, fit.matrix), corners, fit.matrix)
