"""Places to photograph: a furnished room lit by several lamps, and a furnace of constant radiance.

Everything stands at metres in a world whose +Y is up; the camera of a lat-long view looks along −Z in the
middle of its map. Surfaces have measured reflectances, lamps measured spectra (`samples.spectra`); how light
travels is told in `samples.transport`.

    room = Room()                                   # the room of the shipped capture
    view = look(room, LatLong(512))                 # geometry and transport, cached
    rgb = view.response(camera.responses)           # [H, W, 3]
    rgb = view.response(camera.responses, spectra=other_lamps)   # the same room in another light: cheap
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache, lru_cache
from typing import Protocol

import numpy as np
import numpy.typing as npt

from samples import spectra, transport

Float64 = npt.NDArray[np.float64]
Float32 = npt.NDArray[np.float32]

# Of the ColorChecker Classic: the board, 8.5 × 11 inches, and the box around its patches with a margin of one
# gap, which is what OpenCV's mcc reports as the chart.
BOARD_M = (0.2794, 0.2159)
CHART_BOX_M = (
    6 * transport.PATCH_M + 7 * transport.GAP_M,
    4 * transport.PATCH_M + 5 * transport.GAP_M,
)


@dataclass(frozen=True, slots=True)
class Lamp:
    """A lamp: a "panel" that shines through its `size` (width, depth in metres), or a "globe" of that radius.

    `centre` in metres; `luminance` in cd/m²; `spectrum` as `samples.spectra.lamp` names it. A panel faces
    down; a globe stands on a pole.
    """

    name: str
    spectrum: str
    shape: str
    centre: tuple[float, float, float]
    size: tuple[float, ...]
    luminance: float


@dataclass(frozen=True, slots=True)
class Chart:
    """Where the chart stands, seen from the camera, and how it is turned away from facing it.

    `yaw_deg` turns its right edge away, `pitch_deg` leans its top back, `roll_deg` turns it clockwise.
    """

    azimuth_deg: float = 13.0
    elevation_deg: float = -9.0
    distance_m: float = 0.37
    yaw_deg: float = -6.0
    pitch_deg: float = 7.0
    roll_deg: float = 1.5
    reflectances: str = spectra.CHART_SPECTRA


@dataclass(frozen=True, slots=True)
class Module:
    """The D65 lamp: an upright strip beside the chart, in its plane, `size_m` wide and high, in cd/m²."""

    luminance: float = 250.0
    size_m: tuple[float, float] = (0.015, 0.120)
    gap_m: float = 0.022
    spectrum: str = "D65 module"


CEILING = Lamp("ceiling panel", "LED-B4", "panel", (1.0, 2.585, 0.90), (1.2, 0.6), 4000.0)
STANDING = Lamp("standing globe", "A", "globe", (-1.93, 1.43, -1.42), (0.14,), 5600.0)
TUBE = Lamp("tube", "FL2", "panel", (1.9, 1.95, -2.2), (0.9, 0.08), 5000.0)
TWO_LAMPS = (CEILING, STANDING)
THREE_LAMPS = (CEILING, STANDING, TUBE)


@dataclass(frozen=True, slots=True)
class Room:
    """A room of 5.3 × 2.6 × 4.7 m. `seed` chooses colours and shifts things and lamps by some centimetres.

    `bounces` of indirect light; `grey`, if given, is the albedo of every surface but the chart (for energy
    checks).
    """

    seed: int = 0
    lamps: tuple[Lamp, ...] = TWO_LAMPS
    chart: Chart | None = field(default_factory=Chart)
    module: Module | None = field(default_factory=Module)
    furniture: bool = True
    bounces: int = 3
    grey: float | None = None


@dataclass(frozen=True, slots=True)
class Furnace:
    """A place whose every direction has the same radiance: a chart in it reads exactly its reflectances."""

    spectrum: str = "D65"
    luminance: float = 80.0
    chart: Chart | None = None
    module: Module | None = None


class Projection(Protocol):
    """A way to map directions to pixels; the centre of pixel (x, y) is at (x, y)."""

    width: int
    height: int

    def directions(self, sub: int) -> Float64:
        """Return unit directions, shape (height · width, sub², 3), of the sub-rays of every pixel."""

    def pixels(self, directions: Float64) -> Float64:
        """Return (x, y), shape (..., 2), of directions of shape (..., 3)."""


@dataclass(frozen=True, slots=True)
class LatLong:
    """The whole sphere on a map twice as wide as high; the centre looks along −Z, the top row at +Y."""

    width: int
    height: int = 0

    def __post_init__(self) -> None:
        if self.height == 0:
            object.__setattr__(self, "height", self.width // 2)

    def directions(self, sub: int) -> Float64:
        """Return unit directions, shape (height · width, sub², 3)."""
        x, y = _sub_pixels(self.width, self.height, sub)
        longitude = 2.0 * np.pi * ((x + 0.5) / self.width - 0.5)
        polar = np.pi * (y + 0.5) / self.height
        sine = np.sin(polar)
        return np.stack([sine * np.sin(longitude), np.cos(polar), -sine * np.cos(longitude)], axis=-1)

    def pixels(self, directions: Float64) -> Float64:
        """Return (x, y), shape (..., 2), of directions of shape (..., 3)."""
        d = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
        u = np.arctan2(d[..., 0], -d[..., 2]) / (2.0 * np.pi) + 0.5
        v = np.arccos(np.clip(d[..., 1], -1.0, 1.0)) / np.pi
        return np.stack([u * self.width - 0.5, v * self.height - 0.5], axis=-1)


@dataclass(frozen=True, slots=True)
class Pinhole:
    """A flat perspective view towards (azimuth, elevation); `fov_deg` is the angle across the width."""

    width: int
    height: int
    fov_deg: float = 60.0
    azimuth_deg: float = 0.0
    elevation_deg: float = 0.0

    def _frame(self) -> tuple[Float64, float]:
        axis = direction(self.azimuth_deg, self.elevation_deg)
        return facing(axis), 0.5 * self.width / np.tan(np.radians(self.fov_deg) / 2.0)

    def directions(self, sub: int) -> Float64:
        """Return unit directions, shape (height · width, sub², 3)."""
        frame, focal = self._frame()
        x, y = _sub_pixels(self.width, self.height, sub)
        a = (x - 0.5 * (self.width - 1))[..., None] / focal
        b = (0.5 * (self.height - 1) - y)[..., None] / focal
        rays: Float64 = a * frame[0] + b * frame[1] - frame[2]
        return rays / np.sqrt((rays * rays).sum(axis=-1, keepdims=True))

    def pixels(self, directions: Float64) -> Float64:
        """Return (x, y), shape (..., 2), of directions of shape (..., 3) in front of the camera."""
        frame, focal = self._frame()
        local = np.einsum("...i,ji->...j", directions, frame)
        x = 0.5 * (self.width - 1) + focal * local[..., 0] / -local[..., 2]
        y = 0.5 * (self.height - 1) - focal * local[..., 1] / -local[..., 2]
        return np.stack([x, y], axis=-1)


def _sub_pixels(width: int, height: int, sub: int) -> tuple[Float64, Float64]:
    """Return x and y, shape (height · width, sub²), of a grid of sub × sub places in every pixel."""
    offsets = (np.arange(sub) + 0.5) / sub - 0.5
    y, x, j, i = np.meshgrid(np.arange(height), np.arange(width), offsets, offsets, indexing="ij")
    return (x + i).reshape(-1, sub * sub), (y + j).reshape(-1, sub * sub)


def direction(azimuth_deg: float, elevation_deg: float) -> Float64:
    """Return the unit vector at an azimuth (0 = −Z, 90 = +X) and an elevation."""
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    return np.array([np.cos(e) * np.sin(a), np.sin(e), -np.cos(e) * np.cos(a)])


def facing(axis: Float64) -> Float64:
    """Return the rows right, up, forward of a plate that faces a viewer who looks along `axis`."""
    right = np.cross(axis, [0.0, 1.0, 0.0])
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(right, axis), -axis])


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A built place: geometry, `reflectances` (M, 81), the camera's `origin`, and what shines in it.

    `emission` (E, 81) is the spectral radiance of the emitters: the lamps, then the module if there is one.
    `chart_corners` (4, 3) TL, TR, BR, BL of the chart's box and `patch_corners` (24, 4, 3), in metres, or None.
    """

    geometry: transport.Geometry
    reflectances: Float64
    emission: Float64
    emitters: tuple[str, ...]
    lamps: int
    origin: Float64
    bounces: int
    chart_corners: Float64 | None
    patch_corners: Float64 | None


