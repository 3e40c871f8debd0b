"""Uplift of a map in the skewed lattices of its lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from uplift import UpliftError
from uplift.difference import delta_e_2000
from uplift.lattice.cube import Lattice, build_lattice
from uplift.lattice.mixture import rgb_of_lattice
from uplift.lattice.walk import locate, nearest
from uplift.pixels import Status
from uplift.spectrum import Float64, illuminant


@dataclass(frozen=True, slots=True, eq=False)
class LatticeUplift:
    """The spectra of a map as mixtures: P = scale · E · Σ wᵢ Rᵢ over the eight corners of a cell.

    `cell` [H, W] int32 is the cell's number, `position` [H, W, 3] float64 the place in it in 0 … 1, from which
    `nodes_and_weights` makes the eight nodes and their weights. `scale` [H, W]; `emission` [H, W] uint32, index into
    `emissions` [K, N] (those of the lattices, then D65's), each with Y = 1; `status` [H, W] uint8, see
    `uplift.pixels.Status`; `counts` of pixels by status; `visited` [H, W] uint32, how many cells were looked into;
    `largest_shift`, the largest ΔE2000 between what was asked and what was given over the CLOSEST pixels;
    `warnings` to show. Black and missing pixels have scale 0.
    """

    cell: npt.NDArray[np.int32]
    position: Float64
    scale: Float64
    emission: npt.NDArray[np.uint32]
    status: npt.NDArray[np.uint8]
    emissions: Float64
    counts: dict[Status, int]
    visited: npt.NDArray[np.uint32]
    largest_shift: float
    warnings: tuple[str, ...]


def uplift_lattice(
    rgb: npt.NDArray[np.floating],
    cluster: npt.NDArray[np.integer],
    lattices: Sequence[Lattice],
    *,
    factor: float = 2.0,
    bright: float = 1.0,
) -> LatticeUplift:
    """Return spectra whose RGB is `rgb`, each pixel under the light of its cluster, as mixtures of eight.

    Parameters
    ----------
    rgb
        Shape (H, W, 3), any finite or missing values. Linear RGB in the space of the cube.
    cluster
        Shape (H, W), integers: the index into `lattices` of each pixel's light.
    lattices
        One per light, all of the same cube.
    factor
        scale = `factor` · max(rgb), 2 in the paper.
    bright
        The max(rgb) above which a pixel outside the lattice is HDR, and takes the nearest colour instead of D65.

    Raises
    ------
    UpliftError
        If shapes disagree, a cluster has no lattice, the lattices are of different cubes or a number is out of range.

    Property: `rgb_of_lattice` gives back `rgb` for EXACT and FALLBACK pixels.
    """
    rgb, cluster = np.asarray(rgb), np.asarray(cluster)
    _check(rgb, cluster, lattices, factor)
    cube = lattices[0].cube
    every = (*lattices, build_lattice(illuminant("D65", cube.observer), cube))
    shape = rgb.shape[:2]
    cell, visited = np.zeros(shape, np.int32), np.zeros(shape, np.uint32)
    position, scale = np.zeros(rgb.shape), np.zeros(shape)
    emission, status = np.empty(shape, np.uint32), np.empty(shape, np.uint8)
    _uplift(
        np.ascontiguousarray(rgb, dtype=np.float64),
        np.ascontiguousarray(cluster, dtype=np.uint32),
        np.stack([lattice.rgb for lattice in every]),
        np.stack([lattice.boxes for lattice in every]),
        np.stack([lattice.rows for lattice in every]),
        factor,
        bright,
        cell,
        position,
        scale,
        emission,
        status,
        visited,
    )
    emissions = np.stack([lattice.emission for lattice in every])
    found = np.bincount(status.ravel(), minlength=len(Status))
    counts = {kind: int(found[kind]) for kind in Status}
    shift = 0.0
    moved = status == Status.CLOSEST
    if moved.any():
        shown = rgb_of_lattice(cell[moved], position[moved], scale[moved], emission[moved], emissions, cube)
        shift = float(delta_e_2000(np.asarray(rgb[moved], dtype=np.float64), shown, cube.space).max())
    return LatticeUplift(
        cell, position, scale, emission, status, emissions, counts, visited, shift, _warnings(counts, shift)
    )


def nodes_and_weights(
    cell: npt.NDArray[np.integer], position: npt.NDArray[np.floating], size: int
) -> tuple[npt.NDArray[np.int64], Float64]:
    """Return the eight nodes [..., 8] of cells [...] of a cube of `size`³, and their weights [..., 8], of sum 1.

    A node is an index into the cube's flattened [size³] nodes.
    """
    side = size - 1
    i, j, k = cell // (side * side), cell // side % side, cell % side
    u, v, w = np.moveaxis(np.asarray(position, dtype=np.float64), -1, 0)
    nodes, weights = [], []
    for di, dj, dk in np.ndindex(2, 2, 2):
        nodes.append(((i + di).astype(np.int64) * size + (j + dj)) * size + (k + dk))
        weights.append((u if di else 1 - u) * (v if dj else 1 - v) * (w if dk else 1 - w))
    return np.stack(nodes, axis=-1), np.stack(weights, axis=-1)


def _check(
    rgb: npt.NDArray[np.floating], cluster: npt.NDArray[np.integer], lattices: Sequence[Lattice], factor: float
) -> None:
    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype.kind != "f":
        raise UpliftError(f"uplift_lattice: rgb has shape {rgb.shape} of {rgb.dtype}; expected floats [H, W, 3]")
    if cluster.shape != rgb.shape[:2] or cluster.dtype.kind not in "ui":
        raise UpliftError(
            f"uplift_lattice: cluster has shape {cluster.shape} of {cluster.dtype}; expected integers "
            f"{rgb.shape[:2]}, the index of each pixel's lattice"
        )
    if not lattices:
        raise UpliftError("uplift_lattice: no lattices; build one for each cluster with build_lattice")
    if cluster.size and not 0 <= int(cluster.min()) <= int(cluster.max()) < len(lattices):
        raise UpliftError(
            f"uplift_lattice: clusters run from {cluster.min()} to {cluster.max()}, but there are {len(lattices)} "
            f"lattices (0 to {len(lattices) - 1}); give one for each cluster"
        )
    if any(lattice.cube is not lattices[0].cube for lattice in lattices):
        raise UpliftError("uplift_lattice: the lattices are of different cubes; build all of them from one")
    if not factor > 1:
        raise UpliftError(f"uplift_lattice: factor {factor}; expected more than 1, since R stays below one")


def _warnings(counts: dict[Status, int], largest_shift: float) -> tuple[str, ...]:
    total = max(1, sum(counts.values()))
    said = {
        Status.FALLBACK: "lie outside their light's lattice and are dark; they keep their colour under D65",
        Status.CLOSEST: f"lie outside the lattice; they took its nearest colour, up to ΔE2000 {largest_shift:.3g} away",
        Status.MISSING: "are NaN or infinite; they have no radiance",
    }
    return tuple(
        f"{counts[kind]} pixels ({counts[kind] / total:.4%}) {what}" for kind, what in said.items() if counts[kind]
    )


_EXACT, _BLACK, _FALLBACK, _CLOSEST, _MISSING = (int(kind) for kind in Status)


@njit(cache=True, error_model="numpy", parallel=True)
def _uplift(  # type: ignore[no-untyped-def]
    rgb, cluster, lattices, boxes, rows, factor, bright, cell, position, scale, emission, status, visited
):
    width = rgb.shape[1]
    last, far = lattices.shape[0] - 1, lattices.shape[1] - 1
    for index in prange(rgb.shape[0] * width):
        row, column = index // width, index % width
        r, g, b = rgb[row, column, 0], rgb[row, column, 1], rgb[row, column, 2]
        light = int(cluster[row, column])
        kind, looked = _EXACT, 0
        largest = max(r, g, b)
        if not np.isfinite(r + g + b):
            kind = _MISSING
        elif r == 0.0 and g == 0.0 and b == 0.0:
            kind = _BLACK
        elif not largest > 0.0:
            kind = _CLOSEST
        else:
            brightness = factor * largest
            # Divided twice: the factor first could overflow.
            r, g, b = r / largest / factor, g / largest / factor, b / largest / factor
            white = lattices[light, far, far, far]
            found, u, v, w, looked = locate(lattices[light], boxes[light], rows[light], white, r, g, b)
            if found < 0 and largest <= bright:
                kind = _FALLBACK
                white = lattices[last, far, far, far]
                found, u, v, w, more = locate(lattices[last], boxes[last], rows[last], white, r, g, b)
                looked += more
                if found >= 0:
                    light = last
            if found < 0:
                kind = _CLOSEST
                found, u, v, w = nearest(lattices[light], boxes[light], r, g, b)
            cell[row, column] = found
            position[row, column, 0] = u
            position[row, column, 1] = v
            position[row, column, 2] = w
            scale[row, column] = brightness
        emission[row, column] = light
        status[row, column] = kind
        visited[row, column] = looked
