"""What can be photographed: a furnished room with its lamps, chart and D65 lamp; a furnace; their settings.

Metres in a world whose +Y is up; azimuth 0 is −Z and 90 is +X.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from samples import spectra, transport

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


CEILING = Lamp("ceiling panel", "LED-B4", "panel", (1.0, 2.585, 0.90), (1.2, 0.6), 2000.0)
STANDING = Lamp("standing globe", "A", "globe", (-1.30, 1.43, 1.50), (0.14,), 7000.0)
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
