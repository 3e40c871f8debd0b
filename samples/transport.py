# ruff: noqa: PLR0912 - kernels take their scalars one by one: numba has no keyword-only arguments
"""Light in a place made of boxes and spheres: ray casting, soft direct light, gathered indirect light.

Every surface is Lambertian, every lamp a uniform Lambertian emitter, so light transport splits into geometry
(numbers without a wavelength, made here once) and spectra (put in later, so that lamps can be exchanged at
no cost). Method:

* **Direct.** The irradiance of a lamp of radiance one is summed over fixed points on it, each with a shadow
  ray: a grid on a panel, equal solid angles in the cone of a globe. The sub-rays of a pixel use shifted
  grids, so a pixel sees the lamp at sub-rays × points places and no noise.
* **Indirect.** Surfaces carry nodes. From each, the same cosine-weighted directions are followed to the
  surfaces that they hit; E = mean of ρ·E over the hits (a final gather), repeated once for every bounce. The
  rows of that mean sum to one, so a closed place of albedo ρ gains exactly 1 + ρ + ρ² + …
  Between nodes irradiance is interpolated bilinearly.

Left out: gloss, transparency, the light that the D65 module casts on the scene (a ten-thousandth of the
lamps' flux), contact shadows of indirect light finer than the nodes.

The kernels work on rows that do not depend on each other, in threads (numba's own parallel loops take three
times as long to compile): results do not depend on the number of threads.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]

PLAIN, CHART, CHECKER, PLANKS = 0, 1, 2, 3
PANEL, GLOBE, SURROUND = 0, 1, 2

# The 24-patch chart, in metres: patches of 40 mm, gaps of 4 mm.
PATCH_M = 0.040
GAP_M = 0.004

WORKERS = os.cpu_count() or 1

_OFF = 1e-6  # metres: shadow and gather rays start this far above their surface


def in_parts(kernel: Callable[..., None], count: int, *arguments: Any) -> None:
    """Run `kernel(first, last, *arguments)` over 0…count in parts, one a thread."""
    edges = [count * k // WORKERS for k in range(WORKERS + 1)]
    with ThreadPoolExecutor(WORKERS) as pool:
        for part in [pool.submit(kernel, a, b, *arguments) for a, b in pairwise(edges)]:
            part.result()


class Geometry(NamedTuple):
    """Boxes (B), spheres (S) and lamps (L) as arrays; box 0 is the room, seen from inside, if `indoors`.

    A box face f = 2·axis + (1 on the positive side). Codes of emitters: lamps 0…L−1, then the module.
    Materials ≥ 0 index reflectances; −1 − e is emitter e.
    """

    indoors: bool
    boxes: Float64  # [B, 16] centre, axes right, up and forward, half sizes, radius of the sphere around
    faces: Int32  # [B, 6, 4] material, texture, the texture's second material, first node
    periods: Float64  # [B, 6] of the textures, metres
    grids: Int32  # [B] nodes along either side of a face
    spheres: Float64  # [S, 4] centre, radius
    sphere_codes: Int32  # [S, 2] material, first of six nodes, in the order of the faces
    lamps: Int32  # [L, 2] kind, box or (B +) sphere


@njit(cache=True, error_model="numpy")
def _box_hit(boxes: Any, i: int, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> Any:
    """Return (near t, its face, far t, its face) of a line and a box; near > far means a miss."""
    near, far = -1e30, 1e30
    near_face, far_face = -1, -1
    px, py, pz = ox - boxes[i, 0], oy - boxes[i, 1], oz - boxes[i, 2]
    for axis in range(3):
        ax, ay, az = boxes[i, 3 + 3 * axis], boxes[i, 4 + 3 * axis], boxes[i, 5 + 3 * axis]
        p = px * ax + py * ay + pz * az
        d = dx * ax + dy * ay + dz * az
        half = boxes[i, 12 + axis]
        if abs(d) < 1e-14:
            if abs(p) > half:
                return 1.0, -1, 0.0, -1
            continue
        low, high = (-half - p) / d, (half - p) / d
        low_face, high_face = 2 * axis, 2 * axis + 1
        if low > high:
            low, high = high, low
            low_face, high_face = high_face, low_face
        if low > near:
            near, near_face = low, low_face
        if high < far:
            far, far_face = high, high_face
        if near > far:
            return 1.0, -1, 0.0, -1
    return near, near_face, far, far_face


@njit(cache=True, error_model="numpy")
def _nearest(
    indoors: bool, boxes: Any, spheres: Any, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> Any:
    """Return (t, shape, face) of the first surface; spheres follow the boxes; shape −1 is nothing."""
    best, shape, face = 1e30, -1, -1
    count = boxes.shape[0]
    for i in range(count):
        if i == 0 and indoors:
            _, _, far, far_face = _box_hit(boxes, i, ox, oy, oz, dx, dy, dz)
            if 0.0 < far < best:
                best, shape, face = far, i, far_face
            continue
        cx, cy, cz, radius = boxes[i, 0] - ox, boxes[i, 1] - oy, boxes[i, 2] - oz, boxes[i, 15]
        along = cx * dx + cy * dy + cz * dz
        if -radius < along < best + radius and cx * cx + cy * cy + cz * cz - along * along < radius * radius:
            near, near_face, far, _ = _box_hit(boxes, i, ox, oy, oz, dx, dy, dz)
            if near <= far and 0.0 < near < best:
                best, shape, face = near, i, near_face
    for i in range(spheres.shape[0]):
        cx, cy, cz = spheres[i, 0] - ox, spheres[i, 1] - oy, spheres[i, 2] - oz
        along = cx * dx + cy * dy + cz * dz
        inside = spheres[i, 3] ** 2 - (cx * cx + cy * cy + cz * cz - along * along)
        if along > 0.0 and inside >= 0.0:
            t = along - np.sqrt(inside)
            if 0.0 < t < best:
                best, shape, face = t, count + i, 0
    return best, shape, face


@njit(cache=True, error_model="numpy")
def _between(
    indoors: bool, boxes: Any, spheres: Any, skip: int, px: float, py: float, pz: float,
    cx: float, cy: float, cz: float, reach: float, found: Any,
) -> int:  # fmt: skip
    """Fill `found` with the shapes that may stand between p and a lamp within `reach` of p + c; count them.

    A shape counts if the sphere around it meets the capsule that holds all rays from p to the lamp.
    """
    length = np.sqrt(cx * cx + cy * cy + cz * cz)
    dx, dy, dz = cx / length, cy / length, cz / length
    number = 0
    count = boxes.shape[0]
    for i in range(1 if indoors else 0, count + spheres.shape[0]):
        if i < count:
            x, y, z, radius = boxes[i, 0] - px, boxes[i, 1] - py, boxes[i, 2] - pz, boxes[i, 15]
        else:
            s = i - count
            x, y, z, radius = spheres[s, 0] - px, spheres[s, 1] - py, spheres[s, 2] - pz, spheres[s, 3]
        along = min(max(x * dx + y * dy + z * dz, 0.0), length)
        # The rays spread like a cone: at `along` they are within reach · along / length of the axis.
        wide = radius + reach * min(1.0, (along + radius) / length)
        x, y, z = x - along * dx, y - along * dy, z - along * dz
        if i != skip and x * x + y * y + z * z <= wide * wide:
            found[number] = i
            number += 1
    return number


@njit(cache=True, error_model="numpy")
def _blocked(
    boxes: Any, spheres: Any, found: Any, number: int, ox: float, oy: float, oz: float,
    dx: float, dy: float, dz: float, limit: float,
) -> bool:  # fmt: skip
    """Return whether one of the first `number` shapes of `found` stands between the origin and `limit`."""
    count = boxes.shape[0]
    for k in range(number):
        i = found[k]
        if i < count:
            near, _, far, _ = _box_hit(boxes, i, ox, oy, oz, dx, dy, dz)
            if near <= far and far > 0.0 and near < limit:
                return True
        else:
            s = i - count
            cx, cy, cz = spheres[s, 0] - ox, spheres[s, 1] - oy, spheres[s, 2] - oz
            along = cx * dx + cy * dy + cz * dz
            inside = spheres[s, 3] ** 2 - (cx * cx + cy * cy + cz * cz - along * along)
            if inside > 0.0:
                reach = np.sqrt(inside)
                if along + reach > 0.0 and along - reach < limit:
                    return True
    return False


@njit(cache=True, error_model="numpy")
def _lamp_light(
    indoors: bool, boxes: Any, spheres: Any, kind: int, shape: int, px: float, py: float, pz: float,
    nx: float, ny: float, nz: float, points: int, shift_u: float, shift_v: float, found: Any,
) -> float:  # fmt: skip
    """Return the irradiance at p with normal n of a lamp of radiance one, over points² places on it."""
    if kind == SURROUND:
        return np.pi  # nothing but the fronts of chart and module stands in a surround
    total = 0.0
    if kind == PANEL:
        # The emitting face is the box's forward one.
        half_u, half_v, depth = boxes[shape, 12], boxes[shape, 13], boxes[shape, 14]
        ux, uy, uz = boxes[shape, 3], boxes[shape, 4], boxes[shape, 5]
        vx, vy, vz = boxes[shape, 6], boxes[shape, 7], boxes[shape, 8]
        wx, wy, wz = boxes[shape, 9], boxes[shape, 10], boxes[shape, 11]
        cx, cy, cz = boxes[shape, 0] - px, boxes[shape, 1] - py, boxes[shape, 2] - pz
        cx, cy, cz = cx + wx * depth, cy + wy * depth, cz + wz * depth
        side = abs(nx * ux + ny * uy + nz * uz) * half_u + abs(nx * vx + ny * vy + nz * vz) * half_v
        if cx * nx + cy * ny + cz * nz < -side or cx * wx + cy * wy + cz * wz >= 0.0:
            return 0.0
        number = _between(indoors, boxes, spheres, shape, px, py, pz, cx, cy, cz, boxes[shape, 15], found)
        area = 4.0 * half_u * half_v / (points * points)
        for i in range(points):
            u = half_u * (2.0 * (i + shift_u) / points - 1.0)
            for j in range(points):
                v = half_v * (2.0 * (j + shift_v) / points - 1.0)
                x, y, z = cx + u * ux + v * vx, cy + u * uy + v * vy, cz + u * uz + v * vz
                square = x * x + y * y + z * z
                here = x * nx + y * ny + z * nz
                there = -(x * wx + y * wy + z * wz)
                if here > 0.0 and there > 0.0:
                    r = np.sqrt(square)
                    if not _blocked(boxes, spheres, found, number, px, py, pz, x / r, y / r, z / r, r):
                        total += here * there * area / (square * square)
        return total
    s = shape - boxes.shape[0]
    radius = spheres[s, 3]
    cx, cy, cz = spheres[s, 0] - px, spheres[s, 1] - py, spheres[s, 2] - pz
    distance = np.sqrt(cx * cx + cy * cy + cz * cz)
    if distance <= radius * 1.0001 or cx * nx + cy * ny + cz * nz < -radius:
        return 0.0
    number = _between(indoors, boxes, spheres, shape, px, py, pz, cx, cy, cz, radius, found)
    cx, cy, cz = cx / distance, cy / distance, cz / distance
    # Any two directions that make a frame with the one to the globe.
    if abs(cy) < 0.9:
        side = np.sqrt(cx * cx + cz * cz)
        ux, uy, uz = cz / side, 0.0, -cx / side
    else:
        side = np.sqrt(cy * cy + cz * cz)
        ux, uy, uz = 0.0, -cz / side, cy / side
    vx, vy, vz = cy * uz - cz * uy, cz * ux - cx * uz, cx * uy - cy * ux
    sine = radius / distance
    versine = sine * sine / (1.0 + np.sqrt(1.0 - sine * sine))
    solid_angle = 2.0 * np.pi * versine / (points * points)
    for i in range(points):
        cosine = 1.0 - versine * (i + shift_u) / points
        flat = np.sqrt(1.0 - cosine * cosine)
        # Up to the surface of the globe along these directions.
        t = distance * cosine - np.sqrt(max(0.0, radius**2 - distance**2 * (1.0 - cosine * cosine)))
        for j in range(points):
            turn = 2.0 * np.pi * (j + shift_v) / points
            a, c = flat * np.cos(turn), flat * np.sin(turn)
            x, y, z = cosine * cx + a * ux + c * vx, cosine * cy + a * uy + c * vy, cosine * cz + a * uz + c * vz
            here = x * nx + y * ny + z * nz
            if here > 0.0 and not _blocked(boxes, spheres, found, number, px, py, pz, x, y, z, t):
                total += here * solid_angle
    return total


@njit(cache=True, error_model="numpy")
def _chart_material(x: float, y: float, first: int, frame: int) -> int:
    """Return the material at (x right, y up) metres from the chart's centre: a patch, or the frame."""
    pitch = PATCH_M + GAP_M
    column = x / pitch + 3.0
    row = 2.0 - y / pitch
    i, j = int(np.floor(column)), int(np.floor(row))
    inside = 0.5 * PATCH_M / pitch
    if 0 <= i < 6 and 0 <= j < 4 and abs(column - i - 0.5) <= inside and abs(row - j - 0.5) <= inside:
        return first + 6 * j + i
    return frame


