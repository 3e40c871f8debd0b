"""Paths of light through a scene, recorded once: the picture under any map, at any wavelength, by products and sums alone.

Light goes through a scene linearly in its environment, and where it goes depends on no reflectance as long as nothing is
decided by them. So the paths that Mitsuba's rays and materials take are kept as: the pixel, the texel that is reached, a
weight without the patches' reflectances, and which patches were met. Every map is then seen along the very same paths,
whose noise is common to all pictures and no part of what they differ by. No emitter takes part but that which says where
the light comes from, and that is the same for all maps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit, prange

Float64 = npt.NDArray[np.float64]
Float32 = npt.NDArray[np.float32]

#: As the scene's integrator has it: edges of a path.
MAX_DEPTH = 8
#: Samples of a pixel fall into this many groups by turns; their scatter tells the noise.
GROUPS = 8
PATCHES = 24
_LANES = 1 << 18


@dataclass(frozen=True, slots=True, eq=False)
class Paths:
    """The paths [n] of a picture (height, width), in the order of pixel and group.

    `texel` is the place in the map laid flat, `weight` the share of its radiance before the patches, `patch`
    [n, MAX_DEPTH − 1] the patches met, PATCHES for what is none of them; `starts` [height · width · GROUPS + 1].
    """

    size: tuple[int, int]
    texel: npt.NDArray[np.int32]
    weight: Float32
    patch: npt.NDArray[np.uint8]
    starts: npt.NDArray[np.int64]

    def pictures(self, radiance: Float32, reflectances: Float64) -> Float64:
        """Return the pictures [GROUPS, height, width, N] under a map [H, W, N] with `reflectances` [PATCHES, N]."""
        spectra = np.ascontiguousarray(radiance.reshape(-1, radiance.shape[-1]), np.float32)
        factors = np.concatenate([reflectances, np.ones((1, reflectances.shape[1]))]).astype(np.float32)
        out = np.zeros((len(self.starts) - 1, spectra.shape[1]))
        _sum(self.texel, self.weight, self.patch, self.starts, spectra, factors, out)
        return np.moveaxis(out.reshape(*self.size, GROUPS, -1), 2, 0)


def record(scene: Any, *, shape: tuple[int, int], size: tuple[int, int], spp: int, seed: int = 0) -> Paths:
    """Trace `spp` paths for each pixel of a picture `size` (width, height) in a map of `shape` (height, width).

    `scene` is that of `envcal.scene`, loaded in an RGB variant; its environment guides where the light is looked for
    and must be positive wherever a map may shine. The patches' reflectances are set to 1 in it. Between texels one of the
    four is drawn by its bilinear share; the rows are the middles of bands of latitude.
    """
    import mitsuba as mi

    params = mi.traverse(scene)
    for k in range(PATCHES):
        params[f"patch_{k + 1:02d}.bsdf.reflectance.value"] = mi.Color3f(1.0)
    params.update()
    width, height = size
    spp = -(-spp // GROUPS) * GROUPS
    chunk = max(GROUPS, _LANES // (width * height) // GROUPS * GROUPS)
    rng = np.random.default_rng(seed)
    parts = [_traced(scene, shape, size, min(chunk, spp - first), seed + first, rng) for first in range(0, spp, chunk)]
    lane, texel, weight, patch = (np.concatenate([part[k] for part in parts]) for k in range(4))
    order = np.argsort(lane, kind="stable")
    starts = np.searchsorted(lane[order], np.arange(width * height * GROUPS + 1))
    share = np.float32(GROUPS / spp)
    return Paths((height, width), texel[order], weight[order] * share, patch[order], starts.astype(np.int64))


def guide(transport: Float32, weights: Float64) -> Float32:
    """Return a grey map [H, W, 3], bright where the mean of `transport` [H, W, N] is, and nowhere black."""
    mean = np.asarray(transport @ (weights / weights.sum()).astype(np.float32))
    return np.repeat((mean + 1e-3 * mean.mean())[..., np.newaxis], 3, axis=-1).astype(np.float32)


def _traced(
    scene: Any, shape: tuple[int, int], size: tuple[int, int], spp: int, seed: int, rng: np.random.Generator
) -> tuple[npt.NDArray[Any], ...]:
    """Return lane (pixel · GROUPS + group), texel, weight and patches of every meeting with the map, one after another."""
    import drjit as dr
    import mitsuba as mi

    width, height = size
    count = width * height * spp
    sampler: Any = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    index = dr.arange(mi.UInt32, count)
    pixel = index // spp
    at = mi.Point2f(mi.Float(pixel % width), mi.Float(pixel // width)) + sampler.next_2d()
    ray, _ = scene.sensors()[0].sample_ray(0.0, 0.5, at / mi.Point2f(width, height), mi.Point2f(0.5))
    lanes = np.asarray(pixel * GROUPS + (index % spp) % GROUPS)
    numbers = _numbers(scene)
    none = np.full((count, MAX_DEPTH - 1), PATCHES, np.uint8)
    found: list[tuple[npt.NDArray[Any], ...]] = []

    def keep(mask: Any, direction: Any, weight: Any) -> None:
        dr.eval(mask, direction, weight)
        rows = np.flatnonzero(np.asarray(mask))
        d = np.asarray(direction).T[rows].astype(np.float64)
        found.append((lanes[rows], _texels(d, shape, rng), np.asarray(weight)[rows].astype(np.float32), none[rows]))

    context = mi.BSDFContext()
    throughput, density = mi.Float(1.0), mi.Float(1.0)
    straight, active = mi.Bool(True), mi.Bool(True)
    before = dr.zeros(mi.Interaction3f, count)
    for depth in range(MAX_DEPTH):
        si = scene.ray_intersect(ray, active)
        reached = mi.DirectionSample3f(scene, si, before)
        other = scene.environment().pdf_direction(before, reached, active & ~straight)
        keep(active & ~si.is_valid(), ray.d, throughput * dr.select(straight, 1.0, density / (density + other)))
        active &= si.is_valid()
        if depth == MAX_DEPTH - 1 or not dr.any(active):
            break
        none[:, depth] = numbers[np.asarray(dr.select(active, dr.reinterpret_array(mi.UInt32, si.shape), 0))]
        bsdf = si.bsdf(ray)
        light, value = scene.sample_emitter_direction(si, sampler.next_2d(), True, active)
        # Scene and map are grey as they are loaded, so one channel is all of them.
        share, own = bsdf.eval_pdf(context, si, si.to_local(light.d), active)
        lit = active & (light.pdf > 0) & (value.x > 0) & (share.x > 0)
        keep(lit, light.d, dr.select(lit, throughput * share.x / (light.pdf + own), 0.0))
        onward, factor = bsdf.sample(context, si, sampler.next_1d(active), sampler.next_2d(active), active)
        throughput, density = throughput * factor.x, onward.pdf
        straight = mi.has_flag(onward.sampled_type, mi.BSDFFlags.Delta)
        active &= factor.x > 0
        before, ray = mi.Interaction3f(si), si.spawn_ray(si.to_world(onward.wo))
        dr.eval(throughput, density, straight, active, before, ray, sampler)
    return tuple(np.concatenate([part[k] for part in found]) for k in range(4))


def _numbers(scene: Any) -> npt.NDArray[np.uint8]:
    """Return the number of the patch that a shape of Mitsuba's registry is, PATCHES for the others."""
    import drjit as dr
    import mitsuba as mi

    shapes = {
        int(np.asarray(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))).item()): shape.id()
        for shape in scene.shapes()
    }
    out = np.full(max(shapes) + 1, PATCHES, np.uint8)
    for place, name in shapes.items():
        if name.startswith("patch_"):
            out[place] = int(name.removeprefix("patch_")) - 1
    return out