class _Builder:
    """Collects boxes, spheres and materials."""

    def __init__(self, grey: float | None) -> None:
        self.grey = grey
        self.materials: list[Float64] = []
        self.known: dict[object, int] = {}
        self.boxes: list[tuple[Float64, Float64, Float64, list[int], int]] = []
        self.textures: dict[tuple[int, int], tuple[int, int, float]] = {}
        self.spheres: list[tuple[Float64, float, int]] = []

    def material(self, sample: int | str) -> int:
        """Return the index of colour sample CES `sample`, or of a patch of the chart's spectra by name."""
        if sample not in self.known:
            if isinstance(sample, str):
                values = spectra.chart_reflectances()[PATCHES[sample]]
            else:
                values = spectra.colour_samples()[sample - 1]
            self.known[sample] = len(self.materials)
            self.materials.append(values if self.grey is None else np.full_like(values, self.grey))
        return self.known[sample]

    def box(
        self, centre: tuple[float, float, float] | Float64, half: tuple[float, float, float],
        material: int, *, axes: Float64 | None = None, turn_deg: float = 0.0, grid: int = 1,
    ) -> int:  # fmt: skip
        """Add a box and return its index; `turn_deg` about the vertical."""
        if axes is None:
            c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
            axes = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
        self.boxes.append((np.asarray(centre, float), axes, np.asarray(half, float), [material] * 6, grid))
        return len(self.boxes) - 1

    def texture(self, box: int, faces: tuple[int, ...], kind: int, other: int, period: float) -> None:
        for face in faces:
            self.textures[box, face] = (kind, other, period)

    def sphere(self, centre: tuple[float, float, float], radius: float, material: int) -> int:
        """Add a sphere and return its index."""
        self.spheres.append((np.asarray(centre, float), radius, material))
        return len(self.spheres) - 1

    def geometry(self, *, indoors: bool, lamps: list[tuple[int, str, int]]) -> transport.Geometry:
        """Return the arrays; `lamps` are (kind, "box" or "sphere" or "", index)."""
        count = len(self.boxes)
        faces = np.zeros((count, 6, 4), np.int32)
        periods = np.ones((count, 6))
        boxes = np.zeros((count, 16))
        node = 0
        for i, (centre, axes, half, materials, grid) in enumerate(self.boxes):
            boxes[i] = [*centre, *axes.ravel(), *half, np.sqrt((half * half).sum())]
            for face in range(6):
                faces[i, face] = [materials[face], transport.PLAIN, 0, node]
                node += grid * grid
        for (i, face), (kind, other, metres) in self.textures.items():
            faces[i, face, 1:3] = kind, other
            periods[i, face] = metres
        spheres = [[*centre, radius] for centre, radius, _ in self.spheres]
        codes = [[material, node + 6 * i] for i, (_, _, material) in enumerate(self.spheres)]
        return transport.Geometry(
            indoors=indoors,
            boxes=boxes,
            faces=faces,
            periods=periods,
            grids=np.array([grid for *_, grid in self.boxes], np.int32),
            spheres=np.array(spheres, float).reshape(-1, 4),
            sphere_codes=np.array(codes, np.int32).reshape(-1, 2),
            lamps=np.array([(kind, count + i if form == "sphere" else i) for kind, form, i in lamps], np.int32).reshape(
                -1, 2
            ),
        )