@njit(cache=True, error_model="numpy")
def _material(faces: Any, periods: Any, i: int, face: int, u: float, v: float) -> int:
    """Return the material at (u, v) metres from the middle of a face of box i."""
    material, texture, other = faces[i, face, 0], faces[i, face, 1], faces[i, face, 2]
    if texture == PLAIN:
        return material
    if texture == CHART:
        return _chart_material(u, v, material, other)
    cell = int(np.floor(u / periods[i, face] + 0.173))
    if texture == CHECKER:
        cell += int(np.floor(v / periods[i, face] + 0.311))
    return material if cell % 2 == 0 else other


@njit(cache=True, error_model="numpy")
def _sphere_nodes(g: Any, i: int, p: int, r: int, normals: Any, nodes: Any, weights: Any) -> None:
    """Fill the nodes of a point of sphere i: the squares of the normal's parts weigh the axes it faces."""
    for axis in range(3):
        n = normals[p, r, axis]
        nodes[p, r, axis] = g.sphere_codes[i, 1] + 2 * axis + (1 if n > 0 else 0)
        weights[p, r, axis] = n * n


@njit(cache=True, error_model="numpy")
def _box_nodes(g: Any, i: int, face: int, u: float, v: float, p: int, r: int, nodes: Any, weights: Any) -> None:
    """Fill the four nodes around a point of a face of box i; u and v run from −1 to 1 over it."""
    n = g.grids[i]
    a = min(max(0.5 * (u + 1.0) * n - 0.5, 0.0), n - 1.0)
    b = min(max(0.5 * (v + 1.0) * n - 0.5, 0.0), n - 1.0)
    column, row = min(int(a), max(n - 2, 0)), min(int(b), max(n - 2, 0))
    a, b = a - column, b - row
    for k in range(4):
        right, down = k % 2, k // 2
        nodes[p, r, k] = g.faces[i, face, 3] + min(row + down, n - 1) * n + min(column + right, n - 1)
        weights[p, r, k] = (a if right else 1.0 - a) * (b if down else 1.0 - b)


