"""What is known and said of the lights of a map."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """One light of the map, and its spectrum."""

    cluster: int
    type: str  # daylight, sunset, led, fluorescent, incandescent, discharge, measured, smooth (unknown)
    cct: float  # K, of the emission
    duv: float  # of the emission
    emission: Floats  # [N] on the observer's grid, Y = 1
    source: str  # how the spectrum was got
    confidence: float  # 0…1, a ranking
    share: float  # of luminance · solid angle of the map
    at: tuple[float, float]  # (u, v) of its brightest region
    declared: bool
    remedy: str  # what a person could do to make it surer; "" where nothing is needed
    cct_seen: float = float("nan")  # K, of the colour in the map; the nearest of the locus, if that is far
    duv_seen: float = float("nan")
    cct_sigma: float = float("nan")  # K, of cct_seen
    outdoor: bool = False
    name: str = ""
    duv_sigma: float = float("nan")  # of duv_seen
    kinds: Mapping[str, float] = field(default_factory=dict)  # kind of lamp → probability; sums to 1


@dataclass(frozen=True, slots=True, eq=False)
class Declared:
    """What a person knows of the light at a place of the map; None is "not known"."""

    at: tuple[float, float]  # (u, v), 0…1 from the top left of the map
    type: str | None = None  # a family, or a CIE lamp by name (FL11, LED-V2, HP1)
    cct: float | None = None
    emission: npt.NDArray[np.float64] | None = None  # [N] on the observer's grid
    name: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Lights:
    """The lights of a map, one a cluster and in its order, and what a person should be told."""

    lights: tuple[Light, ...]
    warnings: tuple[str, ...]

    def __iter__(self) -> Iterator[Light]:
        return iter(self.lights)

    def __len__(self) -> int:
        return len(self.lights)

    def __getitem__(self, cluster: int) -> Light:
        return self.lights[cluster]
