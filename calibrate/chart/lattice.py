"""Grids of 6 × 4 places among points in the plane, as a homography may show them.

Around each point two of its neighbours span a lattice; spans that predict further points are grown from place to place, each
step guided by the steps beside it, so that perspective is followed. Whatever 6 × 4 window of the grown lattice holds
enough points is a place where a chart may be; its box follows from a homography through the points.
"""

from collections.abc import Iterator
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from calibrate.chart.geometry import (
    COLUMNS,
    GAP_WIDTH,
    PATCH_WIDTH,
    ROWS,
    box_corners,
    image_from_chart,
    patch_quads,
    project,
)
from calibrate.chart.zones import Zones

Points = npt.NDArray[np.float64]
Lattice = dict[tuple[int, int], int]

_NEIGHBOURS: Final = 9
# How far a point may be from where it is predicted, in parts of the step.
_NEAR: Final = 0.25
# Zones of one chart differ in area by perspective, and by how much of the edges each threshold takes away.
_LARGEST_RATIO: Final = 3.0
# The prediction of four places around and four diagonal ones; so many must hold a point.
_LEAST_SUPPORT: Final = 4
_LEAST_POINTS: Final = 9
_MOST_LATTICES: Final = 12
# When the box is known: how far a zone's centre may be from its patch's (in steps), and how much of a patch it may be.
_ASTRAY: Final = 0.2
_SMALLEST_PART: Final = 0.15
_LARGEST_PART: Final = 1.25
_SHEARS: Final = tuple(
    np.array(matrix)
    for matrix in ([[1, 0], [0, 1]], [[1, 1], [0, 1]], [[1, -1], [0, 1]], [[1, 0], [1, 1]], [[1, 0], [-1, 1]])
)
_AROUND: Final = ((1, 0), (0, 1), (-1, 0), (0, -1))


def grids(zones: Zones) -> Iterator[Points]:
    """Yield for each lattice the corners [K, 4, 2] of the boxes of its likely 6 × 4 grids, the best supported first.

    Which corner is which is not known: the box may be turned by half a turn, or mirrored.
    """
    if len(zones.centres) < _LEAST_POINTS:
        return
    tree = cKDTree(zones.centres)
    used = np.zeros(len(zones.centres), dtype=np.bool_)
    grown = 0
    for seed, first, second in _spans(zones, tree):
        if used[seed] or grown >= _MOST_LATTICES:
            continue
        lattice = _grown(zones, tree, seed, first, second)
        if len(lattice) < _LEAST_POINTS:
            continue
        grown += 1
        used[list(lattice.values())] = True
        boxes = list(_windows(zones.centres, lattice))
        if boxes:
            yield np.stack(boxes)


