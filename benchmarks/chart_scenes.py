"""Synthetic photographs with a ColorChecker somewhere, and others that only look as if there were one; all from a seed.

A scene is linear camera RGB [H, W, 3], float32, of arbitrary scale; what was clipped is NaN. The chart is that of measured
reflectances (BabelColor's average of thirty charts) before a measured camera under a measured lamp, seen through a
homography, with fall-off, glare, blur, noise and clipping. Corners are those of the box around the patches with one gap.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from calibrate.chart.geometry import CLASSIC, Layout

Float64 = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

_WAVELENGTHS_NM = np.arange(400, 701, 10)
_UNIT = 16.0  # texture pixels a chart unit: a patch is 40 pixels wide
_FRAME = 2.0  # the texture's border in chart units
BOX = np.array([[0, 0], [16.75, 0], [16.75, 11.25], [0, 11.25]])
LIGHTS = ("A", "D50", "D65", "D75", "FL2", "FL11", "LED-B1", "LED-B3", "LED-B5", "LED-RGB1", "2000 K")
KINDS_WITHOUT = (
    "textures",
    "swatches",
    "windows",
    "noise",
    "checkerboards",
    "partial charts",
    "covered charts",
    "shuffled charts",
    "clutter",
    "shelves",
)


@dataclass(frozen=True, slots=True)
class Scene:
    """A picture, the corners [4, 2] of its chart in pixels (None: there is none), and what was drawn."""

    image: Image
    corners: Float64 | None
    what: str
    facts: dict[str, float] = field(default_factory=dict)


@functools.cache
def _spectra() -> tuple[Float64, dict[str, Float64], tuple[Float64, ...]]:
    """Reflectances [24, N], lamps by name [N] and camera sensitivities [N, 3]."""
    import colour

    shape = colour.SpectralShape(400, 700, 10)

    def on_grid(distribution: object) -> Float64:
        return np.asarray(distribution.copy().align(shape).values, dtype=np.float64)  # type: ignore[attr-defined]

    patches = np.array([on_grid(patch) for patch in colour.SDS_COLOURCHECKERS["BabelColor Average"].values()])
    metres = _WAVELENGTHS_NM * 1e-9
    lamps = {"2000 K": metres**-5 / np.expm1(1.4388e-2 / (metres * 2000.0))}
    lamps |= {name: on_grid(colour.SDS_ILLUMINANTS[name]) for name in LIGHTS if name not in lamps}
    cameras = tuple(on_grid(sensitivities) for sensitivities in colour.MSDS_CAMERA_SENSITIVITIES.values())
    return patches, lamps, cameras


def patch_colours(light: str, camera: int, gains: Float64) -> Float64:
    """Return camera RGB [24, 3] of the patches; a perfect white has G = 1 before the `gains` [3]."""
    patches, lamps, cameras = _spectra()
    sensitivities = cameras[camera]
    colours = (patches * lamps[light]) @ sensitivities / (lamps[light] @ sensitivities[:, 1])
    return np.asarray(colours * gains)


def chart_texture(colours: Float64, *, part: float, frame: float, order: npt.NDArray[np.intp] | None = None) -> Image:
    """Return a drawing of the chart: `part` is how much of its place a patch fills, `frame` the frame's reflectance."""
    shown = colours if order is None else colours[order]
    return texture_of(shown, colours[18] / 0.9, CLASSIC, part=part * 2.5 / 2.75, frame=frame)


