"""Uplift of whole maps: three coefficients and a scale for each pixel, exact to double precision.

P(λ) = scale · E(λ) · S(c0 λ² + c1 λ + c2), E the emission of the pixel's light (Tódová and Wilkie,
"Constrained Spectral Uplifting for HDR Environment Maps", EGSR 2024; the sigmoid of Jakob and Hanika 2019). Each
pixel starts from its light's look-up table and goes on with Newton's method on the spectral sum itself, so it
depends on the table for its speed only. Where the table's cell is smooth, its bicubic surface starts so close that
one step is enough, and the cell's curvature says so without another look; the coarser precisions stop before.

What each pixel got is its `Status`. A colour that E · R cannot show (the colour stands outside the cone
spanned by E at the grid's wavelengths) takes D65 instead, and stays exact. A colour that no light can show
is mixed with the white of its light, at constant luminance, by the smallest amount found that brings it into
reach; without positive luminance it becomes black. Nothing of this is silent: `Uplifted` counts each class,
and says how far the moved colours went.

Pixels are independent of each other: any tile of a map, in any order, on any number of threads, gives the
same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from typing import Literal

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from uplift import UpliftError
from uplift.difference import delta_e_2000
from uplift.radiance import rgb_of, spectra_of
from uplift.sigmoid import newton, normalisation, solve
from uplift.spectrum import Float64, Observer, RGBSpace, illuminant
from uplift.table import CUBIC, LINEAR, SOLVED, Table, approach, build_table, cubic, inside, linear

__all__ = ["Status", "Uplifted", "fallback_table", "rgb_of", "spectra_of", "uplift_pixels"]


class Status(IntEnum):
    """What a pixel's spectrum is."""

    EXACT = 0  # its colour, under its light
    BLACK = 1  # no radiance
    FALLBACK = 2  # its colour, under another light (the last emission) since its own cannot show it
    CLOSEST = 3  # a colour mixed with the light's white until it could be shown, at the same luminance
    MISSING = 4  # NaN or infinite input; scale 0


@dataclass(frozen=True, slots=True, eq=False)
class Uplifted:
    """The spectra of a map.

    `coefficients` [H, W, 3] float64 for λ in nm; `scale` [H, W] float64; `emission` [H, W] uint32, index
    into `emissions` [K, N] (of the tables, then of the fallback), each with Y = 1; `status` [H, W] uint8,
    see `Status`; `counts` of pixels by status; `largest_shift`, the largest ΔE2000 between what was asked
    and what was given over the CLOSEST pixels, as `difference.delta_e_2000` measures it (0 without any; NaN
    luminance never occurs); `warnings` to show. Black and missing pixels have the coefficients of black, (0,
    0, −∞), and scale 0.
    """

    coefficients: Float64
    scale: Float64
    emission: npt.NDArray[np.uint32]
    status: npt.NDArray[np.uint8]
    emissions: Float64
    counts: dict[Status, int]
    largest_shift: float
    warnings: tuple[str, ...]


@cache
def fallback_table(observer: Observer, space: RGBSpace, nodes: int = 64, factor: float = 2.0) -> Table:
    """Return the table of D65, kept for the next call: the light of colours that their own light cannot
    show.
    """
    return build_table(illuminant("D65", observer), observer=observer, space=space, nodes=nodes, factor=factor)


Precision = Literal["exact", "float", "preview"]


