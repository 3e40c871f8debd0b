"""The emitter itself, one class for each Mitsuba variant.

The conventions are those of Mitsuba's own `envmap`: local +Y is up, u = 0 is −Z and u = ¼ is +X, radiance of a white of
Y = 1 renders as 1. What differs: radiance of the four nearest texels is interpolated, not their coefficients; rows are centred
in their band of latitude (v = (y + ½)/height), and the outermost ones reach to the poles.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from envcal.errors import EnvcalError
from envcal.mitsuba import loading, sampling
from envcal.mitsuba.loading import CENTRE_NM, HALF_NM, Float32, SpectralMap

#: Distance at which the emitter pretends to stand: beyond every scene, and its square still far from overflow.
FAR = 1e10
#: The least sin θ: what single precision knows of it beside a pole.
TINY = 2.0**-24
#: Emissions that one packet of 16 floats brings, in pairs. Maps have fewer; more are looked up one by one.
_PACKET = 8
#: Brings Y = 1 of the file to what Mitsuba's film develops to 1.
WHITE = 1.0 / mi.MI_CIE_Y_NORMALIZATION


def emitter_class(variant: str) -> type[Any]:
    """Return the emitter for one variant; its module of types is bound here, since methods run in any thread."""
    V: Any = import_module(f"mitsuba.{variant}")
    jit, spectral_variant, rgb_variant = dr.is_jit_v(V.Float), V.is_spectral, V.is_rgb
    polarized = V.is_polarized
    Value = V.UnpolarizedSpectrum
    Emitter: Any = V.Emitter
    Box = V.ScalarBoundingBox3f if jit else V.BoundingBox3f

    class EnvcalEmitter(Emitter):  # type: ignore[misc]
        def __init__(self, props: Any, spectral: SpectralMap | None = None, rgb: Float32 | None = None) -> None:
            # All that can be refused is refused first: an object that was half made would stay in the renderer's
            # registry as long as somebody, as a notebook does, keeps the error, and be asked with the others.
            turn, bounds = V.Transform4f(_rotation(props)), _given_bounds(props)
            self.filename = ""
            if spectral is None and rgb is None:
                spectral, rgb = self._read(props)
            if spectral_variant and spectral is None:
                raise EnvcalError("the spectral variants need coefficients, not RGB.")
            if not spectral_variant and rgb is None:
                raise EnvcalError("the RGB and mono variants need `rgb`, the map in linear sRGB.")
            super().__init__(props)
            self.m_flags = mi.EmitterFlags.Infinite | mi.EmitterFlags.SpatiallyVarying
            self.scale = V.Float(props.get("scale", 1.0))
            self.to_world, self._bounds = turn, bounds
            self.to_local = self.to_world.inverse()
            self.dist: Any = None
            self.emission: Any = None
            self.quads: Any = None
            self.table: Any = None
            if spectral_variant:
                self._keep_spectral(spectral)
            else:
                self._keep_rgb(rgb)
            self._prepare_sampling()
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
            self.height, self.width = spectral.cluster.shape
            self.data = V.TensorXf(spectral.data)
            self.grid = spectral.wavelengths_nm
            self.emission = V.TensorXf(spectral.emissions.astype(np.float32))
            self.used, slot = loading.slots(spectral.cluster, len(spectral.emissions))
            self.slot = slot
            self.quads = None if len(self.used) == 1 else V.TensorXu(loading.quads(slot)).array

        def _keep_rgb(self, rgb: Any) -> None:
            self.height, self.width = rgb.shape[:2]
            self.data = V.TensorXf(np.ascontiguousarray(rgb, np.float32))

        # -- what Mitsuba asks of every object

        def to_string(self) -> str:
            return f'EnvcalEmitter[filename = "{self.filename}", res = {self.width}×{self.height}]'

        def bbox(self) -> Any:
            return Box()

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
                self._prepare_sampling()
            if jit:
                dr.make_opaque(self.scale)

        def set_scene(self, scene: Any) -> None:
            """Tell the emitter the scene's bounds; only light tracers (`sample_ray`) need them."""
            box = scene.bbox()
            if box.valid():
                sphere = box.bounding_sphere()
                self._bounds = ([float(v) for v in sphere.center], float(sphere.radius) * (1 + 1e-4))
            else:
                self._bounds = ([0.0, 0.0, 0.0], 1e-3)

        # -- sampling tables

        def _prepare_sampling(self) -> None:
            if spectral_variant:
                data = np.asarray(self.data.numpy()).reshape(self.height, self.width, 4)
                emission = np.array(self.emission.numpy(), np.float64)[self.used]
                weights = _observer_weights(self.grid)
                luminance = loading.luminance(data, self.slot, emission * weights, self.grid)
                self._prepare_wavelengths(emission, data[..., 3])
                self._prepare_emission()
            else:
                rgb = np.asarray(self.data.numpy()).reshape(self.height, self.width, 3)
                luminance = sampling.luminance_of_rgb(rgb)
            self.warp = V.Hierarchical2D0(sampling.nodes(luminance))

        def _prepare_emission(self) -> None:
            """Lay the emissions out as they are read: node by node (E here, E at the next) of each slot."""
            if jit:
                slots = _PACKET if len(self.used) <= _PACKET else len(self.used)
                index = loading.packed(self.used, len(self.grid), slots)
                self.table = dr.gather(V.Float, self.emission.array, V.UInt32(index)) * WHITE
                dr.eval(self.table)

        def _prepare_wavelengths(self, emission: Any, scale: Any) -> None:
            share = np.bincount(self.slot.ravel(), weights=scale.ravel(), minlength=len(emission))
            mean = share @ emission if share.any() else emission.mean(axis=0)
            # A little of every wavelength: a later change of the emissions is then still sampled without bias.
            mean = mean / max(mean.max(), 1e-30) + 1e-3
            self.dist = V.ContinuousDistribution([self.grid[0], self.grid[-1]], mean.astype(np.float32))

        # -- geometry

        def _direction(self, u: Any, v: Any) -> tuple[Any, Any]:
            """Return the local direction and 1 / sin θ."""
            sin_theta, cos_theta = dr.sincos(v * dr.pi)
            sin_phi, cos_phi = dr.sincos(u * dr.two_pi)
            d = V.Vector3f(sin_phi * sin_theta, cos_theta, -cos_phi * sin_theta)
            return d, dr.rcp(dr.maximum(sin_theta, TINY))

        def _uv(self, d: Any) -> tuple[Any, Any, Any]:
            """Return u in 0 … 1, v in 0 … 1 and 1 / sin θ of a local unit direction."""
            sin_theta = dr.sqrt(d.x * d.x + d.z * d.z)
            u = dr.atan2(d.x, -d.z) * dr.inv_two_pi
            # acos(y) is off by a third of a row of a 4k map at the poles in single precision; this is not.
            v = dr.atan2(sin_theta, d.y) * dr.inv_pi
            return u - dr.floor(u), v, dr.rcp(dr.maximum(sin_theta, TINY))

        def _sample_uv(self, sample: Any, active: Any) -> tuple[Any, Any, Any]:
            """Return u, v and the density over the sphere, without its 1 / sin θ."""
            at, density = self.warp.sample(V.Point2f(sample), [], active)
            row, rows = at.y * (self.height + 1), float(self.height)
            above, below = dr.maximum(1 - row, 0), dr.maximum(row - rows, 0)
            v = (row - 0.5 + 0.5 * (above - below)) * (1 / rows)
            return at.x + 0.5 / self.width, v, density * self._row_density((above > 0) | (below > 0))

        def _density(self, u: Any, v: Any, active: Any) -> Any:
            at, rows = u - 0.5 / self.width, float(self.height)
            row = v * rows + 0.5
            above, below = dr.maximum(1 - row, 0), dr.maximum(row - rows, 0)
            row += below - above
            density = self.warp.eval(V.Point2f(at - dr.floor(at), row * (1 / (rows + 1))), [], active)
            return density * self._row_density((above > 0) | (below > 0))

        def _row_density(self, polar: Any) -> Any:
            """Return d(row)/dv over 2π²(height + 1); the polar half rows count for a whole one."""
            k = self.height / ((self.height + 1) * 2 * np.pi**2)
            return dr.select(polar, V.Float(2 * k), V.Float(k))

        # -- radiance

        def _radiance(self, u: Any, v: Any, wavelengths: Any, active: Any) -> Any:
            x = u * self.width - 0.5
            y = dr.clip(v * self.height - 0.5, 0.0, self.height - 1.0)
            x0, y0 = dr.floor(x), dr.minimum(dr.floor(y), self.height - 2.0)
            fx, fy = x - x0, y - y0
            column, row = V.Int32(x0), V.Int32(y0)
            left = dr.select(column < 0, self.width - 1, dr.minimum(column, self.width - 1))
            right = dr.select(column + 1 >= self.width, 0, column + 1)
            corners = (
                (left, row, (1 - fx) * (1 - fy)),
                (right, row, fx * (1 - fy)),
                (left, row + 1, (1 - fx) * fy),
                (right, row + 1, fx * fy),
            )
            light = None
            if spectral_variant:
                light = self._light(wavelengths, V.UInt32(row * self.width + left), active)
            total: Any = Value(0.0)
            for k, (i, j, weight) in enumerate(corners):
                total += self._texel(V.UInt32(j * self.width + i), k, light, active) * weight
            return total * self.scale

        def _light(self, wavelengths: Any, quad: Any, active: Any) -> tuple[Any, Any]:
            """Return t, and what gives E(λ) of the corners 0 … 3 of a quad of texels."""
            last, first = len(self.grid) - 1, float(self.grid[0])
            step = (float(self.grid[-1]) - first) / last
            at = (wavelengths - first) * (1 / step)
            inside = dr.select((at >= 0) & (at <= last), Value(1.0), Value(0.0))
            node = dr.clip(dr.floor(at), 0.0, last - 1.0)
            # From the node, not as at − node, which beside a spectral line is too coarse.
            fraction, many = (wavelengths - dr.fma(node, step, first)) * (1 / step), len(self.used)
            packed = 0 if self.quads is None else _gather(V.UInt32, self.quads, quad, 1, active)
            lights = self._all_lights(node, fraction, inside, active) if jit and many <= _PACKET else []

            def of_corner(corner: int) -> Any:
                slot = (packed >> (8 * corner)) & 255
                if not lights:
                    return self._one_light(slot, node, fraction, active) * inside
                found = lights[0]
                for k in range(1, many):
                    found = dr.select(slot == k, lights[k], found)
                return found

            return (wavelengths - CENTRE_NM) * (1 / HALF_NM), of_corner

        def _all_lights(self, node: Any, fraction: Any, inside: Any, active: Any) -> list[Any]:
            """Return E(λ) of every slot: with one packet a wavelength they cost less than the texels' own, one by one."""
            values: list[list[Any]] = [[] for _ in self.used]
            for k in range(len(node)):
                packet = dr.gather(V.Matrix4f, self.table, V.UInt32(node[k]), active)
                for slot, found in enumerate(values):
                    here, there = packet[slot // 2, 2 * (slot % 2)], packet[slot // 2, 2 * (slot % 2) + 1]
                    found.append(dr.fma(there - here, fraction[k], here))
            return [Value(found) * inside for found in values]

        def _one_light(self, slot: Any, node: Any, fraction: Any, active: Any) -> Any:
            """Return E(λ) of one slot."""
            found = []
            for k in range(len(node)):
                if jit:
                    pair = dr.gather(V.Vector2f, self.table, V.UInt32(node[k]) * len(self.used) + slot, active)
                    here, there = pair.x, pair.y
                else:
                    at = int(self.used[slot]) * len(self.grid) + int(node[k])
                    here, there = (self.emission.array[at + k] * WHITE for k in (0, 1))
                found.append(dr.fma(there - here, fraction[k], here))
            return Value(found)

        def _texel(self, texel: Any, corner: int, light: Any, active: Any) -> Any:
            """Return the radiance of one texel."""
            if light is None:
                rgb = _gather(V.Color3f, self.data.array, texel, 3, active)
                return rgb if rgb_variant else Value(V.luminance(rgb))
            t, emission = light
            c = _gather(V.Vector4f, self.data.array, texel, 4, active)
            x = dr.fma(dr.fma(Value(c.x), t, Value(c.y)), t, Value(c.z))
            # S(−|x|) without the cancellation of ½ − ½|x|/√(1 + x²), which is all that is left of a deep colour.
            cosine = dr.rsqrt(dr.fma(x, x, 1.0))
            low = 0.5 * cosine * cosine * dr.rcp(dr.fma(dr.abs(x), cosine, 1.0))
            return emission(corner) * dr.select(x < 0, low, 1.0 - low) * c.w

        # -- what renderers ask

        def eval(self, si: Any, active: Any = True) -> Any:
            u, v, _ = self._uv(self.to_local @ -si.wi)
            return _spectrum(self._radiance(u, v, si.wavelengths, active))

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            u, v, density = self._sample_uv(sample, active)
            local, inverse_sine = self._direction(u, v)
            active = active & (density > 0)
            d = self.to_world @ local
            ds = V.DirectionSample3f()
            ds.p, ds.n, ds.d, ds.dist = it.p + d * FAR, -d, d, FAR
            ds.uv = V.Point2f(u - dr.floor(u), v)
            ds.time, ds.delta, ds.emitter = it.time, False, V.EmitterPtr(self) if jit else self
            ds.pdf = dr.select(active, density * inverse_sine, 0.0)
            weight = dr.select(active, dr.rcp(ds.pdf), 0.0)
            return ds, _spectrum(self._radiance(ds.uv.x, v, it.wavelengths, active) * weight)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:  # noqa: ARG002
            u, v, inverse_sine = self._uv(self.to_local @ ds.d)
            return self._density(u, v, active) * inverse_sine

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return _spectrum(self._radiance(ds.uv.x, ds.uv.y, it.wavelengths, active))

        def sample_wavelengths(self, si: Any, sample: Any, active: Any = True) -> Any:
            wavelengths, weight = self._draw_wavelengths(sample)
            u, v = si.uv.x, si.uv.y
            return wavelengths, _spectrum(self._radiance(u - dr.floor(u), v, wavelengths, active) * weight)

        def _draw_wavelengths(self, sample: Any) -> tuple[Any, Any]:
            """Return wavelengths and 1 / their densities; outside the spectral variants there are none to draw."""
            if not spectral_variant:
                return type(V.SurfaceInteraction3f().wavelengths)(), Value(1.0)
            shifted = V.sample_shifted(sample)
            drawn, weights = [], []
            for k in range(len(shifted)):
                wavelength, density = self.dist.sample_pdf(shifted[k])
                drawn.append(wavelength)
                weights.append(dr.select(density > 0, dr.rcp(density), 0.0))
            return type(shifted)(drawn), Value(weights)

        def sample_ray(self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True) -> Any:
            if self._bounds is None:
                raise EnvcalError(
                    "light is traced from the emitter, which does not know where the scene is (Mitsuba tells emitters "
                    "written in Python nothing). Call `scene.environment().set_scene(scene)` after loading, or give "
                    "the emitter `center` and `radius` of a sphere around the scene."
                )
            center, radius = V.Point3f(self._bounds[0]), self._bounds[1]
            u, v, density = self._sample_uv(sample3, active)
            local, inverse_sine = self._direction(u, v)
            active = active & (density > 0)
            d = self.to_world @ local
            disk = V.warp.square_to_uniform_disk_concentric(V.Point2f(sample2))
            origin = center + (V.Frame3f(d).to_world(V.Vector3f(disk.x, disk.y, 0)) + d) * radius
            wavelengths, weight = self._draw_wavelengths(sample1)
            weight *= np.pi * radius**2 * dr.select(active, dr.rcp(density * inverse_sine), 0.0)
            radiance = self._radiance(u - dr.floor(u), v, wavelengths, active)
            return V.Ray3f(origin, -d, time, wavelengths), _spectrum(radiance * weight)

        def sample_position(self, time: Any, sample: Any, active: Any = True) -> Any:  # noqa: ARG002
            """Return nothing of use: light from infinitely far starts nowhere. Mitsuba's `envmap` does the same."""
            if not jit:
                raise EnvcalError("an environment map has no positions to sample; use sample_direction or sample_ray.")
            return dr.zeros(V.PositionSample3f), V.Float(float("nan"))

    def _spectrum(value: Any) -> Any:
        return V.mueller.depolarizer(value) if polarized else value

    def _gather(kind: Any, array: Any, index: Any, width: int, active: Any) -> Any:
        """Return element `index` of records of `width` floats."""
        if jit:
            return dr.gather(kind, array, index, active)
        at = index * width
        return array[at] if width == 1 else kind([array[at + k] for k in range(width)])

    return EnvcalEmitter


def _rotation(props: Any) -> Any:
    """Return `to_world` without its translation and even scale; anything but rotation and mirroring is refused."""
    given = props.get("to_world", None)
    if given is None:
        return mi.ScalarTransform4f()
    matrix = np.array(given.matrix, float)[:3, :3]
    size = np.cbrt(abs(np.linalg.det(matrix)))
    if not size > 0 or np.abs(matrix @ matrix.T / size**2 - np.eye(3)).max() > 1e-4:
        raise EnvcalError("to_world of an environment map may rotate and mirror; it may not stretch or shear.")
    whole = np.eye(4)
    whole[:3, :3] = matrix / size
    return mi.ScalarTransform4f(whole.tolist())


def _given_bounds(props: Any) -> tuple[list[float], float] | None:
    if "radius" not in props:
        return None
    center = props.get("center", [0.0, 0.0, 0.0])
    return [float(v) for v in center], float(props["radius"])


def _observer_weights(wavelengths_nm: Any) -> Any:
    """Return ȳ Δλ of the CIE 1931 observer, as Mitsuba has it; only sampling rests on it."""
    observer: Any = mi.cie1931_y
    values = [np.ravel(observer(float(wavelength)))[0] for wavelength in wavelengths_nm]
    return np.array(values, np.float64) * np.diff(wavelengths_nm)[0]