PATCHES = {"dark skin": 0, "foliage": 3, "white": 18, "neutral 8": 19, "neutral 5": 21, "black": 23}
_FRONT, _TOP = 5, 3


def _uniform(seed: int, count: int) -> Float64:
    """Return numbers in (0, 1): raw bits of PCG64, the same with every release of numpy."""
    raw = np.random.PCG64(seed).random_raw(count)
    return (np.asarray(raw >> np.uint64(11), np.float64) + 0.5) * 2.0**-53


def _add_chart(b: _Builder, chart: Chart, origin: Float64) -> tuple[Float64, Float64, Float64, Float64]:
    """Add the chart; return its corners, patch corners, centre and axes."""
    axis = direction(chart.azimuth_deg, chart.elevation_deg)
    yaw, pitch, roll = np.radians([chart.yaw_deg, chart.pitch_deg, chart.roll_deg])
    turn_yaw = np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
    turn_pitch = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    turn_roll = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    axes = np.einsum("ij,jk,kl,lm->im", turn_roll, turn_pitch, turn_yaw, facing(axis))
    centre = origin + chart.distance_m * axis
    first = len(b.materials)
    b.materials.extend(spectra.chart_reflectances(chart.reflectances))
    half = (BOARD_M[0] / 2, BOARD_M[1] / 2, 0.002)
    board = b.box(centre, half, first + PATCHES["black"], axes=axes, grid=3)
    b.boxes[board][3][_FRONT] = first
    b.texture(board, (_FRONT,), transport.CHART, first + PATCHES["black"], 1.0)
    signs = np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
    front = centre + axes[2] * half[2]

    def corners(middle: Float64, size: tuple[float, float]) -> Float64:
        flat = middle[..., None, :] + signs * np.asarray(size) / 2.0
        return front + np.einsum("...k,ki->...i", flat, axes[:2])

    pitch_m = transport.PATCH_M + transport.GAP_M
    row, column = np.divmod(np.arange(24), 6)
    middles = np.stack([(column - 2.5) * pitch_m, (1.5 - row) * pitch_m], axis=-1)
    patch = (transport.PATCH_M, transport.PATCH_M)
    return corners(np.zeros(2), CHART_BOX_M), corners(middles, patch), centre, axes


