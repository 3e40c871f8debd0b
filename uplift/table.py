"""Look-up table of the sigmoid reflectances under one light.

A colour is taken relative to the light: G = `axes` @ rgb with G = (1, 1, 1) for the light itself. Only the
ratios of G to its largest component matter, since P = scale · E · R keeps one brightness free; so the table
has two dimensions for each of the three components that may be the largest, not three (as rgb2spec has,
Jakob and Hanika 2019). Each node is solved by damped Gauss–Newton under the light, starting from its
neighbour, and the first one from grey.

**How bright R is.** The largest component of E·R is 1/`factor` (2 in Tódová and Wilkie 2024), or 0.8 of the
brightest that any R below one can be (MacAdam 1935) where that is less, with a smooth passage between the two.
Near the border of what the light can show little is left: pure BT.2020 red under D65 is one wavelength. Each
node keeps its own `level`, lower still where the sigmoid does not reach that one. So colours inside the cone
that the light spans have an exact spectrum under that light; scale makes up for the darkness.

**Between the nodes.** Coefficients and 1/level are bicubic: Hermite's polynomials through the nodes and their
differences. Each cell is tried at five points when the table is built, and its `grades` say whether linear or
cubic interpolation is good enough by itself, or at least a start from which Newton's method converges at once.

**Axes.** The working space's own, divided by the light's RGB, wherever those are clearly positive. The blue
of very warm light is zero or negative (below about 1900 K in sRGB, 1060 K in BT.2020): then the axes of
BT.2020, and failing these of ACES2065-1, whose primaries enclose the spectral locus, so that all real light
is positive there.

Left out: fluorescence; lights of fewer than three wavelengths, which have no spectrum for any colour but
their own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from uplift import UpliftError
from uplift.difference import delta_e_2000
from uplift.sigmoid import SUMS, integrals, newton, normalised_wavelengths, solve
from uplift.spectrum import Float64, Observer, RGBSpace, normalised, rgb_space, rgb_weights

# A component of the light below this share of its luminance would make noise in it the largest component of
# G.
_CLEARLY_POSITIVE = 5e-3
SOLVED = 1e-12  # residual relative to a colour's largest component below which it counts as reached
DARKEST = 1e-5  # level below which a colour counts as out of reach
BRIGHTEST = 0.8  # of the most light that R < 1 leaves of a colour; closer to it the sigmoid turns into a box
PREVIEW_DELTA_E, FLOAT_DELTA_E = 0.05, 1e-4  # ΔE2000 that the two coarser precisions allow
USABLE, LINEAR, CUBIC = 1, 2, 4  # bits of a cell's grade
BORDER = 1e-7  # distance to the cone's planes, the largest component being 1, below which a colour is outside


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The reflectances under one light.

    `emission` [N] has Y = 1. `axes` [3, 3] turns working RGB into G, of which `axes_name` tells the space.
    `weights` [3, N] turns R into G. `nodes` [3, n, n, 4] holds for each largest component m and ratios (i,
    j)/(n − 1) of components m+1 and m+2 (modulo 3) to it: the coefficients for `t` [N], and the level.
    `solved` [3, n, n] is False where the colour is out of reach; its coefficients are then those of a
    neighbour. `cone` [P, 3] holds inward normals: the light can show exactly the colours with `cone @ G` > 0.
    `surface` [3, n, n, 4, 4] holds the nodes with 1/level for the level, then their derivatives along i, along j,
    and along both. `grades` [3, n-1, n-1] has for each cell the bits USABLE, LINEAR and CUBIC; `curvature` [3, n-1,
    n-1] is C such that a Newton step from there leaves a residual below C times the square of the one before.
    """

    emission: Float64
    observer: Observer
    space: RGBSpace
    factor: float
    axes_name: str
    axes: Float64
    weights: Float64
    t: Float64
    nodes: Float64
    solved: npt.NDArray[np.bool_]
    cone: Float64
    surface: Float64
    grades: npt.NDArray[np.uint8]
    curvature: Float64