def texture_of(colours: Float64, white: Float64, layout: Layout, *, part: float, frame: float) -> Image:
    """Return a drawing of any chart: `part` is how much of the pitch a patch is wide; `frame` is in parts of `white` [3]."""
    wide, tall = (round((side + 2 * _FRAME) * _UNIT) for side in layout.box)
    texture = np.empty((tall, wide, 3), np.float32)
    texture[:] = frame * white
    first, half = layout.gap_width + layout.patch_width / 2 + _FRAME, 2.75 * part / 2
    for index in range(layout.count):
        x, y = first + 2.75 * (index % layout.columns), first + 2.75 * (index // layout.columns)
        left, right, top, bottom = (round(v * _UNIT) for v in (x - half, x + half, y - half, y + half))
        texture[top:bottom, left:right] = colours[index]
    return texture


def homography(source: Float64, destination: Float64) -> Float64:
    """Return the 3×3 map between two sets of four points [4, 2]."""
    return np.asarray(
        cv2.getPerspectiveTransform(source.astype(np.float32), destination.astype(np.float32)), dtype=np.float64
    )


def _posed(
    rng: np.random.Generator, size: tuple[int, int], across: float, tilt_deg: float, *, box: Float64 = BOX
) -> Float64:
    """Corners [4, 2] of a box seen in perspective: tilted about a random axis, turned by any angle, longest edge `across`."""
    axis, turn = rng.uniform(0, 2 * np.pi, 2)
    tilt = np.radians(tilt_deg)
    flat = (box - box.mean(axis=0)) / box[1, 0]
    points = np.column_stack([flat, np.zeros(4)])
    k = np.array([np.cos(axis), np.sin(axis), 0.0])
    points = points * np.cos(tilt) + np.cross(k, points) * np.sin(tilt) + np.outer(points @ k, k) * (1 - np.cos(tilt))
    distance = rng.uniform(1.6, 6.0)  # chart widths: how strong the perspective is
    seen = points[:, :2] / (distance + points[:, 2:]) * distance
    c, s = np.cos(turn), np.sin(turn)
    seen = seen @ np.array([[c, s], [-s, c]])
    edges = np.hypot(*(np.roll(seen, -1, 0) - seen).T)
    seen *= across / edges.max()
    low, high = seen.min(axis=0), seen.max(axis=0)
    room = np.array(size[::-1]) - (high - low)
    margin = np.minimum(0.06 * across + 4, 0.45 * np.maximum(room, 0))
    return np.asarray(seen - low + margin + rng.random(2) * np.maximum(room - 2 * margin, 0))


def scene_with_chart(seed: int) -> Scene:
    """Return the scene of a seed: size, pose, light, cast, exposure, blur, glare and unevenness all drawn from it."""
    rng = np.random.default_rng([seed, 1])
    height = int(rng.choice([480, 600, 800, 1067]))
    size = (height, height * 3 // 2) if rng.random() < 0.8 else (height * 3 // 2, height)
    largest = 0.72 * min(size)
    across = float(np.exp(rng.uniform(np.log(100.0), np.log(largest))))
    tilt = float(rng.uniform(0, 60))
    corners = _posed(rng, size, across, tilt)
    light = str(rng.choice(LIGHTS))
    camera = int(rng.integers(len(_spectra()[2])))
    gains = np.exp(rng.uniform(-0.7, 0.7, 3))
    colours = patch_colours(light, camera, gains)
    white = colours[18] / 0.9
    background = _background(rng, size) * white * np.exp(rng.uniform(-0.7, 0.7))
    texture = chart_texture(colours, part=float(rng.choice([1.0, 0.95, 0.88])), frame=float(rng.uniform(0.02, 0.06)))
    fall_off = float(rng.uniform(1.0, 3.0))
    glare = float(rng.choice([0.0, rng.uniform(0.02, 0.5)]))
    # The thinnest visible side of a patch, in pixels: the gaps are a tenth of a patch, and hardly seen
    # where the blur's sigma is as large as that: a gap between equal patches is then 38 % darker than they are, at 15 % of a
    # patch 26 %, and what is sampled of a patch, its central half, begins at 1.7 sigma from its edge instead of 2.5.
    sides = np.hypot(*(np.roll(corners, -1, 0) - corners).T) / np.array([6.1, 4.1, 6.1, 4.1])
    blur = float(rng.uniform(0.0, 0.1) * _thinnest(corners))
    image = _composed(rng, background, texture, corners, fall_off=fall_off, glare=glare, white=white)
    electrons = float(10 ** rng.uniform(3.0, 4.7))
    clip = float(rng.uniform(1.05, 20.0))
    exposure = float(10 ** rng.uniform(-4, 4))
    image = _photographed(rng, image, white, blur=blur, electrons=electrons, clip=clip) * np.float32(exposure)
    facts = {
        "across": across,
        "tilt": tilt,
        "blur": blur,
        "glare": glare,
        "fall_off": fall_off,
        "clip": clip,
        "electrons": electrons,
        "patch": float(sides.min()),
    }
    return Scene(image, corners, f"{light}, camera {camera}", facts)


def _thinnest(corners: Float64) -> float:
    """Pixels across a patch where it is thinnest, on average over the chart."""
    area = 0.5 * abs(float(np.linalg.det(np.stack([corners[2] - corners[0], corners[3] - corners[1]]))))
    longest = np.hypot(*(np.roll(corners, -1, 0) - corners).T).max()
    return float(min(area / longest / 4.1, area / longest / 6.1 * 16.75 / 11.25))


def _composed(
    rng: np.random.Generator,
    background: Image,
    texture: Image,
    corners: Float64,
    *,
    fall_off: float,
    glare: float,
    white: Float64,
    box: Float64 = BOX,
) -> Image:
    """Put the chart before the background, area-sampled, with its fall-off of light and a spot of glare."""
    height, width = texture.shape[:2]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    direction = rng.uniform(0, 2 * np.pi)
    along = (x / width - 0.5) * np.cos(direction) + (y / height - 0.5) * np.sin(direction)
    lit = texture * np.exp(np.log(fall_off) * along)[..., None].astype(np.float32)
    if glare > 0:
        cx, cy, radius = rng.uniform(0.1, 0.9) * width, rng.uniform(0.1, 0.9) * height, rng.uniform(15, 70)
        spot = np.exp(-0.5 * ((x - cx) ** 2 + (y - cy) ** 2) / radius**2)
        lit = lit + (glare * spot[..., None] * white).astype(np.float32)
    shown, cover = warped(lit, corners, background.shape[:2], box=box)
    return np.asarray(background * (1 - cover[..., None]) + shown, dtype=np.float32)


def warped(
    texture: Image, corners: Float64, size: tuple[int, int], *, frame: float = 1.0, box: Float64 = BOX
) -> tuple[Image, Image]:
    """Return a chart's texture as seen with its box at `corners`, and how much of each pixel it covers.

    `frame` chart units of the frame are shown around the box.
    """
    fine = 3
    cut = round((_FRAME - frame) * _UNIT)
    texture = texture[cut : texture.shape[0] - cut, cut : texture.shape[1] - cut]
    wide, tall = box[2]
    matrix = homography((box + frame) * _UNIT - 0.5, (corners + 0.5) * fine - 0.5)
    scale = np.sqrt(abs(np.linalg.det(matrix[:2, :2])))
    if scale < 1:  # averaging before shrinking
        texture = np.asarray(cv2.GaussianBlur(texture, (0, 0), 0.4 / max(scale, 1e-3)), dtype=np.float32)
    # Only where the chart is: the rest of the picture stays empty.
    outline = np.array([[-frame, -frame], [wide + frame, -frame], [wide + frame, tall + frame], [-frame, tall + frame]])
    lifted = np.column_stack([outline, np.ones(4)]) @ homography(box, corners).T
    reached = lifted[:, :2] / lifted[:, 2:]
    x0, y0 = np.clip(np.floor(reached.min(axis=0)).astype(int) - 2, 0, np.array(size[::-1]) - 1)
    x1, y1 = np.clip(np.ceil(reached.max(axis=0)).astype(int) + 3, [x0 + 1, y0 + 1], size[::-1])
    matrix = np.array([[1, 0, -fine * x0], [0, 1, -fine * y0], [0, 0, 1]], dtype=np.float64) @ matrix
    part = (x1 - x0, y1 - y0)
    shown, cover = np.zeros((*size, 3), np.float32), np.zeros(size, np.float32)
    for picture, into in ((texture, shown), (np.ones(texture.shape[:2], np.float32), cover)):
        big = cv2.warpPerspective(picture, matrix, (part[0] * fine, part[1] * fine))
        into[y0:y1, x0:x1] = cv2.resize(big, part, interpolation=cv2.INTER_AREA)
    return shown, cover


def _photographed(
    rng: np.random.Generator, image: Image, white: Float64, *, blur: float, electrons: float, clip: float
) -> Image:
    """Blur, photon and read noise for `electrons` at a white of G, and NaN from `clip` whites on."""
    if blur > 0.2:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), blur), dtype=np.float32)
    scale = electrons / white[1]
    noise = np.sqrt(np.maximum(image, 0) / scale + (3.0 / scale) ** 2) * rng.standard_normal(image.shape)
    noisy = (image + noise).astype(np.float32)
    noisy[(noisy > clip * white.max()).any(axis=2)] = np.nan
    return noisy


