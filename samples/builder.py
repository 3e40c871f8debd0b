"""Collects the boxes, spheres and materials of a place into the arrays that light transport works on."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from samples import spectra, transport

Float64 = npt.NDArray[np.float64]

PATCHES = {"dark skin": 0, "foliage": 3, "white": 18, "neutral 8": 19, "neutral 5": 21, "black": 23}
FRONT, TOP = 5, 3


class Builder:
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