@njit(cache=True, error_model="numpy", nogil=True)
def hit(
    first: int, last: int, g: Geometry, origins: Float64, directions: Float64, materials: npt.NDArray[np.int16],
    places: Float64, normals: Float64, nodes: npt.NDArray[np.int16], weights: npt.NDArray[np.float32],
) -> None:  # fmt: skip
    """Follow `directions`, shape (P, R, 3), from `origins`, shape (P, 3), and fill what each meets.

    `materials` (P, R); `places`, just above the surface, and `normals` (P, R, 3); `nodes` and `weights`
    (P, R, 4) of the indirect light. A ray that meets nothing sees emitter 0, the surround.
    """
    count = g.boxes.shape[0]
    for p in range(first, last):
        ox, oy, oz = origins[p, 0], origins[p, 1], origins[p, 2]
        for r in range(directions.shape[1]):
            dx, dy, dz = directions[p, r, 0], directions[p, r, 1], directions[p, r, 2]
            t, shape, face = _nearest(g.indoors, g.boxes, g.spheres, ox, oy, oz, dx, dy, dz)
            for k in range(4):
                nodes[p, r, k] = 0
                weights[p, r, k] = 0.0
            material = -1
            if shape >= 0:
                x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
                if shape >= count:
                    i = shape - count
                    material = g.sphere_codes[i, 0]
                    radius = g.spheres[i, 3]
                    normals[p, r, 0] = (x - g.spheres[i, 0]) / radius
                    normals[p, r, 1] = (y - g.spheres[i, 1]) / radius
                    normals[p, r, 2] = (z - g.spheres[i, 2]) / radius
                    _sphere_nodes(g, i, p, r, normals, nodes, weights)
                else:
                    axis, iu, iv = face // 2, (face // 2 + 1) % 3, (face // 2 + 2) % 3
                    outwards = (face % 2 == 1) != (shape == 0 and g.indoors)
                    u, v = 0.0, 0.0
                    for k in range(3):
                        normal = g.boxes[shape, 3 + 3 * axis + k]
                        normals[p, r, k] = normal if outwards else -normal
                        at = (x if k == 0 else (y if k == 1 else z)) - g.boxes[shape, k]
                        u += at * g.boxes[shape, 3 + 3 * iu + k]
                        v += at * g.boxes[shape, 3 + 3 * iv + k]
                    half_u, half_v = g.boxes[shape, 12 + iu], g.boxes[shape, 12 + iv]
                    _box_nodes(g, shape, face, u / half_u, v / half_v, p, r, nodes, weights)
                    material = _material(g.faces, g.periods, shape, face, u, v)
                places[p, r, 0] = x + _OFF * normals[p, r, 0]
                places[p, r, 1] = y + _OFF * normals[p, r, 1]
                places[p, r, 2] = z + _OFF * normals[p, r, 2]
            materials[p, r] = material


