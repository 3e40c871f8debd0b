"""The square equal-area map of the sphere that pbrt-v4 wants of an infinite light.

P. Clarberg, "Fast Equal-Area Mapping of the (Hemi)Sphere using SIMD", Journal of Graphics Tools 13(3), 2008: the sphere is
an octahedron unfolded into a square, its upper half (+z) the inner diamond, and equal areas stay equal. Directions in the
frame of pbrt's lights: z is up, and a lat-long map has u = φ/2π from +x towards +y, as pbrt's own conversion takes it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit, prange

Float64 = npt.NDArray[np.float64]

#: Side of the square over the width of the lat-long map. At 1/√π ≈ 0.56 a texel covers what one on the horizon did.
SIDE_RATIO = 0.75
#: Samples a side of each texel; a lat-long texel on the horizon then has about 28 of them.
SAMPLES = 4


def sphere_of(u: npt.ArrayLike, v: npt.ArrayLike) -> Float64:
    """Return the directions [..., 3] of places (u, v) in the unit square."""
    a, b = 2.0 * np.asarray(u, np.float64) - 1.0, 2.0 * np.asarray(v, np.float64) - 1.0
    inside = 1.0 - np.abs(a) - np.abs(b)  # > 0 in the inner diamond, the upper half
    radius = 1.0 - np.abs(inside)
    turn = np.where(radius > 0, (np.abs(b) - np.abs(a)) / np.where(radius > 0, radius, 1.0), 0.0)
    phi = (turn + 1.0) * np.pi / 4.0
    height = np.copysign(1.0 - radius * radius, inside)
    across = radius * np.sqrt(np.maximum(2.0 - radius * radius, 0.0))
    return np.stack([np.copysign(np.cos(phi) * across, a), np.copysign(np.sin(phi) * across, b), height], axis=-1)


def square_of(direction: npt.ArrayLike) -> Float64:
    """Return the places (u, v) [..., 2] of unit directions [..., 3]: the inverse of `sphere_of`."""
    d = np.asarray(direction, np.float64)
    radius = np.sqrt(np.maximum(1.0 - np.abs(d[..., 2]), 0.0))
    share = np.arctan2(np.abs(d[..., 1]), np.abs(d[..., 0])) * 2.0 / np.pi  # 0 on the x axis, 1 on the y axis
    b = share * radius
    a = radius - b
    below = d[..., 2] < 0
    a, b = np.where(below, 1.0 - b, a), np.where(below, 1.0 - a, b)
    return np.stack([(np.copysign(a, d[..., 0]) + 1.0) / 2.0, (np.copysign(b, d[..., 1]) + 1.0) / 2.0], axis=-1)


def side_of(width: int) -> int:
    """Return the side of the square for a lat-long map of this width, even."""
    return max(4, 2 * round(SIDE_RATIO * width / 2))


def resampled(
    latlong: npt.NDArray[np.float32], cluster: npt.NDArray[np.uint8], only: int, side: int
) -> npt.NDArray[np.float32]:
    """Return the square map [side, side, 3] of the pixels of one cluster of a lat-long map [H, W, 3].

    Each texel is the mean of 16 bilinear samples; the sum over all clusters is the resampled map.
    """
    out = np.empty((side, side, 3), np.float32)
    u = (np.arange(side * SAMPLES) + 0.5) / (side * SAMPLES)
    _gather(latlong, cluster, only, u, out)
    return out


@njit(cache=True, error_model="numpy", parallel=True)
def _gather(latlong, cluster, only, places, out):  # type: ignore[no-untyped-def]
    height, width = cluster.shape
    side = out.shape[0]
    samples = places.size // side
    for row in prange(side):
        for column in range(side):
            red = green = blue = 0.0
            for j in range(samples):
                b = 2.0 * places[row * samples + j] - 1.0
                for i in range(samples):
                    a = 2.0 * places[column * samples + i] - 1.0
                    inside = 1.0 - abs(a) - abs(b)
                    radius = 1.0 - abs(inside)
                    turn = (abs(b) - abs(a)) / radius if radius > 0.0 else 0.0
                    phi = (turn + 1.0) * np.pi / 4.0
                    z = (1.0 - radius * radius) if inside >= 0.0 else (radius * radius - 1.0)
                    x = np.cos(phi) if a >= 0.0 else -np.cos(phi)
                    y = np.sin(phi) if b >= 0.0 else -np.sin(phi)
                    longitude = np.arctan2(y, x)
                    if longitude < 0.0:
                        longitude += 2.0 * np.pi
                    s = longitude / (2.0 * np.pi) * width - 0.5
                    t = min(max(np.arccos(min(1.0, max(-1.0, z))) / np.pi * height - 0.5, 0.0), height - 1.0)
                    left, top = int(np.floor(s)), int(t)
                    fs, ft = s - left, t - top
                    for dy in range(2):
                        wy = ft if dy else 1.0 - ft
                        r = min(top + dy, height - 1)
                        for dx in range(2):
                            c = (left + dx) % width
                            if cluster[r, c] == only:
                                w = wy * (fs if dx else 1.0 - fs)
                                red += w * latlong[r, c, 0]
                                green += w * latlong[r, c, 1]
                                blue += w * latlong[r, c, 2]
            n = samples * samples
            out[row, column, 0] = red / n
            out[row, column, 1] = green / n
            out[row, column, 2] = blue / n