def _add_module(b: _Builder, module: Module, centre: Float64, axes: Float64, emitter: int) -> None:
    """Add the D65 strip at the right of the chart, on a black carrier."""
    width, height = module.size_m
    middle = centre + axes[0] * (BOARD_M[0] / 2 + module.gap_m + width / 2)
    black = b.material("black")
    b.box(middle, (width / 2 + 0.008, height / 2 + 0.012, 0.002), black, axes=axes)
    strip = b.box(middle + axes[2] * 0.003, (width / 2, height / 2, 0.0011), black, axes=axes)
    b.boxes[strip][3][_FRONT] = -1 - emitter


@lru_cache(maxsize=8)
def build(place: Room | Furnace) -> Scene:
    """Return the arrays of a place."""
    return _build_room(place) if isinstance(place, Room) else _build_furnace(place)


def _build_furnace(place: Furnace) -> Scene:
    b = _Builder(None)
    origin = np.zeros(3)
    emission = [place.luminance * spectra.lamp(place.spectrum)]
    names = ["surround"]
    corners = patches = None
    if place.chart is not None:
        corners, patches, centre, axes = _add_chart(b, place.chart, origin)
        if place.module is not None:
            _add_module(b, place.module, centre, axes, emitter=1)
            emission.append(place.module.luminance * spectra.lamp(place.module.spectrum))
            names.append("D65 module")
    if not b.materials:
        b.material("white")
    return Scene(
        geometry=b.geometry(indoors=False, lamps=[(transport.SURROUND, "", 0)]),
        reflectances=np.stack(b.materials), emission=np.stack(emission), emitters=tuple(names), lamps=1,
        origin=origin, bounces=0, chart_corners=corners, patch_corners=patches,
    )  # fmt: skip


def _build_room(place: Room) -> Scene:
    b = _Builder(place.grey)
    origin = np.array([0.15, 1.32, 0.25])
    chance = _uniform(place.seed, 64) if place.seed else np.full(64, 0.5)
    _shell(b, chance)
    lamps: list[tuple[int, str, int]] = []
    for index, lamp in enumerate(place.lamps):
        lamps.append(_add_lamp(b, lamp, index, 0.3 * (chance[60 + index % 4] - 0.5)))
    if place.furniture:
        _furnish(b, chance)
    emission = [lamp.luminance * spectra.lamp(lamp.spectrum) for lamp in place.lamps]
    names = [lamp.name for lamp in place.lamps]
    corners = patches = None
    if place.chart is not None:
        corners, patches, centre, axes = _add_chart(b, place.chart, origin)
        _stand(b, centre, axes)
        if place.module is not None:
            _add_module(b, place.module, centre, axes, emitter=len(names))
            emission.append(place.module.luminance * spectra.lamp(place.module.spectrum))
            names.append("D65 module")
    return Scene(
        geometry=b.geometry(indoors=True, lamps=lamps), reflectances=np.stack(b.materials),
        emission=np.stack(emission), emitters=tuple(names), lamps=len(place.lamps), origin=origin,
        bounces=place.bounces, chart_corners=corners, patch_corners=patches,
    )  # fmt: skip


