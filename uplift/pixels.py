"""Uplift of whole maps: three coefficients and a scale for each pixel, exact to double precision.

P(λ) = scale · E(λ) · S(c0 λ² + c1 λ + c2), E the emission of the pixel's light (Tódová and Wilkie,
"Constrained Spectral Uplifting for HDR Environment Maps", EGSR 2024; the sigmoid of Jakob and Hanika 2019). Each
pixel starts from its light's look-up table (`uplift.lookup`) or, near the border of what the light can show, from its
fan (`uplift.reach`), and goes on with Newton's method on the spectral sum itself, so it depends on them for its speed
only.

What each pixel got is its `Status`. A colour that E · R cannot show takes another light and stays exact: that of another
cluster, the nearest in colour first; then D65; then one of two lights for the ends of the range. A colour that none of
them shows lies outside the locus of the grid's wavelengths, or within a few 1e-5 of chromaticity of it (1e-4 at its red
and blue corners). It is mixed with the white of its light or of D65, whichever takes less, at constant luminance until it
can be shown; without positive luminance it becomes black. Nothing of this is silent: `Uplifted` counts each class, and
says how far the moved colours went.

Pixels are independent of each other: any tile of a map, in any order, on any number of threads, gives the
same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cache, lru_cache
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from uplift import UpliftError
from uplift.difference import delta_e_2000
from uplift.lanes import terms_of
from uplift.lookup import ALL, BLOCK, FLOAT, PENDING, PREVIEW, STRAY, look_up
from uplift.polynomial import TRIES
from uplift.radiance import rgb_of, spectra_of
from uplift.reach import settle
from uplift.sigmoid import normalisation
from uplift.spectrum import Float64, Observer, RGBSpace, illuminant, normalised, xyz_of
from uplift.table import BRIGHTNESS, Table, build_table

__all__ = [
    "FALLBACK_LIGHTS",
    "Buffers",
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


@dataclass(frozen=True, slots=True, eq=False)
class Buffers:
    """Memory for the results of `uplift_pixels`, which callers who stream a map give again for each tile: new pages
    from the system take a quarter of a preview's time.

    For up to M pixels: `coefficients` [M, 3] float64, `scale` [M] float64, `emission` [M] uint32, `status` [M] uint8, all
    contiguous.
    """

    coefficients: Float64
    scale: Float64
    emission: npt.NDArray[np.uint32]
    status: npt.NDArray[np.uint8]

    @classmethod
    def of(cls, pixels: int) -> Buffers:
        """Return new memory for so many pixels."""
        return cls(np.empty((pixels, 3)), np.empty(pixels), np.empty(pixels, np.uint32), np.empty(pixels, np.uint8))


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
def fallback_tables(
    observer: Observer, space: RGBSpace, nodes: int = 64, factor: float = BRIGHTNESS
) -> tuple[Table, ...]:
    """Return the tables of `fallback_emissions`, kept for the next call."""
    # Their fans matter, not their nodes.
    return tuple(
        build_table(emission, observer=observer, space=space, nodes=min(nodes, 8), factor=factor)
        for emission in fallback_emissions(observer)
    )


Precision = Literal["exact", "float", "preview"]
_PRECISIONS: dict[str, int] = {"exact": ALL, "float": FLOAT, "preview": PREVIEW}


def uplift_pixels(
    rgb: npt.NDArray[np.floating],
    cluster: npt.NDArray[np.integer],
    tables: Sequence[Table],
    *,
    precision: Precision = "exact",
    out: Buffers | None = None,
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
    out
        Memory for at least H · W pixels, which is written to; the arrays of the result are then views of it, good until
        it is given again. Without it they are new.

    Raises
    ------
    UpliftError
        If shapes disagree, a cluster has no table, the tables differ in kind, the precision is unknown, or `out` is too
        small or of other types.

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
    if out is None:
        out = Buffers.of(size)
    _check_buffers(out, size)
    coefficients, scale, emission, status = (part[:size] for part in _parts(out))
    # One row of counts a block, so that no two threads add to the same number.
    counts = np.zeros((-(-size // BLOCK), STRAY + 1), np.int64)
    look_up(
        values.reshape(-1),
        labels,
        _PRECISIONS[precision],
        len(tables),
        *_packed(tuple(tables)),
        coefficients.reshape(-1),
        scale,
        emission,
        status,
        counts,
    )
    counts = counts.sum(axis=0)
    if counts[STRAY]:
        _check_labels(cluster, tables)
    if counts[PENDING]:
        every = (*tables, *fallback_tables(first.observer, first.space, first.solved.shape[1], first.factor))
        where = np.flatnonzero(status == PENDING)
        _settle_all(where, values, labels, every, precision, coefficients, scale, emission, status)
        counts = counts + np.bincount(status[where], minlength=STRAY + 1)
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


def _parts(out: Buffers) -> tuple[npt.NDArray[Any], ...]:
    return out.coefficients, out.scale, out.emission, out.status


@lru_cache(maxsize=2)
def _packed(tables: tuple[Table, ...]) -> tuple[Any, ...]:
    """Return what `look_up` reads of the tables, one light after the other: kept, since copying it takes as long as the
    preview of a hundred thousand pixels.
    """
    first = tables[0]
    return (
        np.concatenate([table.axes.reshape(-1) for table in tables]),
        np.concatenate([terms_of(table.weights, table.t) for table in tables]),
        first.t.size,
        first.solved.shape[1],
        np.concatenate([table.surface.reshape(-1) for table in tables]),
        np.concatenate([table.coarse.reshape(-1) for table in tables]),
        np.concatenate([table.grades.reshape(-1) for table in tables]),
        np.concatenate([table.curvature.reshape(-1) for table in tables]),
        first.space.luminance_weights,
        np.array(normalisation(first.observer)),
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
    if isinstance(tables, Table) or not isinstance(tables, Sequence) or not all(isinstance(t, Table) for t in tables):
        given = "one Table" if isinstance(tables, Table) else "no sequence of Tables"
        raise UpliftError(
            f"uplift_pixels: tables is {given}; expected one for each cluster, in a list, such as [table], with the cluster 0 for "
            "every pixel"
        )
    if not tables:
        raise UpliftError("uplift_pixels: no tables; build one for each cluster with build_table")
    # Those of 32 unsigned bits are checked on the way, by all threads.
    if cluster.dtype != np.uint32:
        _check_labels(cluster, tables)
    kinds = {(id(table.observer), id(table.space), table.solved.shape[1], table.factor) for table in tables}
    if len(kinds) > 1:
        raise UpliftError(
            "uplift_pixels: the tables differ in observer, space, number of nodes or factor; build all of them with the "
            "same arguments"
        )


def _check_buffers(out: Buffers, size: int) -> None:
    for name, part, like in zip(Buffers.__slots__, _parts(out), _parts(Buffers.of(0)), strict=True):
        fits = part.dtype == like.dtype and part.shape[1:] == like.shape[1:] and part.flags.c_contiguous
        if not fits or len(part) < size or not part.flags.writeable:
            raise UpliftError(
                f"uplift_pixels: out.{name} has shape {part.shape} of {part.dtype}; expected writeable, contiguous "
                f"{like.dtype} for at least {size} pixels, as Buffers.of({size}) makes them"
            )


def _check_labels(cluster: npt.NDArray[np.integer], tables: Sequence[Table]) -> None:
    if cluster.size and not 0 <= int(cluster.min()) <= int(cluster.max()) < len(tables):
        raise UpliftError(
            f"uplift_pixels: clusters run from {cluster.min()} to {cluster.max()}, but there are {len(tables)} tables "
            f"(0 to {len(tables) - 1}); give one for each cluster"
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