def _background(rng: np.random.Generator, size: tuple[int, int], kind: str | None = None) -> Image:
    """What stands behind the chart, relative to white: a wall with clutter, textures, windows or shelves."""
    kinds: dict[str, Callable[[np.random.Generator, tuple[int, int]], Image]] = {
        "clutter": _clutter,
        "textures": _textures,
        "windows": _windows,
        "shelves": _shelves,
    }
    return kinds[kind or str(rng.choice(list(kinds)))](rng, size)


def _clutter(rng: np.random.Generator, size: tuple[int, int]) -> Image:
    image = np.full((*size, 3), rng.uniform(0.1, 0.6), np.float32) * rng.uniform(0.7, 1, 3).astype(np.float32)
    for _ in range(int(rng.integers(20, 120))):
        centre, extent = rng.random(2) * size[::-1], np.exp(rng.uniform(np.log(6), np.log(min(size) / 3), 2))
        colour = rng.uniform(0.02, 0.8) * rng.uniform(0.3, 1.0, 3)
        if rng.random() < 0.2:
            cv2.circle(image, [int(v) for v in centre], int(extent[0] / 2), colour.tolist(), -1)
            continue
        points = cv2.boxPoints((centre.tolist(), extent.tolist(), float(rng.uniform(0, 180))))
        cv2.fillConvexPoly(image, points.astype(np.int32), colour.tolist())
    return np.asarray(image * _smooth_noise(rng, size, 0.4), np.float32)


