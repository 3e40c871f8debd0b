"""The emitter itself, one class for each Mitsuba variant: what Mitsuba asks of it, answered by `radiance` and `sampling`.

The conventions are those of Mitsuba's own `envmap`: local +Y is up, u = 0 is −Z and u = ¼ is +X, radiance of a white of
Y = 1 renders as 1. What differs: radiance of the four nearest texels is interpolated, not their coefficients; rows are centred
in their band of latitude (v = (y + ½)/height), and the outermost ones reach to the poles.

A class of Mitsuba's can be derived from only when its variant is set, so both are made inside a function: `holder_class` has
what the emitter holds and lets be changed, `emitter_class` has what renderers ask.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from envcal.errors import EnvcalError
from envcal.mitsuba import geometry, loading, radiance, sampling
from envcal.mitsuba.loading import Float32, SpectralMap

#: Distance at which the emitter pretends to stand: beyond every scene, and its square still far from overflow.
FAR = 1e10


def emitter_class(variant: str) -> type[Any]:
    """Return the emitter for one variant; its module of types is bound here, since methods run in any thread."""
    V: Any = import_module(f"mitsuba.{variant}")
    jit, spectral_variant = dr.is_jit_v(V.Float), V.is_spectral
    Value = V.UnpolarizedSpectrum
    Holder: Any = holder_class(V)

    class EnvcalEmitter(Holder):  # type: ignore[misc]
        def eval(self, si: Any, active: Any = True) -> Any:
            u, v, _ = geometry.place_of(self.to_local @ -si.wi)
            return _spectrum(self._radiance(u, v, si.wavelengths, active))

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            u, v, d, density, active = self._draw(sample, active)
            ds = V.DirectionSample3f()
            ds.p, ds.n, ds.d, ds.dist = it.p + d * FAR, -d, d, FAR
            ds.uv = V.Point2f(u, v)
            ds.time, ds.delta, ds.emitter = it.time, False, V.EmitterPtr(self) if jit else self
            ds.pdf = dr.select(active, density, 0.0)
            weight = dr.select(active, dr.rcp(ds.pdf), 0.0)
            return ds, _spectrum(self._radiance(u, v, it.wavelengths, active) * weight)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:  # noqa: ARG002
            u, v, inverse_sine = geometry.place_of(self.to_local @ ds.d)
            return sampling.density(V, self.warp, self.size, u, v, active) * inverse_sine

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return _spectrum(self._radiance(ds.uv.x, ds.uv.y, it.wavelengths, active))

        def sample_wavelengths(self, si: Any, sample: Any, active: Any = True) -> Any:
            wavelengths, weight = self._draw_wavelengths(sample)
            u, v = si.uv.x, si.uv.y
            return wavelengths, _spectrum(self._radiance(u - dr.floor(u), v, wavelengths, active) * weight)

        def sample_ray(self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True) -> Any:
            if self._sphere is None:
                raise EnvcalError(
                    "light is traced from the emitter, which does not know where the scene is (Mitsuba tells emitters "
                    "written in Python nothing). Call `scene.environment().set_scene(scene)` after loading, or give "
                    "the emitter `center` and `radius` of a sphere around the scene."
                )
            center, radius = V.Point3f(self._sphere[0]), self._sphere[1]
            u, v, d, density, active = self._draw(sample3, active)
            disk = V.warp.square_to_uniform_disk_concentric(V.Point2f(sample2))
            origin = center + (V.Frame3f(d).to_world(V.Vector3f(disk.x, disk.y, 0)) + d) * radius
            wavelengths, weight = self._draw_wavelengths(sample1)
            weight *= np.pi * radius**2 * dr.select(active, dr.rcp(density), 0.0)
            light = self._radiance(u, v, wavelengths, active)
            return V.Ray3f(origin, -d, time, wavelengths), _spectrum(light * weight)

        def sample_position(self, time: Any, sample: Any, active: Any = True) -> Any:  # noqa: ARG002
            """Return nothing of use: light from infinitely far starts nowhere. Mitsuba's `envmap` does the same."""
            if not jit:
                raise EnvcalError("an environment map has no positions to sample; use sample_direction or sample_ray.")
            return dr.zeros(V.PositionSample3f), V.Float(float("nan"))

        def _draw(self, sample: Any, active: Any) -> tuple[Any, Any, Any, Any, Any]:
            """Return u and v in 0 … 1, the direction in the world, its density, and where that is not 0."""
            u, v, density = sampling.draw_place(V, self.warp, self.size, sample, active)
            local, inverse_sine = geometry.direction_of(V, u, v)
            return u - dr.floor(u), v, self.to_world @ local, density * inverse_sine, active & (density > 0)

        def _draw_wavelengths(self, sample: Any) -> tuple[Any, Any]:
            """Return wavelengths and 1 / their densities; outside the spectral variants there are none to draw."""
            if spectral_variant:
                return sampling.draw_wavelengths(V, self.dist, sample)
            return type(V.SurfaceInteraction3f().wavelengths)(), Value(1.0)

        def _radiance(self, u: Any, v: Any, wavelengths: Any, active: Any) -> Any:
            """Return the radiance, unpolarised, at a place of the map."""
            around = radiance.corners(V, self.size, u, v)
            if spectral_variant:
                first = around.texels[0]
                slots = 0 if self.quads is None else radiance.gathered(V, V.UInt32, self.quads, first, 1, active)
                emission = radiance.emissions_around(V, self.table, self.used, self.grid, slots, wavelengths, active)
            total: Any = Value(0.0)
            for k, (texel, weight) in enumerate(zip(around.texels, around.weights, strict=True)):
                if spectral_variant:
                    c = radiance.gathered(V, V.Vector4f, self.data.array, texel, 4, active)
                    light = emission(k) * radiance.reflectance(V, c, wavelengths) * c.w
                else:
                    rgb = radiance.gathered(V, V.Color3f, self.data.array, texel, 3, active)
                    light = rgb if V.is_rgb else Value(V.luminance(rgb))
                total += light * weight
            return total * self.scale

    def _spectrum(value: Any) -> Any:
        return V.mueller.depolarizer(value) if V.is_polarized else value

    return EnvcalEmitter