def _texels(direction: Float64, shape: tuple[int, int], rng: np.random.Generator) -> npt.NDArray[np.int32]:
    """Draw one of the four texels around each direction [n, 3] of the scene, whose −Z is the middle of the map."""
    height, width = shape
    x, y, z = direction.T
    x = (np.arctan2(-x, z) / (2 * np.pi) % 1.0) * width - 0.5
    row = np.arctan2(np.hypot(direction[:, 0], z), y) / np.pi * height - 0.5
    column, row = (np.floor(values + rng.random(len(values))).astype(np.int32) for values in (x, row))
    return np.asarray(np.clip(row, 0, height - 1) * width + column % width, np.int32)


@njit(cache=True, parallel=True, error_model="numpy")
def _sum(texel, weight, patch, starts, spectra, factors, out):  # type: ignore[no-untyped-def]
    bands, depth, none = spectra.shape[1], patch.shape[1], factors.shape[0] - 1
    for lane in prange(len(starts) - 1):
        light = np.empty(bands, np.float32)
        for n in range(starts[lane], starts[lane + 1]):
            w = weight[n]
            for b in range(bands):
                light[b] = w * spectra[texel[n], b]
            for k in range(depth):
                if patch[n, k] != none:
                    for b in range(bands):
                        light[b] *= factors[patch[n, k], b]
            for b in range(bands):
                out[lane, b] += light[b]
