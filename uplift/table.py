"""Look-up table of the sigmoid reflectances under one light.

A colour is taken relative to the light: G = `axes` @ rgb with G = (1, 1, 1) for the light itself. Only the
ratios of G to its largest component matter, since P = scale · E · R keeps one brightness free; so the table
has two dimensions for each of the three components that may be the largest, not three (as rgb2spec has,
Jakob and Hanika 2019). Each node is solved by damped Gauss–Newton under the light, starting from its
neighbour, and the first one from grey.

**How bright R is.** The largest component of E·R is 1/`factor` (2 in Tódová and Wilkie 2024), or 0.8 of the
brightest that any R below one can be (MacAdam 1935) where that is less, with a smooth passage between the two.
Near the border of what the light can show little is left: pure BT.2020 red under D65 is one wavelength. Each
node keeps its own `level`, lower still where the sigmoid does not reach that one; scale makes up for the darkness.

**Near the border** colours with a negative component, and cells too stiff to interpolate, have their starts in the
light's `fan` (`uplift.gamut`).

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
from uplift.gamut import Fan, build_fan, cone_of, dimness, faces_of, rounded
from uplift.newton import solve
from uplift.sigmoid import coefficients_in_nm, normalisation, normalised_wavelengths
from uplift.spectrum import Float64, Observer, RGBSpace, normalised, rgb_space, rgb_weights
from uplift.surface import grades_of, permuted, surface_of

# A component of the light below this share of its luminance would make noise in it the largest component of
# G.
_CLEARLY_POSITIVE = 5e-3
SOLVED = 1e-12  # residual relative to a colour's largest component below which a node counts as reached
BORDER = 1e-7  # distance to the cone's planes, the largest component being 1, below which a node is outside
_DARKER = 8  # times that a node may take half the level
#: White over the brightest component of R: chosen by the relight error in rooms (docs/decisions/0006-brightness.md).
BRIGHTNESS = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The reflectances under one light.

    `emission` [N] has Y = 1. `axes` [3, 3] turns working RGB into G, of which `axes_name` tells the space.
    `weights` [3, N] turns R into G. `white_sum` is X + Y + Z of the light. `nodes` [3, n, n, 4] holds for each largest
    component m and ratios (i, j)/(n − 1) of components m+1 and m+2 (modulo 3) to it: the coefficients for `t` [N],
    and the level. `solved` [3, n, n] is False where the colour was not reached; its coefficients are then those of a
    neighbour. `cone` [P, 3] holds inward normals: the light can show exactly the colours with `cone @ G` > 0.
    `surface` [3, n, n, 4, 4] holds the nodes with 1/level for the level, then their derivatives along i, along j,
    and along both; `coarse` [3, n, n, 4] the nodes with coefficients for λ in nm and 1/level. `grades` [3, n-1, n-1]
    has for each cell the bits USABLE, LINEAR, CUBIC and CURVED; `curvature` [3, n-1, n-1] is C such that a Newton step from
    there leaves a residual below C times the square of the one before. `fan` has the starts near the border.
    """

    emission: Float64
    observer: Observer
    space: RGBSpace
    factor: float
    axes_name: str
    axes: Float64
    weights: Float64
    white_sum: float
    t: Float64
    nodes: Float64
    solved: npt.NDArray[np.bool_]
    cone: Float64
    surface: Float64
    coarse: Float64
    grades: npt.NDArray[np.uint8]
    curvature: Float64
    fan: Fan


