"""Places on the map and directions of the emitter's own frame: +Y is up, u = 0 is −Z and u = ¼ is +X.

`V` is the module of types of one Mitsuba variant, such as `mitsuba.llvm_ad_spectral`.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from envcal.errors import EnvcalError

#: The least sin θ: what single precision knows of it beside a pole.
TINY = 2.0**-24


def direction_of(V: Any, u: Any, v: Any) -> tuple[Any, Any]:
    """Return the unit direction of a place (u, v) on the map, and 1 / sin θ."""
    sin_theta, cos_theta = dr.sincos(v * dr.pi)
    sin_phi, cos_phi = dr.sincos(u * dr.two_pi)
    d = V.Vector3f(sin_phi * sin_theta, cos_theta, -cos_phi * sin_theta)
    return d, dr.rcp(dr.maximum(sin_theta, TINY))


def place_of(d: Any) -> tuple[Any, Any, Any]:
    """Return u in 0 … 1, v in 0 … 1 and 1 / sin θ of a unit direction."""
    sin_theta = dr.sqrt(d.x * d.x + d.z * d.z)
    u = dr.atan2(d.x, -d.z) * dr.inv_two_pi
    # acos(y) is off by a third of a row of a 4k map at the poles in single precision; this is not.
    v = dr.atan2(sin_theta, d.y) * dr.inv_pi
    return u - dr.floor(u), v, dr.rcp(dr.maximum(sin_theta, TINY))


def rotation(props: Any) -> Any:
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


def given_scale(V: Any, props: Any) -> Any:
    """Return `scale`; what is no number from 0 is refused."""
    given = props.get("scale", 1.0)
    try:
        scale = V.Float(given)
    except (TypeError, ValueError):
        scale = V.Float(-1.0)
    values = np.ravel(np.array(scale, float))
    if values.size != 1 or not 0 <= values[0] < np.inf:
        raise EnvcalError(f"scale of an `envcal` emitter is {given!r}; expected a number from 0, such as 1.0.")
    return scale


def given_sphere(props: Any) -> tuple[list[float], float] | None:
    """Return `center` and `radius` of the sphere around the scene, or None if none is given."""
    if "radius" not in props:
        return None
    center = props.get("center", [0.0, 0.0, 0.0])
    return [float(v) for v in center], float(props["radius"])


def sphere_around(box: Any) -> tuple[list[float], float]:
    """Return centre and radius of a sphere that holds a scene's bounding box, of next to nothing if that is empty."""
    if not box.valid():
        return [0.0, 0.0, 0.0], 1e-3
    sphere = box.bounding_sphere()
    return [float(v) for v in sphere.center], float(sphere.radius) * (1 + 1e-4)
