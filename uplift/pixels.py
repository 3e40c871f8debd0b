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
from uplift.newton import newton
from uplift.polynomial import TRIES, about, in_nm, stored
from uplift.radiance import rgb_of, spectra_of
from uplift.reach import settle
from uplift.sigmoid import normalisation
from uplift.spectrum import Float64, Observer, RGBSpace, illuminant, normalised, xyz_of
from uplift.surface import CUBIC, LINEAR, cell_of, cubic, linear
from uplift.table import Table, build_table

__all__ = [
    "FALLBACK_LIGHTS",
    "Status",
    "Uplifted",
    "fallback_emissions",
    "fallback_tables",
    "rgb_of",
    "spectra_of",
    "uplift_pixels",
]


class Status(IntEnum):
    """What a pixel's spectrum is."""

    EXACT = 0  # its colour, under its light
    BLACK = 1  # no radiance
    FALLBACK = 2  # its colour, under another light (its emission tells which) since its own cannot show it
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


FALLBACK_LIGHTS = (
    "D65, for colours that their own light cannot show",
    "D65 without its middle, for colours next to the line of purples",
    "the red end of D65, for colours next to it",
)


def fallback_emissions(observer: Observer) -> Float64:
    """Return the emissions [3, N] of `FALLBACK_LIGHTS`, Y = 1, which `Uplifted.emissions` has after those of the tables.

    Colours of the range's ends take steep flanks under D65, steeper than a smooth reflectance has. So two lights have
    the flanks themselves, and a ten-thousandth of D65 elsewhere.
    """
    nm = observer.wavelengths_nm
    d65 = illuminant("D65", observer)
    blue, red = 1 / (1 + np.exp((nm - 430.0) / 6.0)), 1 / (1 + np.exp((655.0 - nm) / 6.0))
    return np.stack([d65, normalised(d65 * (1e-4 + blue + red), observer), normalised(d65 * (1e-4 + red), observer)])


