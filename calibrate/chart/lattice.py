"""Grids of places among points in the plane, as a homography may show them.

Around each point two of its neighbours span a lattice; spans that predict further points are grown from place to place, each
step guided by the steps beside it, so that perspective is followed, and the bent lines of a lat-long map as well.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.spatial import cKDTree

from calibrate.chart.geometry import CLASSIC, PITCH, Layout, box_corners, image_from_chart, patch_quads, project
from calibrate.chart.homographies import agreed_homographies
from calibrate.chart.zones import Zones

Points = npt.NDArray[np.float64]
Places = npt.NDArray[np.int64]

_NEIGHBOURS: Final = 9
# How far a point may be from where it is predicted, in parts of the step.
_NEAR: Final = 0.25
# Zones of one chart differ in area by perspective, and by how much of the edges each threshold takes away.
_LARGEST_RATIO: Final = 3.0
# The prediction of four places around and four diagonal ones; so many must hold a point.
_LEAST_SUPPORT: Final = 4
LEAST_POINTS: Final = 9
_MOST_LATTICES: Final = 12
# When the box is known: how far a zone's centre may be from its patch's (in steps), and how much of a patch it may be.
_ASTRAY: Final = 0.2
_SMALLEST_PART: Final = 0.15
_LARGEST_PART: Final = 1.25


def grids(zones: Zones, layout: Layout = CLASSIC) -> Iterator[tuple[Places, npt.NDArray[np.intp]]]:
    """Yield lattices among the zones' centres: places [N, 2] and the indices [N] of the zones there, best supported first.

    Where the chart begins on a lattice, and which of its axes are rows, is not known: `windows` tells.
    """
    if len(zones.centres) < LEAST_POINTS:
        return
    tree = cKDTree(zones.centres)
    used = np.zeros(len(zones.centres), dtype=np.bool_)
    grown = 0
    for seed, first, second in _spans(zones, tree):
        if used[seed]:
            continue
        places, indices = _grown(zones.centres, zones.areas, seed, first, second, layout.columns + 1)
        if len(indices) < LEAST_POINTS:
            continue
        grown += 1
        used[indices] = True
        yield places, indices
        if grown == _MOST_LATTICES:
            return


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
    order = np.argsort(-support, kind="stable")
    weak = np.flatnonzero(hit.sum(axis=1)[order] < _LEAST_SUPPORT)
    for best in order[: weak[0] if weak.size else None]:
        yield int(seed[best]), u[best], v[best]


@njit(cache=True, error_model="numpy")
def _grown(
    centres: Points, areas: npt.NDArray[np.float64], seed: int, first: Points, second: Points, farthest: int
) -> tuple[Places, npt.NDArray[np.intp]]:  # pragma: no cover - compiled
    """Return places and the points there, starting from a seed and its two steps, from neighbour to neighbour.

    `farthest` is how many places to each side of the seed there may be: as many as the chart is long, and one more.
    """
    side = 2 * farthest + 1
    taken = np.zeros(len(centres), dtype=np.bool_)
    at = np.full((side, side), -1, dtype=np.intp)
    places, indices = np.zeros((side * side, 2), dtype=np.int64), np.zeros(side * side, dtype=np.intp)
    steps = np.zeros((side * side, 4))
    indices[0], taken[seed], at[farthest, farthest] = seed, True, seed
    steps[0, :2], steps[0, 2:] = first, second
    count, done = 1, 0
    while done < count:
        own = indices[done]
        for direction in range(4):
            dx, dy = (1, 0, -1, 0)[direction], (0, 1, 0, -1)[direction]
            px, py = places[done, 0] + dx, places[done, 1] + dy
            if max(abs(px), abs(py)) > farthest or at[px + farthest, py + farthest] >= 0:
                continue
            step_x = dx * steps[done, 0] + dy * steps[done, 2]
            step_y = dx * steps[done, 1] + dy * steps[done, 3]
            reach, nearest = np.inf, -1
            for other in range(len(centres)):
                off_x, off_y = (
                    centres[other, 0] - centres[own, 0] - step_x,
                    centres[other, 1] - centres[own, 1] - step_y,
                )
                if off_x * off_x + off_y * off_y < reach:
                    reach, nearest = off_x * off_x + off_y * off_y, other
            if taken[nearest] or reach > _NEAR * _NEAR * (step_x * step_x + step_y * step_y):
                continue
            ratio = areas[nearest] / areas[own]
            if not 1 / _LARGEST_RATIO < ratio < _LARGEST_RATIO:
                continue
            at[px + farthest, py + farthest], taken[nearest] = nearest, True
            places[count, 0], places[count, 1], indices[count] = px, py, nearest
            # Steps change slowly: half of the new one, half of what was believed.
            steps[count] = steps[done]
            along = 0 if dx != 0 else 2
            for axis in range(2):
                walked = (centres[nearest, axis] - centres[own, axis]) * (dx + dy)
                steps[count, along + axis] = 0.5 * (steps[done, along + axis] + walked)
            count += 1
        done += 1
    return places[:count].copy(), indices[:count].copy()


def refined(corners: Points, zones: list[Zones], layout: Layout = CLASSIC) -> Points:
    """Return the box [4, 2] whose patches' middles are the centres of the zones that lie there, at all thresholds.

    A zone's centre is that of its patch also under blur, which takes as much from one edge as from the other. A place with
    no zone of the right size, or whose zones disagree with the others' homography, does not count.
    """
    if not zones:
        return corners
    centres, areas = np.concatenate([z.centres for z in zones]), np.concatenate([z.areas for z in zones])
    places = patch_quads(1.0, layout).mean(axis=1)
    box = corners
    for _ in range(3):
        chart_from_image = np.linalg.inv(image_from_chart(box, layout))
        low, high = box.min(axis=0), box.max(axis=0)
        near = ((centres >= low) & (centres <= high)).all(axis=1)
        if near.sum() < LEAST_POINTS:
            return box
        points = centres[near]
        on_chart = project(np.asarray(chart_from_image, dtype=np.float64), points)
        expected = _patch_areas(box, layout)
        distance, place = cKDTree(places).query(on_chart)
        ratio = areas[near] / expected[place]
        own = (distance < _ASTRAY * PITCH) & (ratio > _SMALLEST_PART) & (ratio < _LARGEST_PART)
        found = np.unique(place[own])
        if len(found) < LEAST_POINTS:
            return box
        middles = np.array([np.median(points[own & (place == k)], axis=0) for k in found])
        everywhere = np.ones((1, len(found)), dtype=np.bool_)
        homography = agreed_homographies(places[found], middles, everywhere, step=PITCH)[0]
        moved = project(homography, box_corners(layout))
        if not np.isfinite(moved).all() or np.abs(moved - corners).max() > 0.15 * np.ptp(corners, axis=0).max():
            return box
        box = moved
    return box


def _patch_areas(corners: Points, layout: Layout) -> npt.NDArray[np.float64]:
    """Pixels of each patch [N] of a box."""
    quads = project(image_from_chart(corners, layout), patch_quads(1.0, layout))
    diagonals = quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]
    return np.asarray(0.5 * np.abs(diagonals[0][:, 0] * diagonals[1][:, 1] - diagonals[0][:, 1] * diagonals[1][:, 0]))