def holder_class(V: Any) -> type[Any]:
    """Return what an emitter of the variant `V`, a module of types, holds: map, emissions, place, and tables made of them."""
    jit, spectral_variant = dr.is_jit_v(V.Float), V.is_spectral
    Emitter: Any = V.Emitter
    Box = V.ScalarBoundingBox3f if jit else V.BoundingBox3f

    class Holder(Emitter):  # type: ignore[misc]
        def __init__(self, props: Any, spectral: SpectralMap | None = None, rgb: Float32 | None = None) -> None:
            # All that can be refused is refused first: an object that was half made would stay in the renderer's
            # registry as long as somebody, as a notebook does, keeps the error, and be asked with the others.
            turn, sphere = V.Transform4f(geometry.rotation(props)), geometry.given_sphere(props)
            scale = geometry.given_scale(V, props)
            self.filename = ""
            if spectral is None and rgb is None:
                spectral, rgb = self._read(props)
            if spectral_variant and spectral is None:
                raise EnvcalError("the spectral variants need coefficients, not RGB.")
            if not spectral_variant and rgb is None:
                raise EnvcalError("the RGB and mono variants need `rgb`, the map in linear sRGB.")
            super().__init__(props)
            self.m_flags = mi.EmitterFlags.Infinite | mi.EmitterFlags.SpatiallyVarying
            self.scale = scale
            self.to_world, self._sphere = turn, sphere
            self.to_local = self.to_world.inverse()
            self.dist: Any = None
            self.emission: Any = None
            self.quads: Any = None
            self.table: Any = None
            if spectral_variant:
                self._keep_spectral(spectral)
            else:
                self._keep_rgb(rgb)
            self._prepare()
            if jit:
                dr.make_opaque(self.scale)

        def _read(self, props: Any) -> tuple[SpectralMap | None, Float32 | None]:
            if "filename" not in props:
                raise EnvcalError('an `envcal` emitter needs "filename": the file of `envcal uplift`.')
            resolver: Any = mi.file_resolver
            path = Path(str(resolver().resolve(str(props["filename"]))))
            self.filename = path.name
            return (loading.load(path), None) if spectral_variant else (None, loading.load_rgb(path))

        def _keep_spectral(self, spectral: Any) -> None:
            self.size = spectral.cluster.shape
            self.data = V.TensorXf(spectral.data)
            self.grid = spectral.wavelengths_nm
            self.emission = V.TensorXf(spectral.emissions.astype(np.float32))
            self.used, self.slot = loading.slots(spectral.cluster, len(spectral.emissions))
            self.quads = None if len(self.used) == 1 else V.TensorXu(loading.quads(self.slot)).array

        def _keep_rgb(self, rgb: Any) -> None:
            self.size = rgb.shape[:2]
            self.data = V.TensorXf(np.ascontiguousarray(rgb, np.float32))

        def to_string(self) -> str:
            return f'EnvcalEmitter[filename = "{self.filename}", res = {self.size[1]}×{self.size[0]}]'

        def bbox(self) -> Any:
            return Box()

        def set_scene(self, scene: Any) -> None:
            """Tell the emitter the scene's bounds; only light tracers (`sample_ray`) need them."""
            self._sphere = geometry.sphere_around(scene.bbox())

        def traverse(self, cb: Any) -> None:
            cb.put("scale", self.scale, mi.ParamFlags.Differentiable)
            cb.put("data", self.data, mi.ParamFlags.Differentiable | mi.ParamFlags.Discontinuous)
            if spectral_variant:
                cb.put("emission", self.emission, mi.ParamFlags.Differentiable | mi.ParamFlags.Discontinuous)
            cb.put("to_world", self.to_world, mi.ParamFlags.NonDifferentiable)

        def parameters_changed(self, keys: list[str] | None = None) -> None:
            if not keys or "to_world" in keys:
                self.to_local = self.to_world.inverse()
            if not keys or {"data", "emission"} & set(keys):
                self._prepare()
            if jit:
                dr.make_opaque(self.scale)

        def _prepare(self) -> None:
            """Make the tables that places and wavelengths are drawn by, and that of the emissions."""
            data = np.asarray(self.data.numpy()).reshape(*self.size, -1)
            if spectral_variant:
                emission = np.array(self.emission.numpy(), np.float64)[self.used]
                weights = sampling.observer_weights(self.grid)
                luminance = loading.luminance(data, self.slot, emission * weights, self.grid)
                mean = sampling.mean_emission(emission, self.slot, data[..., 3])
                self.dist = V.ContinuousDistribution([self.grid[0], self.grid[-1]], mean)
                self.table = radiance.table_of(V, self.emission, self.used)
            else:
                luminance = sampling.luminance_of_rgb(data)
            self.warp = V.Hierarchical2D0(sampling.nodes(luminance))

    return Holder
