"""Builds a place: where its lamps, chart, D65 lamp and furniture stand, as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from samples import spectra, transport
from samples.builder import FRONT, PATCHES, Builder
from samples.furniture import add_furniture, add_shell, add_stand
from samples.places import BOARD_M, CHART_BOX_M, Chart, Furnace, Lamp, Module, Room
from samples.projection import direction, facing
from samples.sensor import uniform

Float64 = npt.NDArray[np.float64]


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


def _add_chart(b: Builder, chart: Chart, origin: Float64) -> tuple[Float64, Float64, Float64, Float64]:
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
    b.boxes[board][3][FRONT] = first
    b.texture(board, (FRONT,), transport.CHART, first + PATCHES["black"], 1.0)
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


def _add_module(b: Builder, module: Module, centre: Float64, axes: Float64, emitter: int) -> None:
    """Add the D65 strip at the right of the chart, on a black carrier."""
    width, height = module.size_m
    middle = centre + axes[0] * (BOARD_M[0] / 2 + module.gap_m + width / 2)
    black = b.material("black")
    b.box(middle, (width / 2 + 0.008, height / 2 + 0.012, 0.002), black, axes=axes)
    strip = b.box(middle + axes[2] * 0.003, (width / 2, height / 2, 0.0011), black, axes=axes)
    b.boxes[strip][3][FRONT] = -1 - emitter


@lru_cache(maxsize=8)
def build(place: Room | Furnace) -> Scene:
    """Return the arrays of a place."""
    return _build_room(place) if isinstance(place, Room) else _build_furnace(place)


def _build_furnace(place: Furnace) -> Scene:
    b = Builder(None)
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
    b = Builder(place.grey)
    origin = np.array([0.15, 1.32, 0.25])
    chance = uniform((place.seed, 3), 64) if place.seed else np.full(64, 0.5)
    add_shell(b, chance)
    lamps: list[tuple[int, str, int]] = []
    for index, lamp in enumerate(place.lamps):
        lamps.append(_add_lamp(b, lamp, index, 0.3 * (chance[60 + index % 4] - 0.5)))
    if place.furniture:
        add_furniture(b, chance)
    emission = [lamp.luminance * spectra.lamp(lamp.spectrum) for lamp in place.lamps]
    names = [lamp.name for lamp in place.lamps]
    corners = patches = None
    if place.chart is not None:
        corners, patches, centre, axes = _add_chart(b, place.chart, origin)
        add_stand(b, centre, axes)
        if place.module is not None:
            _add_module(b, place.module, centre, axes, emitter=len(names))
            emission.append(place.module.luminance * spectra.lamp(place.module.spectrum))
            names.append("D65 module")
    return Scene(
        geometry=b.geometry(indoors=True, lamps=lamps), reflectances=np.stack(b.materials),
        emission=np.stack(emission), emitters=tuple(names), lamps=len(place.lamps), origin=origin,
        bounces=place.bounces, chart_corners=corners, patch_corners=patches,
    )  # fmt: skip


def _add_lamp(b: Builder, lamp: Lamp, emitter: int, shift: float) -> tuple[int, str, int]:
    x, y, z = lamp.centre
    if lamp.shape == "panel":
        down = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
        half = (lamp.size[0] / 2, lamp.size[1] / 2, 0.012)
        box = b.box((x + shift, y, z - shift), half, b.material("white"), axes=down)
        b.boxes[box][3][FRONT] = -1 - emitter
        return transport.PANEL, "box", box
    radius = lamp.size[0]
    x, z = x + 0.4 * shift, z + 0.4 * shift
    dark = b.material("black")
    b.box((x, (y - radius) / 2, z), (0.012, (y - radius) / 2 - 0.004, 0.012), dark)
    b.box((x, 0.013, z), (0.13, 0.012, 0.13), dark, turn_deg=20.0)
    return transport.GLOBE, "sphere", b.sphere((x, y, z), radius, -1 - emitter)