def build_table(
    emission: npt.ArrayLike, *, observer: Observer, space: RGBSpace, nodes: int = 64, factor: float = BRIGHTNESS
) -> Table:
    """Return the table of the light `emission` [N] (any scale, on the observer's grid).

    Takes about 0.1 s of processor time for 64 nodes on a 2.5 GHz core, under lamps of few lines too; most of it is
    parallel. Raises UpliftError if `emission` is no visible light, has power at fewer than three distinguishable
    wavelengths, or if `nodes` or `factor` are out of range.
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
    G_from_xyz = axes @ space.rgb_from_xyz
    cone, corners = cone_of(weights, G_from_xyz)
    t = normalised_wavelengths(observer)
    faces = faces_of(weights)
    levels = _levels(faces, nodes, factor)
    field, solved = np.zeros((3, nodes, nodes, 4)), np.zeros((3, nodes, nodes), np.bool_)
    field[:, -1, -1, 2:] = [[(top - 0.5) / np.sqrt(top * (1 - top)), top] for top in levels[:, -1, -1]]
    solved[:, -1, -1] = True
    for edge in (True, False):
        _fill(weights, t, cone, levels, field, solved, edge)
    surface = surface_of(field)
    coarse = np.concatenate([coefficients_in_nm(field[..., :3], *normalisation(observer)), surface[..., 0, 3:]], axis=3)
    rgb_from_axes = np.asarray(np.linalg.inv(axes), dtype=np.float64)
    grades, curvature = grades_of(weights, t, field, solved, surface, rgb_from_axes, space)
    return Table(
        emission=light,
        observer=observer,
        space=space,
        factor=factor,
        axes_name=axes_name,
        axes=axes,
        weights=weights,
        white_sum=float(np.linalg.solve(G_from_xyz, np.ones(3)).sum()),
        t=t,
        nodes=field,
        solved=solved,
        cone=cone,
        surface=surface,
        coarse=np.ascontiguousarray(coarse),
        grades=grades,
        curvature=curvature,
        fan=build_fan(weights, t, corners, G_from_xyz, faces, factor),
    )


def _levels(faces: Float64, nodes: int, factor: float) -> Float64:
    """Return the level [3, n, n] to aim at in each node: 1/`factor`, or less where little light is left."""
    ratio = np.arange(nodes) / (nodes - 1)
    directions = np.ones((3, nodes, nodes, 3))
    for m in range(3):
        directions[m, :, :, (m + 1) % 3] = ratio[:, None]
        directions[m, :, :, (m + 2) % 3] = ratio
    dim = dimness(faces, directions)
    # The faces' edges would show as kinks in the coefficients.
    for axis in (1, 2):
        for _ in range(4):
            dim = np.moveaxis(dim, axis, 0)
            padded = np.concatenate([2 * dim[:1] - dim[1:2], dim, 2 * dim[-1:] - dim[-2:-1]])
            dim = np.moveaxis(0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:], 0, axis)
    return np.ascontiguousarray(1 / rounded(dim, factor))


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


@njit(cache=True, error_model="numpy")
def _node(weights, t, cone, nodes, solved, m, i, j, step_i, step_j, level):  # type: ignore[no-untyped-def]
    """Solve one node at `level` or darker, starting in line with two neighbours, or from the nearer one."""
    n = nodes.shape[1]
    d0, d1, d2 = permuted(m, 1.0, i / (n - 1), j / (n - 1))
    near, far = nodes[m, i + step_i, j + step_j], nodes[m, min(n - 1, i + 2 * step_i), min(n - 1, j + 2 * step_j)]
    nodes[m, i, j, 0], nodes[m, i, j, 1], nodes[m, i, j, 2], nodes[m, i, j, 3] = near[0], near[1], near[2], near[3]
    for p in range(cone.shape[0]):
        if cone[p, 0] * d0 + cone[p, 1] * d1 + cone[p, 2] * d2 <= BORDER:
            return
    more = 1.0
    for _ in range(_DARKER):
        # Newton's error is asked for a hundredth of what will do, so rounding does not decide.
        c0, c1, c2, error = solve(
            weights,
            t,
            0.0,
            level * d0,
            level * d1,
            level * d2,
            near[0] + more * (near[0] - far[0]),
            near[1] + more * (near[1] - far[1]),
            near[2] + more * (near[2] - far[2]),
            0.01 * SOLVED * level,
            16,
        )
        if error <= SOLVED * level:
            nodes[m, i, j, 0], nodes[m, i, j, 1], nodes[m, i, j, 2], nodes[m, i, j, 3] = c0, c1, c2, level
            solved[m, i, j] = True
            return
        # Near the border the neighbour may have been darkened; brighter than it by far is no use to try.
        level = 0.5 * level if more == 0.0 else min(level, 1.2 * near[3])
        more = 0.0


@njit(cache=True, error_model="numpy")
def _line(weights, t, cone, levels, nodes, solved, m, j, edge):  # type: ignore[no-untyped-def]
    """Solve an edge of the table from grey, or a line of it from its end on that edge."""
    last = levels.shape[1] - 1
    for k in range(last - 1, -1, -1):
        i, column = (last, k) if edge else (k, j)
        step = 0 if edge else 1
        _node(weights, t, cone, nodes, solved, m, i, column, step, 1 - step, levels[m, i, column])


@njit(cache=True, error_model="numpy", parallel=True)
def _fill(weights, t, cone, levels, nodes, solved, edge):  # type: ignore[no-untyped-def]
    """Write nodes [3, n, n, 4] and solved [3, n, n]: the edges' first, then every line's."""
    n = 1 if edge else levels.shape[1]
    for line in prange(3 * n):
        _line(weights, t, cone, levels, nodes, solved, line // n, line % n, edge)
