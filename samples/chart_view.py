"""A flat photograph of a chart beside its D65 lamp, with the truth of where they are: for tests of charts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from samples.places import Chart, Furnace, Module, Room
from samples.projection import Pinhole
from samples.sensor import Camera
from samples.view import View, look

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ChartView:
    """`rgb` float32 (H, W, 3) camera RGB per second, noise-free; corners and quads in pixels, as in `Truth`."""

    rgb: Float32
    chart_corners: Float64
    patch_quads: Float64
    module: npt.NDArray[np.bool_]
    view: View


def chart_view(
    width: int = 480,
    height: int = 360,
    *,
    light: str | None = "D65",
    luminance: float = 80.0,
    fill: float = 0.6,
    yaw_deg: float = 0.0,
    pitch_deg: float = 0.0,
    roll_deg: float = 0.0,
    module: Module | None = None,
    camera: Camera | None = None,
    room: Room | None = None,
) -> ChartView:
    """Return a perspective view of the chart that fills about `fill` of the width.

    Under even light of the spectrum `light`, so that a patch has exactly the radiance ρ · L, with nothing
    but that light behind it; or, if `light` is None, in `room` (its chart is put in front of the camera).
    The three angles turn it as `Chart` says.
    """
    chart = Chart(
        azimuth_deg=13.0, elevation_deg=-9.0, distance_m=0.5, yaw_deg=yaw_deg, pitch_deg=pitch_deg,
        roll_deg=roll_deg,
    )  # fmt: skip
    across = 0.2794 / fill / chart.distance_m
    pinhole = Pinhole(
        width, height, float(np.degrees(2.0 * np.arctan(across / 2.0))), chart.azimuth_deg, chart.elevation_deg
    )
    lamp = module or Module()
    place: Room | Furnace
    if light is None:
        base = room or Room()
        place = Room(base.seed, base.lamps, chart, lamp, base.furniture, base.bounces, base.grey)
    else:
        place = Furnace(light, luminance, chart, lamp)
    view = look(place, pinhole)
    corners, patches = view.scene.chart_corners, view.scene.patch_corners
    assert corners is not None and patches is not None
    rgb = view.response((camera or Camera()).responses).astype(np.float32)
    shows = view.seen()[..., view.scene.emitters.index("D65 module")] >= 1.0
    return ChartView(rgb, view.pixels(corners), view.pixels(patches), shows, view)