def _add_lamp(b: _Builder, lamp: Lamp, emitter: int, shift: float) -> tuple[int, str, int]:
    x, y, z = lamp.centre
    if lamp.shape == "panel":
        down = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
        half = (lamp.size[0] / 2, lamp.size[1] / 2, 0.012)
        box = b.box((x + shift, y, z - shift), half, b.material("white"), axes=down)
        b.boxes[box][3][_FRONT] = -1 - emitter
        return transport.PANEL, "box", box
    radius = lamp.size[0]
    x, z = x + 0.4 * shift, z + 0.4 * shift
    dark = b.material("black")
    b.box((x, (y - radius) / 2, z), (0.012, (y - radius) / 2 - 0.004, 0.012), dark)
    b.box((x, 0.013, z), (0.13, 0.012, 0.13), dark, turn_deg=20.0)
    return transport.GLOBE, "sphere", b.sphere((x, y, z), radius, -1 - emitter)


def _pick(chance: float, *choices: int) -> int:
    """Return one of several colour samples by a number in (0, 1)."""
    return choices[min(int(chance * len(choices)), len(choices) - 1)]


def _shell(b: _Builder, chance: Float64) -> None:
    """Add walls, floor and ceiling; the wall in front has a colour of its own."""
    wall = b.material(_pick(chance[0], 60, 91, 23))
    accent = b.material(_pick(chance[1], 54, 72, 61, 27, 14))
    room = b.box((-0.04, 1.306, -0.06), (2.65, 1.306, 2.35), wall, grid=14)
    faces = b.boxes[room][3]
    faces[4] = accent
    faces[2] = b.material(_pick(chance[2], 17, 18, 19))
    faces[3] = b.material("white")
    b.texture(room, (2,), transport.PLANKS, b.material(_pick(chance[2], 18, 16, 18)), 0.21)


def _stand(b: _Builder, centre: Float64, axes: Float64) -> None:
    """Add the pole that carries the chart, and its foot."""
    x, y, z = centre - 0.012 * axes[2]
    dark = b.material("black")
    b.box((x, (y - 0.09) / 2, z), (0.009, (y - 0.09) / 2, 0.009), dark)
    b.box((x, 0.011, z), (0.16, 0.010, 0.16), dark, turn_deg=33.0)