def _spans(zones: Zones, tree: cKDTree) -> Iterator[tuple[int, Points, Points]]:
    """Yield (seed, step, step) in the order of how many of the eight places around the seed hold a point."""
    count = len(zones.centres)
    distances, near = tree.query(zones.centres, k=min(_NEIGHBOURS, count))
    near, distances = near[:, 1:], distances[:, 1:]
    steps = zones.centres[near] - zones.centres[:, None, :]
    ratio = zones.areas[near] / zones.areas[:, None]
    alike = (ratio < _LARGEST_RATIO) & (ratio > 1 / _LARGEST_RATIO)
    size = np.sqrt(zones.areas)[:, None]
    # Neighbours' middles are at least a patch apart, at most a few (a patch at a slant, its edges taken away).
    alike &= (distances > 0.9 * size) & (distances < 6.0 * size)
    a, b = np.triu_indices(near.shape[1], 1)
    u, v = steps[:, a], steps[:, b]
    cross = np.abs(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])
    long, short = np.hypot(*np.moveaxis(u, -1, 0)), np.hypot(*np.moveaxis(v, -1, 0))
    # Steps of a reduced basis: neither nearly parallel nor much longer than the other.
    possible = alike[:, a] & alike[:, b] & (cross > 0.35 * long * short)
    possible &= np.maximum(long, short) < 4.0 * np.minimum(long, short)
    # The cell of a patch and its gaps is 1.2 times the patch, and more where edges were taken away.
    possible &= (cross > 1.0 * zones.areas[:, None]) & (cross < 8.0 * zones.areas[:, None])
    seed, pair = np.nonzero(possible)
    if seed.size == 0:
        return
    u, v = u[seed, pair], v[seed, pair]
    places = np.array([(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)], dtype=np.float64)
    predicted = zones.centres[seed][:, None, :] + places[None, :, :1] * u[:, None] + places[None, :, 1:] * v[:, None]
    reach = _NEAR * np.minimum(np.hypot(*u.T), np.hypot(*v.T))
    distance, index = tree.query(predicted)
    ratio = zones.areas[index] / zones.areas[seed][:, None]
    hit = (distance < reach[:, None]) & (ratio < _LARGEST_RATIO) & (ratio > 1 / _LARGEST_RATIO)
    # Among equally supported spans the shorter one is the basis, the longer one a combination.
    support = hit.sum(axis=1) - 0.5 * (np.hypot(*u.T) + np.hypot(*v.T)) / (8.0 * np.sqrt(zones.areas[seed]))
    for best in np.argsort(-support, kind="stable"):
        if hit[best].sum() < _LEAST_SUPPORT:
            return
        yield int(seed[best]), u[best], v[best]


def _grown(zones: Zones, tree: cKDTree, seed: int, first: Points, second: Points) -> Lattice:
    """Return places → points, starting from a seed and its two steps, from neighbour to neighbour."""
    lattice: Lattice = {(0, 0): seed}
    taken = {seed}
    steps: dict[tuple[int, int], tuple[Points, Points]] = {(0, 0): (first, second)}
    front = [(0, 0)]
    while front:
        place = front.pop(0)
        index, (u, v) = lattice[place], steps[place]
        for dx, dy in _AROUND:
            there = (place[0] + dx, place[1] + dy)
            if there in lattice or max(abs(there[0]), abs(there[1])) > 7:
                continue
            step = dx * u + dy * v
            distance, nearest = tree.query(zones.centres[index] + step)
            ratio = zones.areas[nearest] / zones.areas[index]
            if distance > _NEAR * np.hypot(*step) or nearest in taken:
                continue
            if not 1 / _LARGEST_RATIO < ratio < _LARGEST_RATIO:
                continue
            lattice[there] = int(nearest)
            taken.add(int(nearest))
            walked = (zones.centres[nearest] - zones.centres[index]) * (dx + dy)
            # Steps change slowly: half of the new one, half of what was believed.
            steps[there] = (0.5 * (u + walked), v) if dx else (u, 0.5 * (v + walked))
            front.append(there)
    return lattice


def _windows(centres: Points, lattice: Lattice) -> Iterator[Points]:
    """Yield the box of every 6 × 4 and 4 × 6 window that holds nearly as many points as the fullest one.

    At a slant a diagonal of the grid may be shorter than a step, and is taken for one: so the places are sheared, too.
    """
    points = centres[list(lattice.values())]
    found: list[tuple[int, npt.NDArray[np.int64], tuple[int, int], int, npt.NDArray[np.int64]]] = []
    for shear in _SHEARS:
        places = np.array(list(lattice)) @ shear
        found += [(*window, len(found), places) for window in _counted(places)]
    fullest = max((window[0] for window in found), default=0)
    pitch = PATCH_WIDTH + GAP_WIDTH
    for count, corner, size, _, places in sorted(found, key=lambda window: (-window[0], window[3])):
        if count < max(_LEAST_POINTS, fullest - 2):
            return
        local = places - corner
        inside = ((local >= 0) & (local < size)).all(axis=1)
        # In chart units; a window of 4 × 6 is a chart lying on its side.
        chart = local[inside][:, :: 1 if size[0] == COLUMNS else -1] * pitch + GAP_WIDTH + PATCH_WIDTH / 2
        if np.ptp(local[inside], axis=0).min() < 1:
            continue
        homography, _ = cv2.findHomography(chart.astype(np.float64), points[inside], cv2.RANSAC, _reach(points[inside]))
        if homography is not None:
            yield project(np.asarray(homography, dtype=np.float64), box_corners())