def _smooth_noise(rng: np.random.Generator, size: tuple[int, int], strength: float, cells: int = 4) -> Image:
    coarse = rng.standard_normal((cells, cells)).astype(np.float32)
    return np.exp(strength * cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC))[..., None]


def _textures(rng: np.random.Generator, size: tuple[int, int]) -> Image:
    image = np.zeros((*size, 3), np.float32)
    for cells in (5, 15, 45, 130):
        layer = rng.standard_normal((cells, cells, 3)).astype(np.float32) * np.array([1, 0.8, 0.9], np.float32)
        image += cv2.resize(layer, size[::-1], interpolation=cv2.INTER_CUBIC) * rng.uniform(0.1, 0.5)
    if rng.random() < 0.5:  # cloth or brick
        y, x = np.mgrid[: size[0], : size[1]]
        period, angle = rng.uniform(8, 60), rng.uniform(0, np.pi)
        waves = np.sin(2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / period)
        waves = waves * np.sin(2 * np.pi * (y * np.cos(angle) - x * np.sin(angle)) / (period * rng.uniform(0.5, 2)))
        image += rng.uniform(0.2, 1.0) * waves[..., None].astype(np.float32)
    return np.asarray(0.25 * np.exp(image), np.float32)


def _grid(rng: np.random.Generator, image: Image, colours: Float64, *, gap: float, columns: int, rows: int) -> None:
    """Draw rows × columns cells in perspective into the image, over a ground of the last of `colours`."""
    unit = 40
    texture = np.empty((round((rows + gap) * unit), round((columns + gap) * unit), 3), np.float32)
    texture[:] = colours[-1]
    for row in range(rows):
        for column in range(columns):
            top, left = round((row + gap) * unit), round((column + gap) * unit)
            texture[top : round((row + 1) * unit), left : round((column + 1) * unit)] = colours[row * columns + column]
    size = image.shape[:2]
    across = float(rng.uniform(0.2, 0.7)) * min(size)
    corners = _posed(rng, size, across, float(rng.uniform(0, 50)))
    box = np.array([[0, 0], [texture.shape[1], 0], [texture.shape[1], texture.shape[0]], [0, texture.shape[0]]]) - 0.5
    matrix = homography(box.astype(np.float64), corners)
    shown = cv2.warpPerspective(texture, matrix, size[::-1], flags=cv2.INTER_AREA)
    cover = cv2.warpPerspective(np.ones(texture.shape[:2], np.float32), matrix, size[::-1])[..., None]
    image[:] = image * (1 - cover) + shown * cover