def build_table(
    emission: npt.ArrayLike, *, observer: Observer, space: RGBSpace, nodes: int = 64, factor: float = 2.0
) -> Table:
    """Return the table of the light `emission` [N] (any scale, on the observer's grid).

    Takes 0.09 to 0.11 s of processor time for 64 nodes on a 2.5 GHz core, under lamps of few lines too; most of it is
    parallel. Raises UpliftError if `emission` is no visible light, has power at fewer than three distinguishable wavelengths, or if
    `nodes` or `factor` are out of range.
    """
    if not 2 <= nodes <= 1024:
        raise UpliftError(f"build_table: {nodes} nodes an axis; expected 2 to 1024, 64 is a good choice")
    if not 1 < factor <= 1000:
        raise UpliftError(
            f"build_table: factor {factor}; expected more than 1 (R has to stay below one) and at most 1000"
        )
    light = normalised(emission, observer)
    W = rgb_weights(light, observer, space)
    axes_name, axes = _axes_of(W.sum(axis=1), space, observer)
    weights = np.ascontiguousarray(axes @ W)
    cone = _cone_of(weights, axes @ space.rgb_from_xyz)
    t = normalised_wavelengths(observer)
    field, solved = _fill(weights, t, cone, _levels(weights, nodes, factor))
    surface = _surface_of(field)
    curvature, asked, shown = _check_cells(weights, t, field, solved, surface)
    grades = _grades_of(curvature, asked, shown, np.asarray(np.linalg.inv(axes), dtype=np.float64), space)
    return Table(
        light, observer, space, factor, axes_name, axes, weights, t, field, solved, cone, surface, grades, curvature
    )