def _counted(places: npt.NDArray[np.int64]) -> list[tuple[int, npt.NDArray[np.int64], tuple[int, int]]]:
    """Return count, corner and size of every window over `places` [N, 2] that may hold enough of them."""
    low, high = places.min(axis=0), places.max(axis=0)
    # A border of zeros as wide as a window: windows may reach beyond the places.
    grid = np.zeros(high - low + 1 + 2 * COLUMNS, dtype=np.int64)
    grid[tuple((places - low + COLUMNS).T)] = 1
    total = np.pad(grid.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    found = []
    for wide, tall in ((COLUMNS, ROWS), (ROWS, COLUMNS)):
        counts = total[wide:, tall:] - total[:-wide, tall:] - total[wide:, :-tall] + total[:-wide, :-tall]
        enough = np.argwhere(counts >= max(_LEAST_POINTS, counts.max() - 2))
        found += [(int(counts[tuple(at)]), at + low - COLUMNS, (wide, tall)) for at in enough]
    return found


def _reach(points: Points) -> float:
    """A tenth of a step, in pixels: how far a point may be from the grid."""
    nearest = cKDTree(points).query(points, k=2)[0][:, 1]
    return float(max(0.15 * np.median(nearest), 0.5))


def refined(corners: Points, zones: list[Zones]) -> Points:
    """Return the box [4, 2] whose patches' middles are the centres of the zones that lie there, at all thresholds.

    A zone's centre is that of its patch also under blur, which takes as much from one edge as from the other. A place with
    no zone of the right size, or whose zones disagree with the others' homography, does not count.
    """
    if not zones:
        return corners
    centres, areas = np.concatenate([z.centres for z in zones]), np.concatenate([z.areas for z in zones])
    places = patch_quads(1.0).mean(axis=1)
    box = corners
    for _ in range(3):
        chart_from_image = np.linalg.inv(image_from_chart(box))
        low, high = box.min(axis=0), box.max(axis=0)
        near = ((centres >= low) & (centres <= high)).all(axis=1)
        if near.sum() < _LEAST_POINTS:
            return box
        points = centres[near]
        on_chart = project(np.asarray(chart_from_image, dtype=np.float64), points)
        expected = _patch_areas(box)
        distance, place = cKDTree(places).query(on_chart)
        ratio = areas[near] / expected[place]
        own = (distance < _ASTRAY * (PATCH_WIDTH + GAP_WIDTH)) & (ratio > _SMALLEST_PART) & (ratio < _LARGEST_PART)
        found = np.unique(place[own])
        if len(found) < _LEAST_POINTS:
            return box
        middles = np.array([np.median(points[own & (place == k)], axis=0) for k in found])
        homography, _ = cv2.findHomography(places[found], middles, cv2.RANSAC, _reach(middles) / 2)
        if homography is None:
            return box
        moved = project(np.asarray(homography, dtype=np.float64), box_corners())
        if not np.isfinite(moved).all() or np.abs(moved - corners).max() > 0.15 * np.ptp(corners, axis=0).max():
            return box
        box = moved
    return box


def _patch_areas(corners: Points) -> npt.NDArray[np.float64]:
    """Pixels of each patch [24] of a box."""
    quads = project(image_from_chart(corners), patch_quads(1.0))
    diagonals = quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]
    return np.asarray(0.5 * np.abs(diagonals[0][:, 0] * diagonals[1][:, 1] - diagonals[0][:, 1] * diagonals[1][:, 0]))
