"""The three ways to uplift a map, behind one face: what the step writes and measures is the same for each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from envcal.config import UpliftSettings
from envcal.lights_file import Lights
from envcal.uplift_file import About, CubeRecord, Emission, LatticeAbout

if TYPE_CHECKING:
    from uplift.lattice import Cube, LatticeUplift
    from uplift.pixels import Status, Uplifted
    from uplift.spectrum import Observer, RGBSpace

Image = npt.NDArray[np.float32]
Labels = npt.NDArray[np.uint32]
Planes = dict[str, npt.NDArray[Any]]
_BASELINE = "The method is there for comparison; `constrained` keeps their colours where any light can show them."


class Found(Protocol):
    """What every uplift tells of its pixels."""

    @property
    def status(self) -> npt.NDArray[np.uint8]:
        """Each pixel's `uplift.pixels.Status`."""

    @property
    def scale(self) -> npt.NDArray[np.float64]:
        """Each pixel's brightness; 0 where it has no radiance."""

    @property
    def counts(self) -> Mapping[Status, int]:
        """Pixels by status."""


class Solution(Protocol):
    """The spectra of a tile, good until the next tile is solved."""

    @property
    def found(self) -> Found:
        """What became of each pixel."""

    @property
    def visited(self) -> int:
        """How many cells of a lattice were looked into."""

    def planes(self) -> Planes:
        """The channels of the uplift file but R, G, B, rounded to what is stored."""

    def rgb(self, chosen: npt.NDArray[np.bool_], *, stored: bool) -> npt.NDArray[np.float64]:
        """The RGB [n, 3] of the chosen pixels' spectra, in double precision or as stored."""


@dataclass(frozen=True, slots=True)
class Method:
    """How tiles are solved, what the file says of it, and the words for pixels that are not exact."""

    solve: Callable[[Image, Labels], Solution]
    about: About | LatticeAbout
    fallback: str
    closest: str
    advice: str


@dataclass(frozen=True, slots=True)
class _Coefficients:
    found: Uplifted
    written: npt.NDArray[np.float32]
    seen: Observer
    space: RGBSpace

    @classmethod
    def of(cls, found: Uplifted, seen: Observer, space: RGBSpace) -> _Coefficients:
        """A pixel without radiance gets the coefficients of grey, not of black, whose −∞ would turn into NaN in the
        formula that the file documents."""
        from uplift.storage import stored_coefficients

        values = np.where((found.scale == 0)[..., np.newaxis], 0.0, found.coefficients)
        return cls(found, stored_coefficients(values, observer=seen), seen, space)

    @property
    def visited(self) -> int:
        return 0

    def planes(self) -> Planes:
        planes: Planes = {f"c{k}": self.written[..., k] for k in range(3)}
        return planes | {
            "scale": self.found.scale.astype(np.float32),
            "cluster": self.found.emission,
            "status": self.found.status,
        }

    def rgb(self, chosen: npt.NDArray[np.bool_], *, stored: bool) -> npt.NDArray[np.float64]:
        from uplift.radiance import rgb_of

        coefficients, scale = self.found.coefficients[chosen], self.found.scale[chosen]
        if stored:
            coefficients, scale = self.written[chosen].astype(np.float64), _as_stored(scale)
        emission, emissions = self.found.emission[chosen], self.found.emissions
        return rgb_of(coefficients, scale, emission, emissions, observer=self.seen, space=self.space)