def _furnish(b: _Builder, chance: Float64) -> None:
    """Add the furniture. Numbers are metres from the floor's centre."""
    wood, dark_wood = b.material(_pick(chance[3], 17, 19, 16)), b.material(13)
    white, black = b.material("white"), b.material("black")

    rug = b.box(
        (-0.35, 0.007, -0.35), (1.25, 0.006, 0.85), b.material(_pick(chance[4], 7, 71, 52)), grid=6, turn_deg=4.0
    )
    b.texture(rug, (_TOP,), transport.CHECKER, b.material(_pick(chance[5], 23, 14, 36)), 0.212)

    # Sofa along the left wall.
    fabric = b.material(_pick(chance[6], 97, 77, 66, 85))
    shift = 0.2 * (chance[7] - 0.5)
    b.box((-2.18, 0.21, 0.55 + shift), (0.42, 0.20, 0.88), fabric, grid=3)
    b.box((-2.53, 0.62, 0.55 + shift), (0.11, 0.27, 0.88), fabric, grid=3)
    b.box((-2.18, 0.36, -0.43 + shift), (0.45, 0.24, 0.10), fabric, grid=3)
    b.box((-2.18, 0.36, 1.53 + shift), (0.45, 0.24, 0.10), fabric, grid=3)
    b.box((-2.33, 0.57, 0.15 + shift), (0.07, 0.19, 0.20), b.material(_pick(chance[8], 25, 42, 20)), turn_deg=12.0)
    b.box((-2.31, 0.57, 1.05 + shift), (0.07, 0.19, 0.20), b.material(_pick(chance[9], 70, 96, 48)), turn_deg=-9.0)

    # Sideboard at the wall in front, with things on it.
    x = -0.55 + 0.2 * (chance[10] - 0.5)
    b.box((x, 0.44, -2.16), (0.80, 0.34, 0.23), wood, grid=4)
    for leg in (-0.72, 0.72):
        b.box((x + leg, 0.05, -2.13), (0.025, 0.05, 0.16), black)
    b.box((x - 0.30, 0.44, -1.927), (0.32, 0.28, 0.004), white, grid=3)
    b.box((x + 0.38, 0.44, -1.927), (0.32, 0.28, 0.004), white, grid=3)
    b.sphere((x - 0.48, 0.9305, -2.14), 0.15, b.material(_pick(chance[11], 76, 57, 10)))
    b.sphere((x - 0.17, 0.8705, -2.10), 0.09, b.material(_pick(chance[12], 24, 70, 98)))
    for i, sample in enumerate((50, 75, 11)):
        b.box((x + 0.45, 0.80 + 0.041 * i, -2.14), (0.15 - 0.01 * i, 0.02, 0.11), b.material(sample), turn_deg=7.0 * i)

    # Pictures: one over the sideboard, one on the right wall.
    b.box((x + 0.05, 1.62, -2.395), (0.46, 0.33, 0.012), dark_wood)
    canvas = b.box((x + 0.05, 1.62, -2.388), (0.41, 0.28, 0.012), b.material(_pick(chance[13], 73, 22, 56)), grid=3)
    b.texture(canvas, (_FRONT,), transport.CHECKER, b.material(_pick(chance[14], 26, 33, 70)), 0.137)

    # Table at the right, things on it, and a stool.
    x, z = 1.72 + 0.2 * (chance[15] - 0.5), -1.30 + 0.2 * (chance[16] - 0.5)
    b.box((x, 0.735, z), (0.62, 0.016, 0.40), wood, grid=4)
    for i in (-0.57, 0.57):
        for j in (-0.35, 0.35):
            b.box((x + i, 0.36, z + j), (0.022, 0.358, 0.022), dark_wood)
    for i, sample in enumerate((20, 43, 5, 25)):
        b.sphere((x - 0.38 + 0.12 * i, 0.7915, z + 0.10 - 0.05 * (i % 2)), 0.04, b.material(sample))
    b.sphere((x + 0.22, 0.8915, z - 0.12), 0.14, b.material(_pick(chance[17], 42, 88, 73)))
    b.box(
        (x - 0.12, 0.33, z + 0.75), (0.17, 0.015, 0.17), b.material(_pick(chance[18], 3, 4, 57)), turn_deg=25.0, grid=3
    )
    for i in (-0.12, 0.12):
        b.box((x - 0.12 + i, 0.158, z + 0.75), (0.015, 0.157, 0.12), black, turn_deg=25.0)

    # A door in the right wall.
    b.box((2.597, 1.015, 0.62), (0.012, 1.01, 0.43), b.material(_pick(chance[19], 33, 72, 79)), grid=4)
    b.box((2.585, 1.015, 0.18), (0.025, 1.01, 0.03), white)
    b.box((2.585, 1.015, 1.06), (0.025, 1.01, 0.03), white)
    b.box((2.585, 2.055, 0.62), (0.025, 0.03, 0.47), white)
    b.sphere((2.545, 1.0, 0.30), 0.03, b.material("neutral 5"))

    # A plant in the corner behind on the right.
    b.box((2.12, 0.19, 1.82), (0.17, 0.19, 0.17), b.material(_pick(chance[20], 12, 8, 68)), turn_deg=15.0, grid=3)
    leaves = (
        (0.0, 0.62, 0.0, 0.21),
        (-0.16, 0.50, 0.09, 0.15),
        (0.15, 0.53, -0.10, 0.16),
        (0.03, 0.88, -0.05, 0.16),
        (-0.10, 0.78, -0.12, 0.13),
    )
    for i, (dx, y, dz, radius) in enumerate(leaves):
        b.sphere((2.12 + dx, y, 1.82 + dz), radius, b.material((49, 37, 45, 46, 49)[i]))

    _shelf(b, chance)