def _windows(rng: np.random.Generator, size: tuple[int, int]) -> Image:
    image = _clutter(rng, size)
    for _ in range(int(rng.integers(1, 4))):
        columns, rows = int(rng.integers(2, 8)), int(rng.integers(2, 7))
        panes = rng.uniform(0.8, 6.0) * rng.uniform(0.6, 1.0, (columns * rows, 3))
        _grid(rng, image, np.vstack([panes, 0.05 * np.ones(3)]), gap=rng.uniform(0.06, 0.3), columns=columns, rows=rows)
    return image


def _swatches(rng: np.random.Generator, size: tuple[int, int]) -> Image:
    image = _clutter(rng, size)
    for _ in range(int(rng.integers(1, 4))):
        columns, rows = (6, 4) if rng.random() < 0.5 else (int(rng.integers(3, 9)), int(rng.integers(3, 9)))
        cells = rng.uniform(0.03, 0.9, (columns * rows, 1)) * rng.uniform(0.05, 1.0, (columns * rows, 3))
        ground = rng.choice([0.03, 0.5, 0.9]) * np.ones(3)
        _grid(rng, image, np.vstack([cells, ground]), gap=rng.uniform(0.05, 0.3), columns=columns, rows=rows)
    return image


def _checkerboards(rng: np.random.Generator, size: tuple[int, int]) -> Image:
    image = _clutter(rng, size)
    for _ in range(int(rng.integers(1, 3))):
        columns, rows = int(rng.integers(4, 10)), int(rng.integers(4, 10))
        odd = (np.arange(columns * rows) % columns + np.arange(columns * rows) // columns) % 2
        cells = np.where(odd[:, None], rng.uniform(0.5, 0.9, 3), rng.uniform(0.03, 0.2, 3))
        _grid(rng, image, np.vstack([cells, cells[:1]]), gap=rng.choice([0.0, 0.08]), columns=columns, rows=rows)
    return image


def _shelves(rng: np.random.Generator, size: tuple[int, int]) -> Image:
    image = np.full((*size, 3), 0.15, np.float32)
    y = 4
    while y < size[0]:
        tall, x = int(rng.uniform(0.08, 0.3) * size[0]), 2
        while x < size[1]:
            wide = int(rng.uniform(0.01, 0.05) * size[1]) + 3
            colour = rng.uniform(0.03, 0.8) * rng.uniform(0.2, 1.0, 3)
            image[max(y + int(rng.uniform(0, 0.2) * tall), 0) : y + tall, x : x + wide - 2] = colour
            x += wide
        y += tall + int(0.02 * size[0]) + 3
    return np.asarray(image * _smooth_noise(rng, size, 0.4), np.float32)


def scene_without_chart(seed: int) -> Scene:
    """Return the scene of a seed without a whole chart: one of `KINDS_WITHOUT`, in turn."""
    rng = np.random.default_rng([seed, 2])
    kind = KINDS_WITHOUT[seed % len(KINDS_WITHOUT)]
    height = int(rng.choice([480, 600, 800]))
    size = (height, height * 3 // 2)
    light = str(rng.choice(LIGHTS))
    colours = patch_colours(light, int(rng.integers(len(_spectra()[2]))), np.exp(rng.uniform(-0.7, 0.7, 3)))
    white = colours[18] / 0.9
    if kind in ("textures", "windows", "clutter", "shelves"):
        image = _background(rng, size, kind)
    elif kind == "swatches":
        image = _swatches(rng, size)
    elif kind == "checkerboards":
        image = _checkerboards(rng, size)
    elif kind == "noise":
        cells = int(rng.choice([40, 100, 240]))
        noise = np.exp(rng.uniform(0.3, 1.2) * rng.standard_normal((cells, cells * 3 // 2, 3))).astype(np.float32)
        image = 0.3 * cv2.resize(noise, size[::-1], interpolation=int(rng.choice([cv2.INTER_NEAREST, cv2.INTER_CUBIC])))
    else:
        image = _background(rng, size)
    image = np.asarray(image * white, np.float32)
    if kind in ("partial charts", "covered charts", "shuffled charts"):
        image = _spoilt_chart(rng, image, colours, kind)
    image = _photographed(rng, image, white, blur=0.5, electrons=float(10 ** rng.uniform(3, 4.7)), clip=20.0)
    return Scene(image * np.float32(10 ** rng.uniform(-4, 4)), None, kind)


def _spoilt_chart(rng: np.random.Generator, image: Image, colours: Float64, kind: str) -> Image:
    """Add a chart that reaches out of the picture, is covered by something, or has its patches in another order."""
    size = image.shape[:2]
    order = rng.permutation(24) if kind == "shuffled charts" else None
    texture = chart_texture(colours, part=1.0, frame=0.04, order=order)
    across = float(rng.uniform(0.3, 0.7)) * min(size)
    corners = _posed(rng, size, across, float(rng.uniform(0, 40)))
    to_image = homography(BOX, corners)

    def at(points: list[list[float]]) -> Float64:
        lifted = np.column_stack([np.array(points), np.ones(len(points))]) @ to_image.T
        return np.asarray(lifted[:, :2] / lifted[:, 2:])

    if kind == "partial charts":
        # The middle of an edge column or row comes to lie on the picture's border.
        cut = at([[[1.5, 5.6], [15.25, 5.6], [8.4, 1.5], [8.4, 9.75]][int(rng.integers(4))]])[0]
        middle = at([[8.4, 5.6]])[0]
        away = cut - middle
        if abs(away[0]) > abs(away[1]):
            corners[:, 0] += (size[1] - 1 if away[0] > 0 else 0) - cut[0]
        else:
            corners[:, 1] += (size[0] - 1 if away[1] > 0 else 0) - cut[1]
    shown, cover = warped(texture, corners, size)
    image = np.asarray(image * (1 - cover[..., None]) + shown, np.float32)
    if kind == "covered charts":
        x0, y0 = float(rng.choice([-1.0, 11.3])), -1.0
        cover_quad = [[x0, y0], [x0 + 6.6, y0], [x0 + 6.6, 12.5], [x0, 12.5]]
        if rng.random() < 0.5:
            y0 = float(rng.choice([-1.0, 8.5]))
            cover_quad = [[-1, y0], [18, y0], [18, y0 + 3.8], [-1, y0 + 3.8]]
        paint = (rng.uniform(0.05, 0.7, 3) * colours[18]).tolist()
        cv2.fillConvexPoly(image, np.round(at(cover_quad)).astype(np.int32), paint, cv2.LINE_AA)
    return image


def _directions(u: npt.NDArray[Any], v: npt.NDArray[Any], size: tuple[int, int]) -> Float64:
    """The unit directions [..., 3] of pixels (u, v) of a lat-long map of `size` (H, W)."""
    phi, theta = 2 * np.pi * ((u + 0.5) / size[1] - 0.5), np.pi * (v + 0.5) / size[0]
    return np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], -1)


def map_with_chart(seed: int, *, width: int = 1280) -> Scene:
    """Return a lat-long map with a chart 10°–40° wide in any direction, poles and seam included; corners as in the map."""
    rng = np.random.default_rng([seed, 3])
    size = (width // 2, width)
    colours = patch_colours(str(rng.choice(LIGHTS)), 0, np.exp(rng.uniform(-0.5, 0.5, 3)))
    white = colours[18] / 0.9
    image = np.asarray(_background(rng, size, str(rng.choice(["clutter", "textures", "shelves"]))) * white, np.float32)
    degrees = float(np.exp(rng.uniform(np.log(10), np.log(40))))
    # In turn: towards a pole, across the seam, anywhere.
    pitch = (float(rng.choice([-1, 1]) * rng.uniform(60, 90)), float(rng.uniform(-50, 50)), float(rng.uniform(-60, 60)))
    yaw = (float(rng.uniform(-180, 180)), float(180 + rng.uniform(-5, 5)), float(rng.uniform(-180, 180)))
    a, b = np.radians([yaw[seed % 3], pitch[seed % 3]])
    roll, tilt = np.radians([rng.uniform(0, 360), rng.uniform(0, 40)])
    forward = np.array([np.cos(b) * np.sin(a), np.sin(b), -np.cos(b) * np.cos(a)])
    right = np.array([np.cos(a), 0.0, np.sin(a)])
    down = -np.cross(right, forward)
    right, down = np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right
    right, normal = np.cos(tilt) * right + np.sin(tilt) * forward, np.cos(tilt) * forward - np.sin(tilt) * right
    scale = 2 * np.tan(np.radians(degrees) / 2) / 16.75
    origin = forward - scale * (16.75 / 2 * right + 11.25 / 2 * down)
    texture = chart_texture(colours, part=1.0, frame=0.04)
    cut = round((_FRAME - 1.0) * _UNIT)
    texture = texture[cut:-cut, cut:-cut]
    total, cover = np.zeros((*size, 3), np.float32), np.zeros(size, np.float32)
    fine = 4
    reach = 0.75 * np.radians(degrees) + 0.1  # beyond the frame's corners
    v, u = np.mgrid[: size[0], : size[1]]
    near = _directions(u, v, size) @ forward > np.cos(reach)
    # Rows of 64: remap knows no longer ones than 32767.
    v, u = (np.pad(each[near], (0, -int(near.sum()) % 64), mode="edge").reshape(-1, 64) for each in (v, u))
    counted = slice(0, int(near.sum()))
    for dy in (np.arange(fine) + 0.5) / fine - 0.5:
        for dx in (np.arange(fine) + 0.5) / fine - 0.5:
            d = _directions(u + dx, v + dy, size)
            along = d @ normal
            with np.errstate(divide="ignore", invalid="ignore"):
                point = d * ((origin @ normal) / along)[..., None] - origin
            at = np.stack([point @ right, point @ down], -1) / scale
            at = (np.where(along[..., None] > 1e-6, at, -1e3) + 1.0) * _UNIT - 0.5
            at32 = np.clip(at, -1e4, 1e4).astype(np.float32)
            shown = cv2.remap(texture, at32[..., 0], at32[..., 1], cv2.INTER_LINEAR)
            covered = cv2.remap(np.ones(texture.shape[:2], np.float32), at32[..., 0], at32[..., 1], cv2.INTER_LINEAR)
            total[near] += shown.reshape(-1, 3)[counted]
            cover[near] += covered.ravel()[counted]
    image = np.asarray(image * (1 - cover / fine**2)[..., None] + total / fine**2, np.float32)
    corners = []
    for x, y in BOX:
        p = origin + scale * (x * right + y * down)
        p = p / np.linalg.norm(p)
        corners.append(
            [(np.arctan2(p[0], -p[2]) / (2 * np.pi) + 0.5) * width - 0.5, np.arccos(p[1]) / np.pi * size[0] - 0.5]
        )
    image = _photographed(rng, image, white, blur=0.4, electrons=1e4, clip=20.0)
    facts = {"degrees": degrees, "pitch": pitch[seed % 3], "yaw": yaw[seed % 3], "tilt": float(np.degrees(tilt))}
    return Scene(image, np.array(corners), ("pole", "seam", "anywhere")[seed % 3], facts)