def uplift_pixels(
    rgb: npt.NDArray[np.floating],
    cluster: npt.NDArray[np.integer],
    tables: Sequence[Table],
    *,
    precision: Precision = "exact",
) -> Uplifted:
    """Return spectra whose RGB is `rgb`, each pixel under the light of its cluster.

    Parameters
    ----------
    rgb
        Shape (H, W, 3), any finite or missing values. Linear RGB in the space of the tables, any unit.
    cluster
        Shape (H, W), integers: the index into `tables` of each pixel's light.
    tables
        One per light; all of the same observer, space, number of nodes and factor.
    precision
        How near `rgb_of` comes to `rgb` for EXACT and FALLBACK pixels, as ΔE2000 with every pixel as its own white:
        "exact" as near as rounding lets it, "float" within 1e-4, "preview" within 0.05. The coarser ones take what
        the table says wherever its cells were found good enough when it was built, and Newton steps elsewhere.

    Raises
    ------
    UpliftError
        If shapes disagree, a cluster has no table, the tables differ in kind, or the precision is unknown.

    Properties: `rgb_of` gives back `rgb` for EXACT and FALLBACK pixels, to the precision; k · rgb has k times the spectrum;
    the light's own RGB has its spectrum; 0 < R < 1.
    """
    rgb, cluster = np.asarray(rgb), np.asarray(cluster)
    _check(rgb, cluster, tables)
    if precision not in _PRECISIONS:
        raise UpliftError(f"uplift_pixels: precision {precision!r}; expected one of {', '.join(_PRECISIONS)}")
    first = tables[0]
    every = (*tables, fallback_table(first.observer, first.space, first.solved.shape[1], first.factor))
    most = max(len(table.cone) for table in every)
    # Repeating a plane does not change a cone; it makes the cones equally long.
    cones = np.stack([np.resize(table.cone, (most, 3)) for table in every])
    size = cluster.size
    values = rgb if rgb.dtype in (np.float32, np.float64) else rgb.astype(np.float64)
    coefficients = np.empty((size, 3))
    scale = np.empty(size)
    emission = np.empty(size, np.uint32)
    status = np.empty(size, np.uint8)
    # One row of counts a block, so that no two threads add to the same number.
    counts = np.zeros((-(-size // BLOCK), len(Status)), np.int64)
    _uplift(
        np.ascontiguousarray(values).reshape(size, 3),
        np.ascontiguousarray(cluster, dtype=np.uint32).reshape(size),
        _PRECISIONS[precision],
        np.stack([table.axes for table in every]),
        np.stack([table.weights for table in every]),
        first.t,
        np.stack([table.nodes for table in every]),
        np.stack([table.solved for table in every]),
        cones,
        np.stack([table.surface for table in every]),
        np.stack([table.grades for table in every]),
        np.stack([table.curvature for table in every]),
        first.space.luminance_weights,
        np.array(normalisation(first.observer)),
        coefficients,
        scale,
        emission,
        status,
        counts,
    )
    found = {kind: int(counts[:, kind].sum()) for kind in Status}
    emissions = np.stack([table.emission for table in every])
    shape = cluster.shape
    return recorded(
        rgb,
        coefficients.reshape(*shape, 3),
        scale.reshape(shape),
        emission.reshape(shape),
        status.reshape(shape),
        emissions,
        observer=first.observer,
        space=first.space,
        counts=found,
    )


def recorded(
    rgb: npt.NDArray[np.floating],
    coefficients: Float64,
    scale: Float64,
    emission: npt.NDArray[np.uint32],
    status: npt.NDArray[np.uint8],
    emissions: Float64,
    *,
    observer: Observer,
    space: RGBSpace,
    counts: dict[Status, int] | None = None,
) -> Uplifted:
    """Return the record of an uplift of `rgb`: counts each status unless given, measures what was moved, words the
    warnings.
    """
    if counts is None:
        found = np.bincount(status.ravel(), minlength=len(Status))
        counts = {kind: int(found[kind]) for kind in Status}
    shift = 0.0
    if counts[Status.CLOSEST]:
        moved = status == Status.CLOSEST
        shown = rgb_of(coefficients[moved], scale[moved], emission[moved], emissions, observer=observer, space=space)
        shift = float(delta_e_2000(np.asarray(rgb[moved], dtype=np.float64), shown, space).max())
    warnings = _warnings(counts, shift)
    return Uplifted(coefficients, scale, emission, status, emissions, counts, shift, warnings)


def _check(rgb: npt.NDArray[np.floating], cluster: npt.NDArray[np.integer], tables: Sequence[Table]) -> None:
    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype.kind != "f":
        raise UpliftError(f"uplift_pixels: rgb has shape {rgb.shape} of {rgb.dtype}; expected floats [H, W, 3]")
    if cluster.shape != rgb.shape[:2] or cluster.dtype.kind not in "ui":
        raise UpliftError(
            f"uplift_pixels: cluster has shape {cluster.shape} of {cluster.dtype}; expected integers {rgb.shape[:2]}, "
            "the index of each pixel's table"
        )
    if not tables:
        raise UpliftError("uplift_pixels: no tables; build one for each cluster with build_table")
    if cluster.size and not 0 <= int(cluster.min()) <= int(cluster.max()) < len(tables):
        raise UpliftError(
            f"uplift_pixels: clusters run from {cluster.min()} to {cluster.max()}, but there are {len(tables)} tables "
            f"(0 to {len(tables) - 1}); give one for each cluster"
        )
    kinds = {(id(table.observer), id(table.space), table.solved.shape[1], table.factor) for table in tables}
    if len(kinds) > 1:
        raise UpliftError(
            "uplift_pixels: the tables differ in observer, space, number of nodes or factor; build all of them with the "
            "same arguments"
        )


def _warnings(counts: dict[Status, int], largest_shift: float) -> tuple[str, ...]:
    total = max(1, sum(counts.values()))
    out = []
    if counts[Status.FALLBACK]:
        out.append(
            f"{counts[Status.FALLBACK]} pixels ({counts[Status.FALLBACK] / total:.4%}) have colours that their light "
            "cannot show; they keep their colour under D65"
        )
    if counts[Status.CLOSEST]:
        out.append(
            f"{counts[Status.CLOSEST]} pixels ({counts[Status.CLOSEST] / total:.4%}) have colours that no light can "
            f"show; they moved by up to ΔE2000 {largest_shift:.3g}"
        )
    if counts[Status.MISSING]:
        out.append(
            f"{counts[Status.MISSING]} pixels ({counts[Status.MISSING] / total:.4%}) are NaN or infinite; they have no radiance"
        )
    return tuple(out)


# Compiled code sees plain integers.
EXACT, BLACK, FALLBACK, CLOSEST, MISSING = (int(kind) for kind in Status)

_DARKEST = 1e-4  # of the table's level: colours that need a darker R lie on the border of what the light can show
# Of precisions, and what the compiled code calls them.
PREVIEW, FLOAT, ALL = 0, 1, 2
_PRECISIONS: dict[str, int] = {"exact": ALL, "float": FLOAT, "preview": PREVIEW}
BLOCK = 4096  # pixels that one thread takes at a time
_AIM = 2e-15  # residual relative to an R of one: a few roundings of the sum


@njit(cache=True, error_model="numpy")
def _look_up(nodes, solved, G0, G1, G2):  # type: ignore[no-untyped-def]
    """Return (c0, c1, c2, level, sure) between the four nodes around a colour whose largest component is 1.

    `sure` says that the colour is inside the light's cone, because it is between four that are.
    """
    if G0 >= G1 and G0 >= G2:
        m, p, q = 0, G1, G2
    elif G1 >= G2:
        m, p, q = 1, G2, G0
    else:
        m, p, q = 2, G0, G1
    n = nodes.shape[1]
    sure = p >= 0.0 and q >= 0.0
    p, q = max(p, 0.0) * (n - 1), max(q, 0.0) * (n - 1)
    i, j = min(int(p), n - 2), min(int(q), n - 2)
    sure = sure and solved[m, i, j] and solved[m, i, j + 1] and solved[m, i + 1, j] and solved[m, i + 1, j + 1]
    p, q = p - i, q - j
    w00, w01, w10, w11 = (1 - p) * (1 - q), (1 - p) * q, p * (1 - q), p * q
    face = nodes[m]
    c0 = w00 * face[i, j, 0] + w01 * face[i, j + 1, 0] + w10 * face[i + 1, j, 0] + w11 * face[i + 1, j + 1, 0]
    c1 = w00 * face[i, j, 1] + w01 * face[i, j + 1, 1] + w10 * face[i + 1, j, 1] + w11 * face[i + 1, j + 1, 1]
    c2 = w00 * face[i, j, 2] + w01 * face[i, j + 1, 2] + w10 * face[i + 1, j, 2] + w11 * face[i + 1, j + 1, 2]
    level = w00 * face[i, j, 3] + w01 * face[i, j + 1, 3] + w10 * face[i + 1, j, 3] + w11 * face[i + 1, j + 1, 3]
    return c0, c1, c2, level, sure


@njit(cache=True, error_model="numpy")
def _relative(axes, r, g, b):  # type: ignore[no-untyped-def]
    """Return G / max(G) and max(G) of a colour; (0, 0, 0) and 1 where no component is positive."""
    G0 = axes[0, 0] * r + axes[0, 1] * g + axes[0, 2] * b
    G1 = axes[1, 0] * r + axes[1, 1] * g + axes[1, 2] * b
    G2 = axes[2, 0] * r + axes[2, 1] * g + axes[2, 2] * b
    largest = max(G0, G1, G2)
    if largest <= 0.0:
        return 0.0, 0.0, 0.0, 1.0
    return G0 / largest, G1 / largest, G2 / largest, largest


@njit(cache=True, error_model="numpy")
def _reach(weights, t, nodes, solved, cone, G0, G1, G2, y, darkest):  # type: ignore[no-untyped-def]
    """Return (c0, c1, c2, level) for a colour of luminance `y` whose largest component is 1; level 0 if out of
    reach.
    """
    c0, c1, c2, level, sure = _look_up(nodes, solved, G0, G1, G2)
    if not sure and not inside(cone, G0, G1, G2):
        return 0.0, 0.0, 0.0, 0.0
    # An error counts relative to luminance: beside the blue of a candle, everything else is small.
    tolerance = SOLVED * min(1.0, y)
    n0, n1, n2, error = solve(weights, t, level * G0, level * G1, level * G2, c0, c1, c2, _AIM * min(1.0, y), 8)
    if error <= tolerance * level:
        return n0, n1, n2, level
    n0, n1, n2, error, level = approach(weights, t, G0, G1, G2, level, c0, c1, c2, tolerance, darkest * level)
    return n0, n1, n2, level if error <= tolerance else 0.0


@njit(cache=True, error_model="numpy")
def _entry(cone, axes, luminance, r, g, b):  # type: ignore[no-untyped-def]
    """Return the share of its light's white at which a colour of positive luminance, mixed with it, enters the
    cone.
    """
    G0 = axes[0, 0] * r + axes[0, 1] * g + axes[0, 2] * b
    G1 = axes[1, 0] * r + axes[1, 1] * g + axes[1, 2] * b
    G2 = axes[2, 0] * r + axes[2, 1] * g + axes[2, 2] * b
    share = 0.0
    for p in range(cone.shape[0]):
        here = cone[p, 0] * G0 + cone[p, 1] * G1 + cone[p, 2] * G2
        white = luminance * (cone[p, 0] + cone[p, 1] + cone[p, 2])
        if here < 0.0:
            share = max(share, here / (here - white))
    return share


@njit(cache=True, error_model="numpy")
def _mixture(weights, t, surface, grades, axes, luminance, share, r, g, b):  # type: ignore[no-untyped-def]
    """Return (c0, c1, c2, level, largest) of a colour mixed with `share` of its light's white, and little more.

    From the table's first good cell on the way to white back to the border, each distance a third of the one
    before and started from its solution: near the border no other start leads anywhere.
    """
    G0 = axes[0, 0] * r + axes[0, 1] * g + axes[0, 2] * b
    G1 = axes[1, 0] * r + axes[1, 1] * g + axes[1, 2] * b
    G2 = axes[2, 0] * r + axes[2, 1] * g + axes[2, 2] * b
    c0, c1, c2, level, largest = 0.0, 0.0, 0.0, 0.5, luminance  # the white itself: S(0) = ½
    found = False
    odds = (
        3e-4  # of white; small beside the colours of a warm light, whose blue counts thousandfold, until far above one
    )
    while odds < 1e6 and not found:
        more = odds / (1.0 + odds)
        mixed = share + (1.0 - share) * more
        M0, M1, M2 = G0 + mixed * (luminance - G0), G1 + mixed * (luminance - G1), G2 + mixed * (luminance - G2)
        top = max(M0, M1, M2)
        m, i, j, p, q, grade = _cell(grades, M0 / top, M1 / top, M2 / top)
        if grade:
            n0, n1, n2, dimness = cubic(surface, m, i, j, p, q)
            bright = 1.0 / (dimness * top)
            aim = _AIM * min(1.0, luminance / top) / dimness
            n0, n1, n2, error = solve(weights, t, bright * M0, bright * M1, bright * M2, n0, n1, n2, aim, 12)
            if error * dimness <= SOLVED * min(1.0, luminance / top):
                found = True
                c0, c1, c2, level, largest = n0, n1, n2, 1.0 / dimness, top
        if not found:
            odds *= 3.0
    while found and odds > 4e-4:
        odds /= 3.0
        more = odds / (1.0 + odds)
        mixed = share + (1.0 - share) * more
        M0, M1, M2 = G0 + mixed * (luminance - G0), G1 + mixed * (luminance - G1), G2 + mixed * (luminance - G2)
        top = max(M0, M1, M2)
        least = min(1.0, luminance / top)
        found = False
        dimmed = level
        for _ in range(3):
            n0, n1, n2, error = solve(
                weights, t, dimmed / top * M0, dimmed / top * M1, dimmed / top * M2, c0, c1, c2, _AIM * least, 20
            )
            if error <= SOLVED * least * dimmed:
                c0, c1, c2, level, largest = n0, n1, n2, dimmed, top
                found = True
                break
            dimmed *= 0.6
    return c0, c1, c2, level, largest


@njit(cache=True, error_model="numpy")
def _cell(grades, r, g, b):  # type: ignore[no-untyped-def]
    """Return (m, i, j, p, q, grade): the cell of a colour, the place in it, and the cell's grade, 0 outside of the
    table.
    """
    if r >= g and r >= b:
        m, p, q = 0, g, b
    elif g >= b:
        m, p, q = 1, b, r
    else:
        m, p, q = 2, r, g
    cells = grades.shape[1]
    # NaN fails this too.
    if not (p >= 0.0 and q >= 0.0):
        return m, 0, 0, 0.0, 0.0, np.uint8(0)
    p, q = p * cells, q * cells
    i, j = min(int(p), cells - 1), min(int(q), cells - 1)
    return m, i, j, p - i, q - j, grades[m, i, j]


@njit(cache=True, error_model="numpy")
def _difficult(  # type: ignore[no-untyped-def]
    luminance_weights, axes, weights, t, nodes, solved, cones, surfaces, grades, k, red, green, blue
):
    """Return (kind, light, c0, c1, c2, scale) of any pixel at all, without a look at its cell's grade."""
    last = axes.shape[0] - 1
    size = max(abs(red), abs(green), abs(blue))
    if not np.isfinite(red + green + blue):
        return MISSING, k, 0.0, 0.0, -np.inf, 0.0
    if size == 0.0:
        return BLACK, k, 0.0, 0.0, -np.inf, 0.0
    red, green, blue = red / size, green / size, blue / size
    y = luminance_weights[0] * red + luminance_weights[1] * green + luminance_weights[2] * blue
    # What has no luminance is outside of every cone of light.
    if not y > 0.0:
        return CLOSEST, k, 0.0, 0.0, -np.inf, 0.0
    for attempt in range(2):
        kind, light = (EXACT, k) if attempt == 0 else (FALLBACK, last)
        G0, G1, G2, largest = _relative(axes[light], red, green, blue)
        c0, c1, c2, level = _reach(
            weights[light], t, nodes[light], solved[light], cones[light], G0, G1, G2, y / largest, _DARKEST
        )
        if level > 0.0:
            return kind, light, c0, c1, c2, largest * size / level
    share = _entry(cones[k], axes[k], y, red, green, blue)
    other = _entry(cones[last], axes[last], y, red, green, blue)
    if other < share:
        k, share = last, other
    c0, c1, c2, level, largest = _mixture(weights[k], t, surfaces[k], grades[k], axes[k], y, share, red, green, blue)
    return CLOSEST, k, c0, c1, c2, largest * size / level


@njit(cache=True, error_model="numpy", parallel=True)
def _uplift(  # type: ignore[no-untyped-def]
    rgb,
    cluster,
    precision,
    axes,
    weights,
    t,
    nodes,
    solved,
    cones,
    surfaces,
    grades,
    curvatures,
    luminance_weights,
    a_and_b,
    coefficients,
    scale,
    emission,
    status,
    counts,
):
    a, b = a_and_b[0], a_and_b[1]
    size = scale.size
    for block in prange(counts.shape[0]):
        for index in range(block * BLOCK, min(size, (block + 1) * BLOCK)):
            # Not float(): that leaves a float32 one, and the divisions below would round to 24 bits.
            red, green, blue = np.float64(rgb[index, 0]), np.float64(rgb[index, 1]), np.float64(rgb[index, 2])
            k = np.int64(cluster[index])
            kind = EXACT
            G0 = axes[k, 0, 0] * red + axes[k, 0, 1] * green + axes[k, 0, 2] * blue
            G1 = axes[k, 1, 0] * red + axes[k, 1, 1] * green + axes[k, 1, 2] * blue
            G2 = axes[k, 2, 0] * red + axes[k, 2, 1] * green + axes[k, 2, 2] * blue
            largest = max(G0, G1, G2)
            c0 = c1 = c2 = brightness = 0.0
            done = False
            # Their reciprocals are numbers too.
            if 1e-290 < largest < 1e290:
                one = 1.0 / largest
                m, i, j, p, q, grade = _cell(grades[k], G0 * one, G1 * one, G2 * one)
                if grade:
                    if precision == PREVIEW and grade & LINEAR:
                        c0, c1, c2, dimness = linear(surfaces[k], m, i, j, p, q)
                        done = True
                    else:
                        c0, c1, c2, dimness = cubic(surfaces[k], m, i, j, p, q)
                        done = precision != ALL and grade & CUBIC != 0
                    if not done:
                        level = 1.0 / dimness
                        y = (
                            luminance_weights[0] * red + luminance_weights[1] * green + luminance_weights[2] * blue
                        ) * one
                        aim = (1e-14 if precision == ALL else 1e-8) * min(1.0, y)
                        g0, g1, g2 = level * one * G0, level * one * G1, level * one * G2
                        curvature = curvatures[k, m, i, j]
                        for _ in range(6):
                            c0, c1, c2, error = newton(weights[k], t, g0, g1, g2, c0, c1, c2)
                            # The next residual is at most this, so no need to look.
                            if curvature * error * error <= aim:
                                done = True
                                break
                    brightness = largest * dimness
            if not done:
                kind, k, c0, c1, c2, brightness = _difficult(
                    luminance_weights, axes, weights, t, nodes, solved, cones, surfaces, grades, k, red, green, blue
                )
            coefficients[index, 0] = c0 * (b * b)
            coefficients[index, 1] = c1 * b - 2.0 * c0 * (a * b * b)
            coefficients[index, 2] = c2 - c1 * (a * b) + c0 * ((a * b) * (a * b))
            scale[index] = brightness
            emission[index] = k
            status[index] = kind
            counts[block, kind] += 1