def _shelf(b: _Builder, chance: Float64) -> None:
    """Add shelves full of books at the wall behind the camera."""
    wood = b.material(_pick(chance[21], 19, 13, 27))
    x, z, depth = -0.35, 2.10, 0.17
    for side in (-0.93, 0.93):
        b.box((x + side, 0.92, z), (0.018, 0.92, depth), wood, grid=3)
    for y in (0.10, 0.62, 1.16, 1.70):
        b.box((x, y, z), (0.912, 0.016, depth), wood, grid=3)
    books = (5, 76, 22, 53, 90, 11, 73, 34, 99, 8, 58, 28, 71, 10, 42, 79, 20, 52, 97, 24, 75)
    place = 0
    for y in (0.636, 1.176):
        left = x - 0.87
        while left < x + 0.62 - 0.5 * chance[22]:
            number = chance[24 + place % 34] if chance[24] != 0.5 else (0.37 + 0.618034 * place) % 1.0
            thick, tall = 0.022 + 0.035 * number, 0.13 + 0.07 * ((5.0 * number) % 1.0)
            b.box(
                (left + thick, y + tall, z - 0.03), (thick - 0.002, tall, 0.11), b.material(books[place % len(books)])
            )
            left += 2.0 * thick
            place += 1
    b.sphere((x + 0.55, 0.2565, z - 0.02), 0.14, b.material(22))
    b.box((x - 0.4, 0.24, z), (0.28, 0.12, 0.12), b.material(68))


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What a camera in a scene sees, before any spectrum is chosen; see `look`."""

    scene: Scene
    projection: Projection
    materials: npt.NDArray[np.int16]
    light: Float32
    nodes: npt.NDArray[np.int16]
    weights: Float32

    def response(self, functionals: Float64, *, spectra: Float64 | None = None) -> Float64:
        """Return K linear functionals of the spectral radiance of every pixel, shape (height, width, K).

        `functionals` has shape (K, 81): the response is Σ functional · radiance over the grid. `spectra`,
        shape (E, 81), exchanges the emitters' spectral radiances (lamps, then module).
        """
        emission = self.scene.emission if spectra is None else np.asarray(spectra, np.float64)
        weighted = np.einsum("en,kn->ekn", emission, functionals)
        lamps = self.scene.lamps
        reflectances = self.scene.reflectances / np.pi
        direct = np.ascontiguousarray(np.einsum("mn,lkn->mlk", reflectances, weighted[:lamps]))
        bounced = np.einsum("lnw,lw->nw", indirect_light(self.scene).transpose(1, 0, 2), emission[:lamps])
        table = np.zeros((len(reflectances), len(bounced), len(functionals)))
        for k, functional in enumerate(functionals):
            table[:, :, k] = np.einsum("mw,nw->mn", reflectances * functional, bounced)
        height, width = self.projection.height, self.projection.width
        out = np.empty((height * width, len(functionals)))
        transport.respond(
            self.materials, self.light, self.nodes, self.weights, weighted.sum(axis=-1), direct, table, out
        )
        return out.reshape(height, width, -1)

    def radiance(self, *, spectra: Float64 | None = None) -> Float32:
        """Return the spectral radiance of every pixel, shape (height, width, 81), in W·m⁻²·sr⁻¹·nm⁻¹."""
        height, width = self.projection.height, self.projection.width
        cube = np.empty((height, width, 81), np.float32)
        unit = np.eye(81)
        for first in range(0, 81, 9):
            cube[..., first : first + 9] = self.response(unit[first : first + 9], spectra=spectra)
        return cube

    def seen(self) -> Float32:
        """Return the share of each pixel that shows each emitter, shape (height, width, E)."""
        height, width = self.projection.height, self.projection.width
        shares = [(self.materials == -1 - e).mean(axis=1) for e in range(len(self.scene.emitters))]
        return np.stack(shares, axis=-1).reshape(height, width, -1).astype(np.float32)

    def pixels(self, places: Float64) -> Float64:
        """Return (x, y), shape (..., 2), of places in the world, shape (..., 3)."""
        return self.projection.pixels(places - self.scene.origin)


_LAMP_POINTS = 3  # a lamp is sampled at (this × sub)² places for every pixel
_GATHERED = 160  # directions followed from every node
_AT_ONCE = 1 << 16  # pixels followed at once, to bound memory


@lru_cache(maxsize=4)
def look(place: Room | Furnace, projection: Projection, *, sub: int = 2) -> View:
    """Return what is seen of a place, with sub × sub rays a pixel; cached."""
    scene = build(place)
    pixels, rays, lamps = projection.width * projection.height, sub * sub, scene.lamps
    materials = np.empty((pixels, rays), np.int16)
    light = np.empty((pixels, rays, lamps), np.float32)
    nodes = np.empty((pixels, rays, 4), np.int16)
    weights = np.empty((pixels, rays, 4), np.float32)
    directions = projection.directions(sub)
    shifts = (np.stack(np.divmod(np.arange(rays), sub), axis=-1)[:, ::-1] + 0.5) / sub
    for first in range(0, pixels, _AT_ONCE):
        part = slice(first, min(first + _AT_ONCE, pixels))
        rows = part.stop - part.start
        places, normals = np.empty((rows, rays, 3)), np.empty((rows, rays, 3))
        origins = np.broadcast_to(scene.origin, (rows, 3)).copy()
        transport.hit(
            scene.geometry, origins, directions[part], materials[part], places, normals,
            nodes[part], weights[part],
        )  # fmt: skip
        transport.shine(scene.geometry, materials[part], places, normals, shifts.copy(), _LAMP_POINTS, light[part])
    return View(scene, projection, materials, light, nodes, weights)


@cache
def _gather_directions() -> Float64:
    """Return cosine-weighted directions about +z, shape (Q, 3): a spiral of the golden angle on the disc."""
    i = np.arange(_GATHERED) + 0.5
    radius, turn = np.sqrt(i / _GATHERED), i * np.pi * (3.0 - np.sqrt(5.0))
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1.0 - radius**2)], axis=-1)


def _nodes(g: transport.Geometry) -> tuple[Float64, Float64]:
    """Return places (N, 3) and frames (N, 3, 3) of the nodes, in their order."""
    places: list[Float64] = []
    frames: list[Float64] = []
    for i, (box, grid) in enumerate(zip(g.boxes, g.grids, strict=True)):
        centre, axes, half = box[:3], box[3:12].reshape(3, 3), box[12:15]
        at = 2.0 * (np.arange(grid) + 0.5) / grid - 1.0
        v, u = (m.reshape(-1, 1) for m in np.meshgrid(at, at, indexing="ij"))
        for face in range(6):
            axis, sign = face // 2, 1.0 if face % 2 else -1.0
            iu, iv = (axis + 1) % 3, (axis + 2) % 3
            normal = sign * axes[axis]
            places.append(centre + normal * half[axis] + u * half[iu] * axes[iu] + v * half[iv] * axes[iv])
            inwards = -normal if i == 0 and g.indoors else normal
            frames.append(np.broadcast_to(np.stack([axes[iu], axes[iv], inwards]), (grid * grid, 3, 3)))
    for sphere in g.spheres:
        for face in range(6):
            frame = np.roll(np.eye(3), -(face // 2) - 1, axis=0)
            frame[2] *= 1.0 if face % 2 else -1.0
            places.append((sphere[:3] + sphere[3] * frame[2])[None])
            frames.append(frame[None])
    return np.concatenate(places), np.ascontiguousarray(np.concatenate(frames))


@lru_cache(maxsize=4)
def indirect_light(scene: Scene) -> Float64:
    """Return the indirect irradiance at the nodes for radiance one of each lamp, shape (N, L, 81)."""
    g = scene.geometry
    if scene.bounces == 0:
        return np.zeros((max(1, len(_nodes(g)[0])), scene.lamps, 81))
    places, frames = _nodes(g)
    count = len(places)
    places = places + 1e-6 * frames[:, 2]
    lit = np.zeros((count, 1), np.int16)
    direct = np.empty((count, 1, scene.lamps), np.float32)
    shift = np.full((1, 2), 0.5)
    normals = np.ascontiguousarray(frames[:, 2:3])
    transport.shine(g, lit, places[:, None], normals, shift, 2 * _LAMP_POINTS, direct)
    shape = (count, _GATHERED)
    directions = np.einsum("qk,nki->nqi", _gather_directions(), frames)
    materials, nodes = np.empty(shape, np.int16), np.empty((*shape, 4), np.int16)
    weights, met, facing_out = np.empty((*shape, 4), np.float32), np.empty((*shape, 3)), np.empty((*shape, 3))
    transport.hit(g, places, directions, materials, met, facing_out, nodes, weights)
    nearest = np.argmax(weights, axis=-1)[..., None]
    cells = np.ascontiguousarray(np.take_along_axis(nodes, nearest, axis=-1)[..., 0])
    direct = direct[:, 0].astype(np.float64)
    first = np.repeat(direct[:, :, None], 81, axis=2)
    indirect = np.zeros_like(first)
    for _ in range(scene.bounces):
        after = np.empty_like(first)
        transport.bounce(cells, materials, scene.reflectances, first + indirect, after)
        indirect = after
    return indirect