@cache
def fallback_tables(observer: Observer, space: RGBSpace, nodes: int = 64, factor: float = 2.0) -> tuple[Table, ...]:
    """Return the tables of `fallback_emissions`, kept for the next call."""
    # Their fans matter, not their nodes.
    return tuple(
        build_table(emission, observer=observer, space=space, nodes=min(nodes, 8), factor=factor)
        for emission in fallback_emissions(observer)
    )


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
    size = cluster.size
    values = rgb if rgb.dtype in (np.float32, np.float64) else rgb.astype(np.float64)
    values = np.ascontiguousarray(values).reshape(size, 3)
    labels = np.ascontiguousarray(cluster, dtype=np.uint32).reshape(size)
    coefficients = np.empty((size, 3))
    scale = np.empty(size)
    emission = np.empty(size, np.uint32)
    status = np.empty(size, np.uint8)
    # One row of counts a block, so that no two threads add to the same number.
    counts = np.zeros((-(-size // _BLOCK), _PENDING + 1), np.int64)
    _look_up(
        values,
        labels,
        _PRECISIONS[precision],
        np.stack([table.axes for table in tables]),
        np.stack([table.weights for table in tables]),
        first.t,
        np.stack([table.surface for table in tables]),
        np.stack([table.coarse for table in tables]),
        np.stack([table.grades for table in tables]),
        np.stack([table.curvature for table in tables]),
        first.space.luminance_weights,
        np.array(normalisation(first.observer)),
        coefficients,
        scale,
        emission,
        status,
        counts,
    )
    counts = counts.sum(axis=0)
    if counts[_PENDING]:
        every = (*tables, *fallback_tables(first.observer, first.space, first.solved.shape[1], first.factor))
        where = np.flatnonzero(status == _PENDING)
        _settle_all(where, values, labels, every, precision, coefficients, scale, emission, status)
        counts = counts + np.bincount(status[where], minlength=_PENDING + 1)
    found = {kind: int(counts[kind]) for kind in Status}
    emissions = np.concatenate([[table.emission for table in tables], fallback_emissions(first.observer)])
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


def _settle_all(
    where: npt.NDArray[np.int64],
    values: npt.NDArray[np.floating],
    labels: npt.NDArray[np.uint32],
    tables: tuple[Table, ...],
    precision: Precision,
    coefficients: Float64,
    scale: Float64,
    emission: npt.NDArray[np.uint32],
    status: npt.NDArray[np.uint8],
) -> None:
    """Solve the pixels that no cell answered; writes to the four last."""
    first, own = tables[0], len(tables) - len(FALLBACK_LIGHTS)
    xyz = np.stack([xyz_of(table.emission, first.observer) for table in tables])
    xy = xyz[:, :2] / xyz.sum(axis=1, keepdims=True)
    # Each light itself, the other clusters' from the nearest colour on, then the fallbacks.
    apart = np.hypot(*(xy[:own, None] - xy[None, :own]).transpose(2, 0, 1))
    np.fill_diagonal(apart, -1.0)
    last = np.broadcast_to(np.arange(own, len(tables)), (own, len(FALLBACK_LIGHTS)))
    fans = [table.fan for table in tables]
    settle(
        where,
        values[where].astype(np.float64),
        labels[where],
        np.concatenate([np.argsort(apart, axis=1, kind="stable"), last], axis=1),
        np.stack([table.axes for table in tables]),
        np.array([table.white_sum for table in tables]),
        first.space.luminance_weights,
        np.stack([table.weights for table in tables]),
        first.observer.wavelengths_nm,
        np.array(normalisation(first.observer)),
        np.concatenate([fan.sectors for fan in fans]),
        np.concatenate([fan.nodes for fan in fans]),
        np.concatenate([fan.reach for fan in fans]),
        np.cumsum([0, *(fan.reach.size for fan in fans)]),
        TRIES if precision == "exact" else 1,
        coefficients,
        scale,
        emission,
        status,
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
            "cannot show; they keep their colour under another light, D65 where no other cluster's does"
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
_EXACT, _PENDING = int(Status.EXACT), len(Status)  # what no cell answers is settled afterwards

# Of precisions, and what the compiled code calls them.
_PREVIEW, _FLOAT, _ALL = 0, 1, 2
_PRECISIONS: dict[str, int] = {"exact": _ALL, "float": _FLOAT, "preview": _PREVIEW}
_BLOCK = 4096  # pixels that one thread takes at a time
_CANCELLING = 64.0  # of c2 for λ in nm: from there on the three coefficients are rounded together


@njit(cache=True, error_model="numpy", parallel=True)
def _look_up(  # type: ignore[no-untyped-def]
    rgb,
    cluster,
    precision,
    axes,
    weights,
    t,
    surfaces,
    coarse,
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
        for index in range(block * _BLOCK, min(size, (block + 1) * _BLOCK)):
            # Not float(): that leaves a float32 one, and the divisions below would round to 24 bits.
            red, green, blue = np.float64(rgb[index, 0]), np.float64(rgb[index, 1]), np.float64(rgb[index, 2])
            k = np.int64(cluster[index])
            kind = _PENDING
            G0 = axes[k, 0, 0] * red + axes[k, 0, 1] * green + axes[k, 0, 2] * blue
            G1 = axes[k, 1, 0] * red + axes[k, 1, 1] * green + axes[k, 1, 2] * blue
            G2 = axes[k, 2, 0] * red + axes[k, 2, 1] * green + axes[k, 2, 2] * blue
            largest = max(G0, G1, G2)
            c0 = c1 = c2 = dimness = 0.0
            # Their reciprocals are numbers too.
            if 1e-290 < largest < 1e290:
                one = 1.0 / largest
                m, i, j, p, q, grade = cell_of(grades[k], G0 * one, G1 * one, G2 * one)
                if precision == _PREVIEW and grade & LINEAR:
                    c0, c1, c2, dimness = linear(coarse[k], m, i, j, p, q)
                    kind = _EXACT
                elif grade:
                    c0, c1, c2, dimness = cubic(surfaces[k], m, i, j, p, q)
                    if precision != _ALL and grade & CUBIC:
                        kind = _EXACT
                    else:
                        level = 1.0 / dimness
                        y = luminance_weights[0] * red + luminance_weights[1] * green + luminance_weights[2] * blue
                        aim = (1e-14 if precision == _ALL else 1e-8) * min(1.0, y * one)
                        g0, g1, g2 = level * one * G0, level * one * G1, level * one * G2
                        curvature = curvatures[k, m, i, j]
                        for _ in range(6):
                            c0, c1, c2, error = newton(weights[k], t, g0, g1, g2, c0, c1, c2)
                            # The next residual is at most this, so no need to look.
                            if curvature * error * error <= aim:
                                kind = _EXACT
                                break
                    n1, n2 = c1 * b - 2.0 * c0 * (a * b * b), c2 - c1 * (a * b) + c0 * ((a * b) * (a * b))
                    if precision == _ALL and abs(n2) > _CANCELLING:
                        c0, c1, c2, summit = about(c0, c1, c2, 0.0)
                        c0, c1, c2, summit = in_nm(c0, c1, c2, summit, a, b)
                        c0, c1, c2 = stored(c0, c1, c2, summit, TRIES)
                    else:
                        c0, c1, c2 = c0 * (b * b), n1, n2
            coefficients[index, 0] = c0
            coefficients[index, 1] = c1
            coefficients[index, 2] = c2
            scale[index] = largest * dimness
            emission[index] = k
            status[index] = kind
            counts[block, kind] += 1
