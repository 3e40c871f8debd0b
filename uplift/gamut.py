"""What a light can show, and reflectances all over it, up to its border.

The colours E · R of one light fill the cone spanned by E at single wavelengths; its cut is a polygon of
chromaticities around the light's own. The `Fan` divides the polygon into sectors, each between two rays from the
light to its border, and holds along each ray the reflectances of colours ever nearer to the border. So every colour
of the cone has a start for Newton's method close by: in a sector, d = α w + β r + γ r' with w the light's own
colour and r, r' the border's on both rays; α = 0 is the border itself, and tells what lies outside.

How bright: a colour is at most as bright as the brightest R ≤ 1 makes it (MacAdam, "Maximum Visual Efficiency of
Colored Materials", JOSA 25, 1935).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from uplift import UpliftError
from uplift.newton import solve
from uplift.polynomial import about
from uplift.sigmoid import SUMS
from uplift.spectrum import Float64

DARKEST = 1e-5  # share of the light's brightest wavelength below which another one counts as not there
BRIGHTEST = 0.8  # of the most light that R < 1 leaves of a colour; closer to it the sigmoid turns into a box
# Rows of the fan: logarithms of (β + γ)/α, from almost the light's own colour almost to the border.
FIRST_ROW, LAST_ROW, ROW_STEP = -12.0, 13.0, 1.0
ROWS = 1 + round((LAST_ROW - FIRST_ROW) / ROW_STEP)
_WIDEST = 0.1  # radians between two rays, as seen from the light
_APART = 1e-6  # chromaticities of corners nearer to each other than this are one
_START = 1e-9  # residual of the fan's nodes: they are starts, not answers


@dataclass(frozen=True, slots=True, eq=False)
class Fan:
    """Reflectances along the rays of one light.

    `sectors` [M, 3, 3]: for each, the rows that turn a colour G into α, β and γ, with the light's own colour and the
    rays' ends scaled to X + Y + Z = 1. `nodes` [M, ROWS, 5] on the first ray of each sector: coefficients for
    t − middle, that middle, and the logarithm of the brightness, relative to X + Y + Z = 1. `reach` [M]: how many of the rows are solved.
    """

    sectors: Float64
    nodes: Float64
    reach: npt.NDArray[np.int64]


def cone_of(weights: Float64, G_from_xyz: Float64) -> tuple[Float64, Float64]:
    """Return the inward normals [P, 3] of the cone spanned by the columns of `weights` [3, N] that matter, and its
    corners [P, 3] in XYZ with X + Y + Z = 1, anticlockwise.

    Raises UpliftError if the cone is flat.
    """
    columns = np.linalg.solve(G_from_xyz, weights).T
    sums = columns.sum(axis=1)
    columns = columns[sums > DARKEST * sums.max()]
    columns = columns / columns.sum(axis=1, keepdims=True)
    corners = _hull(columns[:, :2])
    if len(corners) < 3:
        raise UpliftError(
            "build_table: the light has power at fewer than three distinguishable wavelengths, so E · R has its own "
            "colour only (a laser, low-pressure sodium). Declare a light with a broader spectrum for this cluster"
        )
    rays = columns[corners]
    normals = np.cross(rays, np.roll(rays, -1, axis=0)) @ np.linalg.inv(G_from_xyz)
    return np.ascontiguousarray(normals / np.linalg.norm(normals, axis=1, keepdims=True)), rays


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


def faces_of(weights: Float64) -> Float64:
    """Return [3, F] such that no R ≤ 1 shows a colour g = Σ weights · R with max(`facesᵀ` @ g) > 1.

    The colours fill a zonotope; each pair of columns of `weights` is parallel to one pair of its faces.
    """
    # Neighbours are merged into some thirty columns, which shrinks the zonotope a little: never too bright.
    columns = np.add.reduceat(weights, np.arange(0, weights.shape[1], -(-weights.shape[1] // 30)), axis=1).T
    first, second = np.triu_indices(len(columns), 1)
    normals = np.cross(columns[first], columns[second])
    normals = np.concatenate([normals, -normals])
    heights = np.maximum(normals @ columns.T, 0.0).sum(axis=1)
    kept = heights > 1e-12 * np.abs(heights).max()
    return np.ascontiguousarray((normals[kept] / heights[kept, None]).T)


def dimness(faces: Float64, directions: Float64) -> Float64:
    """Return 1/level [...] of the brightest R that the sigmoid comes near to, for colours [..., 3] of largest component
    1.
    """
    flat = np.ascontiguousarray(directions.reshape(-1, 3))
    out = np.empty(len(flat))
    _dimness(faces, flat, out)
    return out.reshape(directions.shape[:-1]) / BRIGHTEST


def rounded(dim: Float64, factor: float) -> Float64:
    """Return the larger of `dim` and `factor`, the corner between the two rounded: two continuous derivatives."""
    width = 0.3 * factor
    z = np.clip((dim - factor) / width, -1.0, 1.0)
    smooth = factor + width * (z / 2 + 3 / 8 * z**2 - z**4 / 16 + 3 / 16)
    return np.asarray(np.where(dim >= factor + width, dim, smooth), dtype=np.float64)


def build_fan(
    weights: Float64, t: Float64, corners: Float64, G_from_xyz: Float64, faces: Float64, factor: float
) -> Fan:
    """Return the fan of a light with `weights` [3, N] and `corners` [P, 3] of its polygon, as `cone_of` gives them."""
    white = np.linalg.solve(G_from_xyz, np.ones(3))
    luminance = np.linalg.inv(G_from_xyz)[1]
    white = white / white.sum()
    rays = G_from_xyz @ _rays(corners, white).T
    w = G_from_xyz @ white
    following = np.roll(rays, -1, axis=1)
    basis = np.stack([np.broadcast_to(w[:, None], rays.shape), rays, following], axis=0)  # [3 vectors, 3, M]
    sectors = np.ascontiguousarray(np.linalg.inv(np.moveaxis(basis, (0, 1, 2), (2, 1, 0))))
    odds = np.exp(FIRST_ROW + ROW_STEP * np.arange(ROWS))
    alpha = 1 / (1 + odds)
    colours = alpha[:, None] * w + (odds * alpha)[:, None] * rays.T[:, None]  # [M, ROWS, 3]
    largest = colours.max(axis=-1)
    # A peak of one wavelength is easier to make dark; far from the border it has to look like the table's.
    darker = 0.25 + 0.75 / (1 + odds * np.exp(-4.0))
    level = darker / rounded(dimness(faces, colours / largest[..., None]), factor)
    small = np.minimum(1.0, colours @ luminance / largest) * level
    nodes, reach = np.zeros((len(colours), ROWS, 5)), np.zeros(len(colours), np.int64)
    _march(weights, t, np.ascontiguousarray(colours), level / largest, _START * small, 1 / factor, nodes, reach)
    return Fan(sectors, nodes, reach)


def _rays(corners: Float64, white: Float64) -> Float64:
    """Return the ends [M, 3] of the rays: the corners, and points between them where the angle is wide."""
    kept = [corners[0]]
    for corner in corners[1:]:
        if np.abs(corner - kept[-1]).max() > _APART and np.abs(corner - kept[0]).max() > _APART:
            kept.append(corner)
    out = []
    for here, there in zip(kept, [*kept[1:], kept[0]], strict=True):
        a, b = here[:2] - white[:2], there[:2] - white[:2]
        angle = abs(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))
        parts = max(1, int(np.ceil(angle / _WIDEST)))
        share = np.arange(parts)[:, None] / parts
        out.append((1 - share) * here + share * there)
    return np.concatenate(out)


@njit(cache=True, error_model="numpy", parallel=True, fastmath=SUMS | {"nnan"})
def _dimness(faces, directions, out):  # type: ignore[no-untyped-def]
    for k in prange(out.size):
        most = 0.0
        for f in range(faces.shape[1]):
            most = max(
                most, faces[0, f] * directions[k, 0] + faces[1, f] * directions[k, 1] + faces[2, f] * directions[k, 2]
            )
        out[k] = most


@njit(cache=True, error_model="numpy")
def _ahead(now, before):  # type: ignore[no-untyped-def]
    """Return the next of a series that grows, by its ratio where that makes sense."""
    if now * before > 0.0 and 0.3 < now / before < 3.0:
        return now * now / before
    return 2.0 * now - before


@njit(cache=True, error_model="numpy")
def _ray(weights, t, colours, brightness, tolerance, grey, nodes):  # type: ignore[no-untyped-def]
    """Write `nodes` [ROWS, 5] of one ray, from grey towards the border, darker wherever Newton's method fails; return
    how many are solved.
    """
    c0 = c1 = b0 = middle = before = 0.0
    c2 = b2 = (grey - 0.5) / np.sqrt(grey * (1.0 - grey))
    dark = 1.0
    for row in range(brightness.size):
        solved = False
        for attempt in range(9):
            # As bright as the row before, then darker and brighter by turns: a single wavelength may be as dark as one
            # likes, while the ends of the range are what is left where R saturates.
            change = 1.0 if attempt < 2 else 2.0 ** (attempt // 2 * (2 * (attempt % 2) - 1))
            bright, limit = change * dark * brightness[row], change * dark * tolerance[row]
            if attempt == 0:
                n0, n1, n2, m = about(_ahead(c0, b0), c1, _ahead(c2, b2), 2.0 * middle - before)
            else:
                # A dark R is like 1/x².
                x = max(1.0, change**-0.5)
                n0, n1, n2, m = x * c0, x * c1, x * c2, middle
            g0, g1, g2 = bright * colours[row, 0], bright * colours[row, 1], bright * colours[row, 2]
            n0, n1, n2, error = solve(weights, t, m, g0, g1, g2, n0, n1, n2, 0.1 * limit, 20)
            if error <= limit:
                solved = True
                dark *= change
                break
        if not solved:
            return row
        b0, b2, before = c0, c2, middle
        c0, c1, c2, middle = about(n0, n1, n2, m)
        nodes[row, 0], nodes[row, 1], nodes[row, 2], nodes[row, 3] = c0, c1, c2, middle
        nodes[row, 4] = np.log(bright)
    return brightness.size


@njit(cache=True, error_model="numpy", parallel=True)
def _march(weights, t, colours, brightness, tolerance, grey, nodes, reach):  # type: ignore[no-untyped-def]
    for ray in prange(reach.size):
        reach[ray] = _ray(weights, t, colours[ray], brightness[ray], tolerance[ray], grey, nodes[ray])
