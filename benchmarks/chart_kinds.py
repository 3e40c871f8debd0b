"""Scenes with other charts than one Classic: the Digital SG, the Passport opened, charts of other proportions, and several.

As in `chart_scenes`. An SG has published colours only, no reflectances: the reflectance of a patch is here the likeliest one of
its published colour under D50, by the mean and covariance of measured reflectances. So it is a real surface, and seen by a
real camera under a real lamp it is as hard to fit as one.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from benchmarks.chart_scenes import (
    BOX,
    LIGHTS,
    Float64,
    Image,
    Scene,
    _background,
    _composed,
    _photographed,
    _posed,
    _spectra,
    _thinnest,
    homography,
    patch_colours,
    texture_of,
)
from calibrate.chart import CLASSIC, SG

_NM = np.arange(400, 701, 10)
#: Patch over pitch: Passport (ArgyllCMS, ref/ColorCheckerPassport.cht), and wider and narrower gaps than any edition has.
PASSPORT = 12.4 / 15.0
PARTS = (PASSPORT, 0.75, 0.92)
#: The other page of a Passport, 62 mm to the left of its first column: patches (x, y, side) in mm from there, and reflectances.
_PAGE_MM = ((13.5, 10.0, 12.9, 8), (26.4, 13.4, 16.0, 5), (42.5, 13.4, 16.0, 5), (58.6, 10.0, 12.9, 8))


@functools.cache
def sg_reflectances() -> Float64:
    """Return reflectances [140, 31] at 400, 410 … 700 nm that have the published colours under D50."""
    import colour

    from calibrate.trained import training_reflectances

    shape = colour.SpectralShape(400, 700, 10)
    eye = np.asarray(colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values)
    light = np.asarray(colour.SDS_ILLUMINANTS["D50"].copy().align(shape).values)
    seen = (eye * light[:, None]).T / (light @ eye[:, 1])
    published = colour.CCS_COLOURCHECKERS["ColorCheckerSG - After November 2014"].data.values()
    xyz = np.array([colour.xyY_to_XYZ(value) for value in published])
    known = training_reflectances(_NM.astype(np.float64))
    # In the logarithm no reflectance is negative; a few steps of Gauss and Newton make the colours right.
    logs = np.log(np.maximum(known, 1e-3))
    mean, spread = logs.mean(axis=0), np.cov(logs.T) + 1e-4 * np.eye(len(_NM))
    out = np.empty((len(xyz), len(_NM)))
    for k, wanted in enumerate(xyz):
        at = mean + np.log(wanted[1] / (seen[1] @ np.exp(mean)))
        start = at.copy()
        for _ in range(30):
            slope = seen * np.exp(at)
            rest = wanted - slope.sum(axis=1) + slope @ (at - start)
            at = start + spread @ slope.T @ np.linalg.solve(slope @ spread @ slope.T + 1e-12 * np.eye(3), rest)
        out[k] = np.minimum(np.exp(at), 1.0)
    return out


def sg_colours(light: str, camera: int, gains: Float64) -> Float64:
    """Return camera RGB [140, 3] of an SG's patches; a perfect white has G = 1 before the `gains` [3]."""
    _, lamps, cameras = _spectra()
    sensitivities = cameras[camera]
    return np.asarray((sg_reflectances() * lamps[light]) @ sensitivities / (lamps[light] @ sensitivities[:, 1]) * gains)