@njit(cache=True, error_model="numpy", nogil=True)
def shine(
    first: int, last: int, g: Geometry, materials: npt.NDArray[np.int16], places: Float64, normals: Float64, shifts: Float64,
    points: int, light: npt.NDArray[np.float32],
) -> None:  # fmt: skip
    """Fill `light` (P, R, L): irradiance per radiance of each lamp at `places` with `normals`, (P, R, 3).

    `shifts` (R, 2) in 0…1 moves ray r's grid of points² places on the lamps. Emitters receive nothing.
    """
    for p in range(first, last):
        found = np.empty(g.boxes.shape[0] + g.spheres.shape[0], np.int64)
        for r in range(places.shape[1]):
            for i in range(g.lamps.shape[0]):
                light[p, r, i] = 0.0
                if materials[p, r] >= 0:
                    light[p, r, i] = _lamp_light(
                        g.indoors, g.boxes, g.spheres, g.lamps[i, 0], g.lamps[i, 1],
                        places[p, r, 0], places[p, r, 1], places[p, r, 2],
                        normals[p, r, 0], normals[p, r, 1], normals[p, r, 2],
                        points, shifts[r, 0], shifts[r, 1], found,
                    )  # fmt: skip


@njit(cache=True, error_model="numpy", nogil=True)
def bounce(
    first: int, last: int, cells: npt.NDArray[np.int16], materials: npt.NDArray[np.int16],
    shares: Float64, before: Float64, after: Float64,
) -> None:  # fmt: skip
    """Fill `after` (N, L, W) with the mean of ρ·E over the hits of each node, E being `before` (N, L, W).

    `shares` (M, W) is ρ over the number of hits.
    """
    rays, lamps, bands = cells.shape[1], before.shape[1], before.shape[2]
    for n in range(first, last):
        for lamp in range(lamps):
            for w in range(bands):
                after[n, lamp, w] = 0.0
        for q in range(rays):
            material = materials[n, q]
            if material >= 0:
                for lamp in range(lamps):
                    for w in range(bands):
                        after[n, lamp, w] += shares[material, w] * before[cells[n, q], lamp, w]


@njit(cache=True, error_model="numpy", nogil=True)
def respond(
    first: int, last: int, materials: npt.NDArray[np.int16], light: npt.NDArray[np.float32], nodes: npt.NDArray[np.int16],
    weights: npt.NDArray[np.float32], emitted: Float64, direct: Float64, indirect: Float64, out: Float64,
) -> None:  # fmt: skip
    """Fill `out` (P, K) with the mean over a pixel's rays of K linear responses to radiance.

    `emitted` (E, K) for the emitters, `direct` (M, L, K) for a material under irradiance one of a lamp's
    radiance, `indirect` (M, N, K) for a material at a node.
    """
    rays, lamps, responses = materials.shape[1], light.shape[2], out.shape[1]
    for p in range(first, last):
        for k in range(responses):
            total = 0.0
            for s in range(rays):
                m = materials[p, s]
                if m < 0:
                    total += emitted[-1 - m, k]
                    continue
                for lamp in range(lamps):
                    total += light[p, s, lamp] * direct[m, lamp, k]
                for j in range(4):
                    total += weights[p, s, j] * indirect[m, nodes[p, s, j], k]
            out[p, k] = total / rays
