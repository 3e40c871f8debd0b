"""Look-up table of the sigmoid reflectances under one light.

A colour is taken relative to the light: G = `axes` @ rgb with G = (1, 1, 1) for the light itself. Only the
ratios of G to its largest component matter, since P = scale · E · R keeps one brightness free; so the table
has two dimensions for each of the three components that may be the largest, not three (as rgb2spec has,
Jakob and Hanika 2019). Each node is solved by damped Gauss–Newton under the light, starting from its
neighbour, and the first one from grey.

**How bright R is.** The largest component of E·R is 1/`factor` (2 in Tódová and Wilkie 2024) wherever a
reflectance below one can be that bright. Near the border of what the light can show none can: pure BT.2020
red under D65 is one wavelength. There R is darkened, by as much as it takes, and each node keeps its own
`level`. So every colour inside the cone that the light spans has an exact spectrum under that light; scale
makes up for the darkness.

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
from uplift.sigmoid import SUMS, integrals, normalised_wavelengths, solve
from uplift.spectrum import Float64, Observer, RGBSpace, normalised, rgb_space, rgb_weights

# A component of the light below this share of its luminance would make noise in it the largest component of
# G.
_CLEARLY_POSITIVE = 5e-3
SOLVED = 1e-12  # residual relative to a colour's largest component below which it counts as reached
DARKEST = 1e-5  # level below which a colour counts as out of reach
BORDER = 1e-7  # distance to the cone's planes, the largest component being 1, below which a colour is outside


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The reflectances under one light.

    `emission` [N] has Y = 1. `axes` [3, 3] turns working RGB into G, of which `axes_name` tells the space.
    `weights` [3, N] turns R into G. `nodes` [3, n, n, 4] holds for each largest component m and ratios (i,
    j)/(n − 1) of components m+1 and m+2 (modulo 3) to it: the coefficients for `t` [N], and the level.
    `solved` [3, n, n] is False where the colour is out of reach; its coefficients are then those of a
    neighbour. `cone` [P, 3] holds inward normals: the light can show exactly the colours with `cone @ G` > 0.
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


def build_table(
    emission: npt.ArrayLike, *, observer: Observer, space: RGBSpace, nodes: int = 64, factor: float = 2.0
) -> Table:
    """Return the table of the light `emission` [N] (any scale, on the observer's grid).

    Takes 0.02 to 0.15 s for 64 nodes, more for lights of few lines (high-pressure sodium 0.5 s). Raises
    UpliftError if `emission` is no visible light, has power at fewer than three distinguishable wavelengths, or if
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
    field, solved = _fill(weights, t, cone, nodes, 1 / factor)
    return Table(light, observer, space, factor, axes_name, axes, weights, t, field, solved, cone)


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


@njit(cache=True, error_model="numpy")
def _node(weights, t, cone, nodes, solved, m, i, j, from_i, from_j, top):  # type: ignore[no-untyped-def]
    """Solve one node, starting from a neighbour and a little brighter than it, at most at `top`."""
    n = nodes.shape[1]
    d0, d1, d2 = permuted(m, 1.0, i / (n - 1), j / (n - 1))
    c0, c1, c2 = nodes[m, from_i, from_j, 0], nodes[m, from_i, from_j, 1], nodes[m, from_i, from_j, 2]
    level = nodes[m, from_i, from_j, 3]
    if inside(cone, d0, d1, d2):
        n0, n1, n2, error, reached = approach(
            weights, t, d0, d1, d2, min(top, 1.2 * level), c0, c1, c2, SOLVED, DARKEST
        )
        if error <= SOLVED:
            c0, c1, c2, level = n0, n1, n2, reached
            solved[m, i, j] = True
    nodes[m, i, j, 0], nodes[m, i, j, 1], nodes[m, i, j, 2], nodes[m, i, j, 3] = c0, c1, c2, level


@njit(cache=True, error_model="numpy", parallel=True)
def _fill(weights, t, cone, n, top):  # type: ignore[no-untyped-def]
    """Return nodes [3, n, n, 4] and solved [3, n, n]: from grey along one edge, from there along each
    line.
    """
    nodes = np.zeros((3, n, n, 4))
    solved = np.zeros((3, n, n), np.bool_)
    for m in range(3):
        nodes[m, n - 1, n - 1, 2] = (top - 0.5) / np.sqrt(top * (1 - top))
        nodes[m, n - 1, n - 1, 3] = top
        solved[m, n - 1, n - 1] = True
        for j in range(n - 2, -1, -1):
            _node(weights, t, cone, nodes, solved, m, n - 1, j, n - 1, j + 1, top)
    for line in prange(3 * n):
        for i in range(n - 2, -1, -1):
            _node(weights, t, cone, nodes, solved, line // n, i, line % n, i + 1, line % n, top)
    return nodes, solved