def scene_with_sg(seed: int) -> Scene:
    """Return a photograph of an SG, at least 300 pixels across, tilted by up to 50°; the rest as `scene_with_chart`."""
    rng = np.random.default_rng([seed, 4])
    height = int(rng.choice([600, 800, 1067]))
    size = (height, height * 3 // 2)
    width, tall = SG.box
    box = np.array([[0, 0], [width, 0], [width, tall], [0, tall]])
    across, tilt = float(np.exp(rng.uniform(np.log(300.0), np.log(0.85 * height)))), float(rng.uniform(0, 50))
    corners = _posed(rng, size, across, tilt, box=box)
    light, camera = str(rng.choice(LIGHTS)), int(rng.integers(len(_spectra()[2])))
    colours = sg_colours(light, camera, np.exp(rng.uniform(-0.7, 0.7, 3)))
    white = colours[SG.white_patch] / 0.88
    background = _background(rng, size) * white * np.exp(rng.uniform(-0.7, 0.7))
    texture = texture_of(colours, white, SG, part=SG.patch_width / 2.75, frame=float(rng.uniform(0.01, 0.04)))
    fall_off, glare = float(rng.uniform(1.0, 2.5)), float(rng.choice([0.0, rng.uniform(0.02, 0.4)]))
    # A gap of an SG is a fifth of its patch: blurred by less than half of that, it is seen.
    blur = float(rng.uniform(0.0, 0.1) * _thinnest(corners) * 6.1 / 14.2)
    image = _composed(rng, background, texture, corners, fall_off=fall_off, glare=glare, white=white, box=box)
    clip, electrons = float(rng.uniform(1.05, 20.0)), float(10 ** rng.uniform(3.0, 4.7))
    image = _photographed(rng, image, white, blur=blur, electrons=electrons, clip=clip)
    facts = {"across": across, "tilt": tilt, "blur": blur, "glare": glare, "fall_off": fall_off, "clip": clip}
    return Scene(image * np.float32(10 ** rng.uniform(-4, 4)), corners, f"SG, {light}, camera {camera}", facts)


def scene_with_passport(seed: int) -> Scene:
    """Return a photograph of a chart of other proportions; of every third, a Passport, its other page lies beside it."""
    rng = np.random.default_rng([seed, 5])
    height = int(rng.choice([480, 600, 800, 1067]))
    size = (height, height * 3 // 2)
    across, tilt = float(np.exp(rng.uniform(np.log(100.0), np.log(0.5 * height)))), float(rng.uniform(0, 50))
    corners = _posed(rng, size, across, tilt)
    light, camera = str(rng.choice(LIGHTS)), int(rng.integers(len(_spectra()[2])))
    gains = np.exp(rng.uniform(-0.7, 0.7, 3))
    colours = patch_colours(light, camera, gains)
    white = colours[18] / 0.9
    background = _background(rng, size) * white * np.exp(rng.uniform(-0.7, 0.7))
    part = PARTS[seed % len(PARTS)]
    texture = texture_of(colours, white, CLASSIC, part=part, frame=float(rng.uniform(0.02, 0.06)))
    if part == PASSPORT:
        background = _with_page(background, corners, rng, white)
    fall_off, glare = float(rng.uniform(1.0, 2.5)), float(rng.choice([0.0, rng.uniform(0.02, 0.4)]))
    blur = float(rng.uniform(0.0, 0.1) * _thinnest(corners))
    image = _composed(rng, background, texture, corners, fall_off=fall_off, glare=glare, white=white)
    clip, electrons = float(rng.uniform(1.05, 20.0)), float(10 ** rng.uniform(3.0, 4.7))
    image = _photographed(rng, image, white, blur=blur, electrons=electrons, clip=clip)
    facts = {"across": across, "tilt": tilt, "blur": blur, "glare": glare, "part": part}
    return Scene(image * np.float32(10 ** rng.uniform(-4, 4)), corners, f"part {part:.2f}, {light}", facts)


def _with_page(background: Image, corners: Float64, rng: np.random.Generator, white: Float64) -> Image:
    """Draw the rows of patches of a Passport's other page beside the chart, as far as they are in the picture."""
    import cv2

    unit = 2.75 / 15.0  # chart units a mm
    # Above the chart's first row, whose first patch begins at (0.25, 0.25).
    to_image = homography(BOX, corners)
    out = np.ascontiguousarray(background, dtype=np.float32)
    black = (0.04 * white).tolist()

    def polygon(x0: float, y0: float, x1: float, y1: float) -> Float64:
        lifted = np.array([[x0, y0, 1], [x1, y0, 1], [x1, y1, 1], [x0, y1, 1]]) @ to_image.T
        return np.asarray(lifted[:, :2] / lifted[:, 2:])

    top = 0.25 - (98.5 - 13.5) * unit
    for x0, y0, x1, y1, colour in [
        (-0.6, top - 0.6, 17.3, top + 58 * unit, black),
        *(
            (
                0.5 + k * step * unit,
                top + (y - 13.5) * unit,
                0.5 + (k * step + side) * unit,
                top + (y - 13.5 + side) * unit,
                (
                    rng.uniform(0.05, 0.75) * (white if count == 5 or y > 50 else white * rng.uniform(0.3, 1.0, 3))
                ).tolist(),
            )
            for y, side, step, count in _PAGE_MM
            for k in range(count)
        ),
    ]:
        points = polygon(x0, y0, x1, y1)
        if np.abs(points).max() < 4000:
            cv2.fillConvexPoly(out, np.round(points).astype(np.int32), colour, cv2.LINE_AA)
    return out


@dataclass(frozen=True, slots=True)
class Several:
    """A picture with two charts: their corners [2, 4, 2], the larger first, and whether both stand in one light."""

    image: Image
    corners: Float64
    one_light: bool
    what: str


def scene_with_two(seed: int) -> Several:
    """Return a photograph of two Classics, the smaller at least half as wide, side by side in one light or in two."""
    rng = np.random.default_rng([seed, 6])
    size = (800, 1200)
    half = (size[0], size[1] // 2)
    camera = int(rng.integers(len(_spectra()[2])))
    gains = np.exp(rng.uniform(-0.7, 0.7, 3))
    one_light = seed % 2 == 0
    lights = [str(v) for v in rng.choice(LIGHTS, 2, replace=False)]
    if one_light:
        lights[1] = lights[0]
    across = float(rng.uniform(220, 480))
    image, places = np.zeros((*size, 3), np.float32), []
    reading = patch_colours(lights[0], camera, gains)
    white = reading[18] / 0.9
    for k, wide in enumerate((across, across * float(rng.uniform(0.5, 0.9)))):
        corners = _posed(rng, half, wide, float(rng.uniform(0, 40)))
        level = float(np.exp(rng.uniform(-0.7, 0.7))) if k else 1.0
        colours = patch_colours(lights[k], camera, gains) * level
        own = colours[18] / 0.9
        texture = texture_of(colours, own, CLASSIC, part=2.5 / 2.75, frame=0.04)
        background = _background(rng, half, "clutter") * own
        part = _composed(rng, background, texture, corners, fall_off=1.2, glare=0.0, white=own)
        image[:, k * half[1] : (k + 1) * half[1]] = part
        places.append(corners + np.array([k * half[1], 0]))
    image = _photographed(rng, image, white, blur=float(rng.uniform(0, 1)), electrons=1e4, clip=20.0)
    return Several(image, np.array(places), one_light, " and ".join(lights))