def _levels(weights: Float64, nodes: int, factor: float) -> Float64:
    """Return the level [3, n, n] to aim at in each node: 1/`factor`, or less where little light is left.

    The brightest E · R of a colour, R at most one, lies on the border of the zonotope that the columns of `weights`
    span (MacAdam 1935 drew it for daylight); each pair of columns is parallel to one pair of its faces.
    """
    # Neighbours are merged into some thirty columns, which shrinks the zonotope a little: never too bright.
    columns = np.add.reduceat(weights, np.arange(0, weights.shape[1], -(-weights.shape[1] // 30)), axis=1).T
    first, second = np.triu_indices(len(columns), 1)
    normals = np.cross(columns[first], columns[second])
    normals = np.concatenate([normals, -normals])
    heights = np.maximum(normals @ columns.T, 0.0).sum(axis=1)
    kept = heights > 1e-12 * np.abs(heights).max()
    dimness = _dimness(np.ascontiguousarray((normals[kept] / heights[kept, None]).T), nodes) / BRIGHTEST
    # The faces' edges would show as kinks in the coefficients.
    for axis in (1, 2):
        for _ in range(4):
            dimness = np.moveaxis(dimness, axis, 0)
            padded = np.concatenate([2 * dimness[:1] - dimness[1:2], dimness, 2 * dimness[-1:] - dimness[-2:-1]])
            dimness = np.moveaxis(0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:], 0, axis)
    # The larger of the two, with a rounded corner: two continuous derivatives.
    width = 0.3 * factor
    z = np.clip((dimness - factor) / width, -1.0, 1.0)
    rounded = factor + width * (z / 2 + 3 / 8 * z**2 - z**4 / 16 + 3 / 16)
    return np.ascontiguousarray(1 / np.where(dimness >= factor + width, dimness, rounded))


def _slopes(values: Float64, axis: int) -> Float64:
    """Return the derivative of `values` along `axis`, per node: differences of fourth order where there are five."""
    f = np.moveaxis(values, axis, 0)
    out = np.gradient(f, axis=0)
    if len(f) >= 5:
        out[2:-2] = (f[:-4] - 8 * f[1:-3] + 8 * f[3:-1] - f[4:]) / 12
        for end, sign in ((f[:5], 1), (f[::-1][:5], -1)):
            e0, e1, e2, e3, e4 = end
            at = 0 if sign > 0 else -1
            out[at] = sign * (-25 * e0 + 48 * e1 - 36 * e2 + 16 * e3 - 3 * e4) / 12
            out[at + sign] = sign * (-3 * e0 - 10 * e1 + 18 * e2 - 6 * e3 + e4) / 12
    return np.moveaxis(out, 0, axis)


def _surface_of(nodes: Float64) -> Float64:
    """Return [3, n, n, 4, 4]: coefficients and 1/level of each node; second last the value, its derivatives along i,
    along j, and along both.
    """
    values = nodes.copy()
    values[..., 3] = 1 / nodes[..., 3]
    along_i, along_j = _slopes(values, 1), _slopes(values, 2)
    return np.ascontiguousarray(np.stack([values, along_i, along_j, _slopes(along_i, 2)], axis=3))


def _grades_of(
    curvature: Float64, asked: Float64, shown: Float64, rgb_from_axes: Float64, space: RGBSpace
) -> npt.NDArray[np.uint8]:
    """Return what each cell is good for, from the worst colours found in it with both ways to look up."""
    difference = delta_e_2000(asked @ rgb_from_axes.T, shown @ rgb_from_axes.T, space, white=None)
    usable = np.isfinite(curvature)
    # Twice and thrice: the worst point of a cell was not among those tried.
    linear = usable & (difference[..., 0] * 2 <= PREVIEW_DELTA_E)
    cubic = usable & (difference[..., 1] * 3 <= FLOAT_DELTA_E)
    return (usable * USABLE + linear * LINEAR + cubic * CUBIC).astype(np.uint8)


def _axes_of(w: Float64, space: RGBSpace, observer: Observer) -> tuple[str, Float64]:
    """Return the first axes in which the light, of RGB `w` and Y = 1 in `space`, is clearly positive."""
    if w.min() >= _CLEARLY_POSITIVE:
        return space.name, np.ascontiguousarray(np.diag(1 / w))
    wide, widest = (rgb_space(name, observer=observer) for name in ("ITU-R BT.2020", "ACES2065-1"))
    for other, floor in ((wide, _CLEARLY_POSITIVE), (widest, 0.0)):
        other_from_rgb = other.rgb_from_xyz @ space.xyz_from_rgb
        white = other_from_rgb @ w
        if white.min() > floor:
            return other.name, np.ascontiguousarray(other_from_rgb / white[:, None])
    raise UpliftError(
        f"build_table: the light's RGB in ACES2065-1 is {white.round(6).tolist()}, yet every broad light is positive "
        "there; it is (almost) one wavelength at the end of the visible range. Declare the lamp with its whole spectrum"
    )


def _cone_of(weights: Float64, G_from_xyz: Float64) -> Float64:
    """Return the inward normals [P, 3] of the cone spanned by the columns of `weights` that matter."""
    columns = np.linalg.solve(G_from_xyz, weights).T
    sums = columns.sum(axis=1)
    columns = columns[sums > DARKEST * sums.max()]
    xy = columns[:, :2] / columns.sum(axis=1, keepdims=True)
    corners = _hull(xy)
    if len(corners) < 3:
        raise UpliftError(
            "build_table: the light has power at fewer than three distinguishable wavelengths, so E · R has its own "
            "colour only (a laser, low-pressure sodium). Declare a light with a broader spectrum for this cluster"
        )
    rays = columns[corners]
    normals = np.cross(rays, np.roll(rays, -1, axis=0)) @ np.linalg.inv(G_from_xyz)
    return np.ascontiguousarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def _hull(points: Float64) -> list[int]:
    """Return the indices of the convex hull of `points` [M, 2], anticlockwise (Andrew's monotone chain)."""

    def chain(order: list[int]) -> list[int]:
        kept: list[int] = []
        for k in order:
            while len(kept) > 1:
                (ax, ay), (bx, by) = points[kept[-1]] - points[kept[-2]], points[k] - points[kept[-2]]
                if ax * by - ay * bx > 1e-12:
                    break
                kept.pop()
            kept.append(k)
        return kept

    order = sorted(range(len(points)), key=lambda k: (points[k][0], points[k][1]))
    below, above = chain(order), chain(order[::-1])
    corners = below[:-1] + above[:-1]
    return corners if len(corners) > 2 else []


@njit(cache=True, error_model="numpy", fastmath=SUMS)
def _walk(weights, t, g0, g1, g2, c0, c1, c2, aim, tolerance):  # type: ignore[no-untyped-def]
    """Return (c0, c1, c2, error) with Σ weights · S = g: Newton's method, or a walk in a straight line from c's
    colour.
    """
    n0, n1, n2, error = solve(weights, t, g0, g1, g2, c0, c1, c2, aim, 20)
    if error <= tolerance:
        return n0, n1, n2, error
    s0, s1, s2 = integrals(weights, t, c0, c1, c2)[:3]
    done, step = 0.0, 0.5
    while step > 0.01 and done < 1.0:
        part = min(1.0, done + step)
        n0, n1, n2, error = solve(
            weights, t, s0 + part * (g0 - s0), s1 + part * (g1 - s1), s2 + part * (g2 - s2), c0, c1, c2, aim, 12
        )
        if error <= tolerance:
            c0, c1, c2, done = n0, n1, n2, part
            step *= 2.0
        else:
            step *= 0.5
    return c0, c1, c2, error


@njit(cache=True, error_model="numpy", fastmath=SUMS)
def approach(weights, t, d0, d1, d2, level, c0, c1, c2, tolerance, darkest):  # type: ignore[no-untyped-def]
    """Return (c0, c1, c2, error, level) with Σ weights · S = level · (d0, d1, d2), darkened until it can be solved.

    At each level the way begins at (c0, c1, c2), and if that leads nowhere at grey, whose curvature misleads
    nobody; the next level is 0.7 of it, down to `darkest`. `error` is relative to the level, above `tolerance` if
    all failed. For compiled code only.
    """
    while level > darkest:
        g0, g1, g2 = level * d0, level * d1, level * d2
        limit = tolerance * level
        n0, n1, n2, error = _walk(weights, t, g0, g1, g2, c0, c1, c2, 0.01 * limit, limit)
        if error > limit:
            v = 0.5 * level
            grey = (v - 0.5) / np.sqrt(v * (1.0 - v))
            n0, n1, n2, error = _walk(weights, t, g0, g1, g2, 0.0, 0.0, grey, 0.01 * limit, limit)
        if error <= limit:
            return n0, n1, n2, error / level, level
        level *= 0.7
    return c0, c1, c2, 1.0, level


@njit(cache=True, error_model="numpy")
def inside(cone, d0, d1, d2):  # type: ignore[no-untyped-def]
    """Return whether (d0, d1, d2), whose largest component is 1, lies inside `cone` [P, 3]. For compiled
    code only.
    """
    nearest = np.inf
    for p in range(cone.shape[0]):
        nearest = min(nearest, cone[p, 0] * d0 + cone[p, 1] * d1 + cone[p, 2] * d2)
    return nearest > BORDER


@njit(cache=True, error_model="numpy")
def permuted(m, largest, second, third):  # type: ignore[no-untyped-def]
    """Return a colour in the order of the axes, given its components m, m + 1 and m + 2 (modulo 3)."""
    if m == 0:
        return largest, second, third
    if m == 1:
        return third, largest, second
    return second, third, largest


@njit(cache=True, error_model="numpy", parallel=True, fastmath=SUMS | {"nnan"})
def _dimness(faces, n):  # type: ignore[no-untyped-def]
    """Return 1 / (the brightest level) [3, n, n] in a zonotope {g: `faces`ᵀ @ g ≤ 1} with `faces` [3, F]."""
    out = np.empty((3, n, n))
    for line in prange(3 * n):
        m, i = line // n, line % n
        for j in range(n):
            d0, d1, d2 = permuted(m, 1.0, i / (n - 1), j / (n - 1))
            most = 0.0
            for f in range(faces.shape[1]):
                most = max(most, faces[0, f] * d0 + faces[1, f] * d1 + faces[2, f] * d2)
            out[m, i, j] = most
    return out


@njit(cache=True, error_model="numpy")
def _node(weights, t, cone, nodes, solved, m, i, j, step_i, step_j, level):  # type: ignore[no-untyped-def]
    """Solve one node at `level`, starting from the neighbour a step away, or in line with it and the next."""
    n = nodes.shape[1]
    d0, d1, d2 = permuted(m, 1.0, i / (n - 1), j / (n - 1))
    near, far = nodes[m, i + step_i, j + step_j], nodes[m, min(n - 1, i + 2 * step_i), min(n - 1, j + 2 * step_j)]
    c0, c1, c2 = near[0], near[1], near[2]
    nodes[m, i, j, 0], nodes[m, i, j, 1], nodes[m, i, j, 2], nodes[m, i, j, 3] = c0, c1, c2, near[3]
    if not inside(cone, d0, d1, d2):
        return
    limit = SOLVED * level
    n0, n1, n2, error = solve(
        weights,
        t,
        level * d0,
        level * d1,
        level * d2,
        2.0 * c0 - far[0],
        2.0 * c1 - far[1],
        2.0 * c2 - far[2],
        0.01 * limit,
        12,
    )
    error /= level
    if error > SOLVED:
        # Near the border the neighbour may have been darkened; brighter than it by far is no use to try.
        n0, n1, n2, error, level = approach(
            weights, t, d0, d1, d2, min(level, 1.2 * near[3]), c0, c1, c2, SOLVED, DARKEST
        )
    if error <= SOLVED:
        nodes[m, i, j, 0], nodes[m, i, j, 1], nodes[m, i, j, 2], nodes[m, i, j, 3] = n0, n1, n2, level
        solved[m, i, j] = True


@njit(cache=True, error_model="numpy", parallel=True)
def _fill(weights, t, cone, levels):  # type: ignore[no-untyped-def]
    """Return nodes [3, n, n, 4] and solved [3, n, n]: from grey along one edge, from there along each
    line.
    """
    n = levels.shape[1]
    nodes = np.zeros((3, n, n, 4))
    solved = np.zeros((3, n, n), np.bool_)
    for m in range(3):
        top = levels[m, n - 1, n - 1]
        nodes[m, n - 1, n - 1, 2] = (top - 0.5) / np.sqrt(top * (1 - top))
        nodes[m, n - 1, n - 1, 3] = top
        solved[m, n - 1, n - 1] = True
        for j in range(n - 2, -1, -1):
            _node(weights, t, cone, nodes, solved, m, n - 1, j, 0, 1, levels[m, n - 1, j])
    for line in prange(3 * n):
        m, j = line // n, line % n
        for i in range(n - 2, -1, -1):
            _node(weights, t, cone, nodes, solved, m, i, j, 1, 0, levels[m, i, j])
    return nodes, solved


@njit(cache=True, error_model="numpy")
def cubic(surface, m, i, j, p, q):  # type: ignore[no-untyped-def]
    """Return (c0, c1, c2, 1/level) at (p, q) in 0 … 1 within a cell: Hermite's cubics both ways. For compiled code
    only.
    """
    p2, q2 = p * p, q * q
    p3, q3 = p2 * p, q2 * q
    a1, b1 = 3.0 * p2 - 2.0 * p3, 3.0 * q2 - 2.0 * q3
    a0, b0 = 1.0 - a1, 1.0 - b1
    u0, v0 = p - 2.0 * p2 + p3, q - 2.0 * q2 + q3
    u1, v1 = p3 - p2, q3 - q2
    n = surface[m, i, j]
    e = surface[m, i, j + 1]
    s = surface[m, i + 1, j]
    x = surface[m, i + 1, j + 1]
    w0, w1, w2, w3 = a0 * b0, u0 * b0, a0 * v0, u0 * v0
    x0, x1, x2, x3 = a0 * b1, u0 * b1, a0 * v1, u0 * v1
    y0, y1, y2, y3 = a1 * b0, u1 * b0, a1 * v0, u1 * v0
    z0, z1, z2, z3 = a1 * b1, u1 * b1, a1 * v1, u1 * v1
    c0 = (
        w0 * n[0, 0]
        + w1 * n[1, 0]
        + w2 * n[2, 0]
        + w3 * n[3, 0]
        + x0 * e[0, 0]
        + x1 * e[1, 0]
        + x2 * e[2, 0]
        + x3 * e[3, 0]
        + y0 * s[0, 0]
        + y1 * s[1, 0]
        + y2 * s[2, 0]
        + y3 * s[3, 0]
        + z0 * x[0, 0]
        + z1 * x[1, 0]
        + z2 * x[2, 0]
        + z3 * x[3, 0]
    )
    c1 = (
        w0 * n[0, 1]
        + w1 * n[1, 1]
        + w2 * n[2, 1]
        + w3 * n[3, 1]
        + x0 * e[0, 1]
        + x1 * e[1, 1]
        + x2 * e[2, 1]
        + x3 * e[3, 1]
        + y0 * s[0, 1]
        + y1 * s[1, 1]
        + y2 * s[2, 1]
        + y3 * s[3, 1]
        + z0 * x[0, 1]
        + z1 * x[1, 1]
        + z2 * x[2, 1]
        + z3 * x[3, 1]
    )
    c2 = (
        w0 * n[0, 2]
        + w1 * n[1, 2]
        + w2 * n[2, 2]
        + w3 * n[3, 2]
        + x0 * e[0, 2]
        + x1 * e[1, 2]
        + x2 * e[2, 2]
        + x3 * e[3, 2]
        + y0 * s[0, 2]
        + y1 * s[1, 2]
        + y2 * s[2, 2]
        + y3 * s[3, 2]
        + z0 * x[0, 2]
        + z1 * x[1, 2]
        + z2 * x[2, 2]
        + z3 * x[3, 2]
    )
    dimness = (
        w0 * n[0, 3]
        + w1 * n[1, 3]
        + w2 * n[2, 3]
        + w3 * n[3, 3]
        + x0 * e[0, 3]
        + x1 * e[1, 3]
        + x2 * e[2, 3]
        + x3 * e[3, 3]
        + y0 * s[0, 3]
        + y1 * s[1, 3]
        + y2 * s[2, 3]
        + y3 * s[3, 3]
        + z0 * x[0, 3]
        + z1 * x[1, 3]
        + z2 * x[2, 3]
        + z3 * x[3, 3]
    )
    return c0, c1, c2, dimness


@njit(cache=True, error_model="numpy")
def linear(surface, m, i, j, p, q):  # type: ignore[no-untyped-def]
    """Return (c0, c1, c2, 1/level) at (p, q) in 0 … 1 within a cell, bilinear. For compiled code only."""
    w, x, y, z = (1.0 - p) * (1.0 - q), (1.0 - p) * q, p * (1.0 - q), p * q
    n = surface[m, i, j, 0]
    e = surface[m, i, j + 1, 0]
    s = surface[m, i + 1, j, 0]
    d = surface[m, i + 1, j + 1, 0]
    return (
        w * n[0] + x * e[0] + y * s[0] + z * d[0],
        w * n[1] + x * e[1] + y * s[1] + z * d[1],
        w * n[2] + x * e[2] + y * s[2] + z * d[2],
        w * n[3] + x * e[3] + y * s[3] + z * d[3],
    )


@njit(cache=True, error_model="numpy", parallel=True)
def _check_cells(weights, t, nodes, solved, surface):  # type: ignore[no-untyped-def]
    """Return curvature [3, n-1, n-1], and colours asked and shown [3, n-1, n-1, 2, 3]: the middle of each cell looked
    up linearly, and the worst of five points looked up cubically.

    The curvature C bounds a Newton step's residual by C times the square of the one before; it is measured on the way
    from a corner to the middle. Infinite where a corner is unsolved, or Newton's method would not converge quickly.
    """
    n = nodes.shape[1]
    curvature = np.full((3, n - 1, n - 1), np.inf)
    asked = np.ones((3, n - 1, n - 1, 2, 3))
    shown = np.ones((3, n - 1, n - 1, 2, 3))
    for line in prange(3 * (n - 1)):
        m, i = line // (n - 1), line % (n - 1)
        for j in range(n - 1):
            if not (solved[m, i, j] and solved[m, i, j + 1] and solved[m, i + 1, j] and solved[m, i + 1, j + 1]):
                continue
            largest = 0.0
            for point in range(6):
                # First the middle by both ways, then the four quarters.
                p, q = 0.5, 0.5
                if point > 1:
                    p, q = 0.25 + 0.5 * (point % 2), 0.25 + 0.5 * (point // 4)
                d0, d1, d2 = permuted(m, 1.0, (i + p) / (n - 1), (j + q) / (n - 1))
                if point == 0:
                    c0, c1, c2, dimness = linear(surface, m, i, j, p, q)
                else:
                    c0, c1, c2, dimness = cubic(surface, m, i, j, p, q)
                f = integrals(weights, t, c0, c1, c2)
                f0, f1, f2 = f[0] * dimness, f[1] * dimness, f[2] * dimness
                error = max(abs(f0 - d0), abs(f1 - d1), abs(f2 - d2)) / dimness
                # Not "greater": that would let NaN pass.
                if point == 0 or not error <= largest:
                    way = min(point, 1)
                    asked[m, i, j, way, 0], asked[m, i, j, way, 1], asked[m, i, j, way, 2] = d0, d1, d2
                    shown[m, i, j, way, 0], shown[m, i, j, way, 1], shown[m, i, j, way, 2] = f0, f1, f2
                if point > 0:
                    largest = max(largest, error)
                if point == 1:
                    g0, g1, g2 = d0 / dimness, d1 / dimness, d2 / dimness
            before, after = 0.0, 0.0
            c0, c1, c2 = nodes[m, i, j, 0], nodes[m, i, j, 1], nodes[m, i, j, 2]
            c0, c1, c2, before = newton(weights, t, g0, g1, g2, c0, c1, c2)
            after = newton(weights, t, g0, g1, g2, c0, c1, c2)[3]
            found = 4.0 * after / (before * before)
            if found * largest < 0.5:
                curvature[m, i, j] = found
    return curvature, asked, shown
