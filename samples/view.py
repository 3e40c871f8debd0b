"""What a camera sees in a place, before any spectrum is chosen, and the indirect light there.

view = look(Room(), LatLong(512))                            # geometry and transport, cached
rgb = view.response(camera.responses)                        # [H, W, 3]
rgb = view.response(camera.responses, spectra=other_lamps)   # the same room in another light: cheap
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
import numpy.typing as npt

from samples import transport
from samples.places import Furnace, Room
from samples.projection import Projection
from samples.scene import Scene, build

Float64 = npt.NDArray[np.float64]
Float32 = npt.NDArray[np.float32]


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
        transport.in_parts(
            transport.respond,
            height * width,
            self.materials,
            self.light,
            self.nodes,
            self.weights,
            weighted.sum(axis=-1),
            direct,
            table,
            out,
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
        transport.in_parts(
            transport.hit, rows, scene.geometry, origins, directions[part], materials[part], places, normals,
            nodes[part], weights[part],
        )  # fmt: skip
        transport.in_parts(
            transport.shine, rows, scene.geometry, materials[part], places, normals, shifts.copy(), _LAMP_POINTS,
            light[part],
        )  # fmt: skip
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
    count = 6 * int((g.grids.astype(np.int64) ** 2).sum() + len(g.spheres))
    if scene.bounces == 0:
        return np.zeros((max(1, count), scene.lamps, 81))
    places, frames = _nodes(g)
    places = places + 1e-6 * frames[:, 2]
    lit = np.zeros((count, 1), np.int16)
    lamp_light = np.empty((count, 1, scene.lamps), np.float32)
    shift = np.full((1, 2), 0.5)
    normals = np.ascontiguousarray(frames[:, 2:3])
    transport.in_parts(transport.shine, count, g, lit, places[:, None], normals, shift, 2 * _LAMP_POINTS, lamp_light)
    shape = (count, _GATHERED)
    directions = np.einsum("qk,nki->nqi", _gather_directions(), frames)
    materials, nodes = np.empty(shape, np.int16), np.empty((*shape, 4), np.int16)
    weights, met, facing_out = np.empty((*shape, 4), np.float32), np.empty((*shape, 3)), np.empty((*shape, 3))
    transport.in_parts(transport.hit, count, g, places, directions, materials, met, facing_out, nodes, weights)
    nearest = np.argmax(weights, axis=-1)[..., None]
    cells = np.ascontiguousarray(np.take_along_axis(nodes, nearest, axis=-1)[..., 0])
    first = np.repeat(lamp_light[:, 0, :, None].astype(np.float64), 81, axis=2)
    indirect = np.zeros_like(first)
    for _ in range(scene.bounces):
        after = np.empty_like(first)
        transport.in_parts(
            transport.bounce, count, cells, materials, scene.reflectances / _GATHERED, first + indirect, after
        )
        indirect = after
    return indirect