@dataclass(frozen=True, slots=True)
class _Mixtures:
    found: LatticeUplift
    cube: Cube

    @property
    def visited(self) -> int:
        return int(self.found.visited.sum())

    def planes(self) -> Planes:
        """A pixel without radiance lies in the cell around the cube's centre, none of whose nodes is empty."""
        dark = self.found.scale == 0
        side = len(self.cube.filled) - 1
        centre = ((side // 2) * side + side // 2) * side + side // 2
        position = np.where(dark[..., np.newaxis], 0.0, self.found.position).astype(np.float32)
        planes: Planes = {name: position[..., k] for k, name in enumerate("uvw")}
        return planes | {
            "cell": np.where(dark, centre, self.found.cell).astype(np.uint32),
            "scale": self.found.scale.astype(np.float32),
            "cluster": self.found.emission,
            "status": self.found.status,
        }

    def rgb(self, chosen: npt.NDArray[np.bool_], *, stored: bool) -> npt.NDArray[np.float64]:
        from uplift.lattice import rgb_of_lattice

        position, scale = self.found.position[chosen], self.found.scale[chosen]
        if stored:
            position, scale = _as_stored(position), _as_stored(scale)
        cell, emission = self.found.cell[chosen], self.found.emission[chosen]
        return rgb_of_lattice(cell, position, scale, emission, self.found.emissions, self.cube)


def _as_stored(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return values.astype(np.float32).astype(np.float64)


def method_of(settings: UpliftSettings, lights: Lights, seen: Observer, space: RGBSpace) -> Method:
    """Return the method that the settings ask for, its tables built for the lights."""
    if settings.method == "scaled":
        return _scaled(lights, seen, space)
    if settings.method == "lattice":
        return _lattice(lights, seen, space)
    return _constrained(settings, lights, seen, space)


def _constrained(settings: UpliftSettings, lights: Lights, seen: Observer, space: RGBSpace) -> Method:
    from uplift.pixels import FALLBACK_LIGHTS, Buffers, fallback_emissions, uplift_pixels
    from uplift.table import build_table

    tables = [
        build_table(light.emission, observer=seen, space=space, nodes=settings.nodes, factor=settings.brightness)
        for light in lights.lights
    ]
    fallbacks = [
        _emission(emission, type="fallback", source=source)
        for emission, source in zip(fallback_emissions(seen), FALLBACK_LIGHTS, strict=True)
    ]
    kept = [Buffers.of(0)]

    def solve(rgb: Image, labels: Labels) -> Solution:
        if len(kept[0].scale) < labels.size:
            kept[0] = Buffers.of(labels.size)
        found = uplift_pixels(rgb, labels, tables, precision=settings.precision, out=kept[0])
        return _Coefficients.of(found, seen, space)

    return Method(
        solve=solve,
        about=About(method="constrained", **_head(lights, seen, [*_of_lights(lights), *fallbacks])),
        fallback="colours that their light cannot show, kept under another. If they are many, declare the light there "
        "(`cluster.lights`)",
        closest="colours that no light can show (noise, coloured fringes at the rims of lamps, a poor chart fit)",
        advice="A few at the rims of lamps do no harm.",
    )


def _scaled(lights: Lights, seen: Observer, space: RGBSpace) -> Method:
    from uplift.scaled import uplift_scaled
    from uplift.spectrum import illuminant

    only = _emission(illuminant("D65", seen), type="daylight", source="D65 for every pixel")
    return Method(
        solve=lambda rgb, _labels: _Coefficients.of(uplift_scaled(rgb, observer=seen, space=space), seen, space),
        about=About(method="scaled", **_head(lights, seen, [only])),
        fallback="",
        closest="negative components, or colours that no reflectance has at half their brightness under D65",
        advice=_BASELINE,
    )


def _lattice(lights: Lights, seen: Observer, space: RGBSpace) -> Method:
    from uplift.lattice import build_cube, build_lattice, uplift_lattice
    from uplift.spectrum import illuminant

    cube = build_cube(observer=seen, space=space)
    lattices = [build_lattice(light.emission, cube) for light in lights.lights]
    source = "D65, for dark colours outside the lattice of their own light"
    fallback = _emission(illuminant("D65", seen), type="fallback", source=source)
    head = _head(lights, seen, [*_of_lights(lights), fallback])
    return Method(
        solve=lambda rgb, labels: _Mixtures(uplift_lattice(rgb, labels, lattices), cube),
        about=LatticeAbout(cube=CubeRecord.of(cube), **head),
        fallback="dark, and outside the lattice of their light; their colour is kept in that of D65",
        closest="outside the lattice of their light, and bright or outside that of D65 too; given its nearest colour",
        advice=_BASELINE,
    )


def _head(lights: Lights, seen: Observer, emissions: list[Emission]) -> dict[str, Any]:
    from uplift.pixels import Status

    return {
        "space": lights.space,
        "observer": lights.observer,
        "wavelengths_nm": [float(w) for w in seen.wavelengths_nm],
        "clusters": emissions,
        "status": {str(int(status)): status.name.lower() for status in Status},
    }


def _of_lights(lights: Lights) -> list[Emission]:
    return [
        Emission(
            type=light.type,
            cct=light.cct,
            duv=light.duv,
            source=light.source,
            confidence=light.confidence,
            emission=light.emission,
        )
        for light in lights.lights
    ]


def _emission(values: npt.NDArray[np.float64], *, type: str, source: str) -> Emission:
    return Emission(type=type, cct=None, duv=None, source=source, confidence=1.0, emission=[float(v) for v in values])
