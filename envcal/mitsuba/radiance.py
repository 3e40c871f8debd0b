"""Radiance of the map at a place and some wavelengths: four texels, each with its own light, weighted bilinearly.

`V` is the module of types of one Mitsuba variant. Emissions are looked up by slot, the place of a cluster among those that
the map uses. In the JIT variants they lie node by node, E there and at the next node side by side, each node's slots in
a row; in the scalar ones as they are in the file.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from envcal.mitsuba import loading
from envcal.mitsuba.loading import CENTRE_NM, HALF_NM, Float64

#: Emissions that one packet of 16 floats brings, in pairs. Maps have fewer; more are looked up one by one.
PACKET = 8


class Corners(NamedTuple):
    """The four texels around a place: their numbers in the map laid flat, from the upper left, and bilinear weights."""

    texels: tuple[Any, ...]
    weights: tuple[Any, ...]


class Nodes(NamedTuple):
    """Where wavelengths stand in the grid: node below, fraction of the way to the next, and 1 within the grid, else 0."""

    below: Any
    fraction: Any
    inside: Any


def corners(V: Any, size: tuple[int, int], u: Any, v: Any) -> Corners:
    """Return the texels around a place of a map of `size` (height, width): columns are a ring, rows end at the poles."""
    height, width = size
    x = u * width - 0.5
    y = dr.clip(v * height - 0.5, 0.0, height - 1.0)
    x0, y0 = dr.floor(x), dr.minimum(dr.floor(y), height - 2.0)
    fx, fy = x - x0, y - y0
    column, row = V.Int32(x0), V.Int32(y0)
    left = dr.select(column < 0, width - 1, dr.minimum(column, width - 1))
    right = dr.select(column + 1 >= width, 0, column + 1)
    places = ((left, row), (right, row), (left, row + 1), (right, row + 1))
    weights = ((1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy)
    return Corners(tuple(V.UInt32(j * width + i) for i, j in places), weights)


def nodes_of(V: Any, grid: Float64, wavelengths: Any) -> Nodes:
    """Return where `wavelengths` stand in an even grid."""
    last, first = len(grid) - 1, float(grid[0])
    step = (float(grid[-1]) - first) / last
    at = (wavelengths - first) * (1 / step)
    inside = dr.select((at >= 0) & (at <= last), V.UnpolarizedSpectrum(1.0), V.UnpolarizedSpectrum(0.0))
    below = dr.clip(dr.floor(at), 0.0, last - 1.0)
    # From the node, not as at − node, which beside a spectral line is too coarse.
    return Nodes(below, (wavelengths - dr.fma(below, step, first)) * (1 / step), inside)


def table_of(V: Any, emission: Any, used: Any) -> Any:
    """Return the emissions [clusters, wavelengths] as they are looked up, in a unit whose Y = 1 Mitsuba's film develops to 1."""
    white = 1.0 / mi.MI_CIE_Y_NORMALIZATION
    if not dr.is_jit_v(V.Float):
        return emission.array * white
    index = loading.packed(used, emission.shape[1], max(PACKET, len(used)))
    table = dr.gather(V.Float, emission.array, V.UInt32(index)) * white
    dr.eval(table)
    return table


def packet_of_emissions(V: Any, table: Any, slots: int, at: Nodes, active: Any) -> list[Any]:
    """Return E of every slot, PACKET at most: with one packet a wavelength they cost less than the texels' own, one by one."""
    values: list[list[Any]] = [[] for _ in range(slots)]
    for k in range(len(at.below)):
        packet = dr.gather(V.Matrix4f, table, V.UInt32(at.below[k]), active)
        for slot, found in enumerate(values):
            here, there = packet[slot // 2, 2 * (slot % 2)], packet[slot // 2, 2 * (slot % 2) + 1]
            found.append(dr.fma(there - here, at.fraction[k], here))
    return [V.UnpolarizedSpectrum(found) * at.inside for found in values]


def emission_of_slot(V: Any, table: Any, used: Any, grid: Float64, slot: Any, at: Nodes, active: Any) -> Any:
    """Return E of one slot."""
    found = []
    for k in range(len(at.below)):
        if dr.is_jit_v(V.Float):
            pair = dr.gather(V.Vector2f, table, V.UInt32(at.below[k]) * len(used) + slot, active)
            here, there = pair.x, pair.y
        else:
            place = int(used[slot]) * len(grid) + int(at.below[k])
            here, there = (table[place + side] for side in (0, 1))
        found.append(dr.fma(there - here, at.fraction[k], here))
    return V.UnpolarizedSpectrum(found) * at.inside


def emissions_around(
    V: Any, table: Any, used: Any, grid: Float64, packed: Any, wavelengths: Any, active: Any
) -> Callable[[int], Any]:
    """Return what gives E at `wavelengths` of the corners 0 … 3; `packed` holds their slots, a byte each, the first lowest."""
    at, many = nodes_of(V, grid, wavelengths), len(used)
    lights = packet_of_emissions(V, table, many, at, active) if dr.is_jit_v(V.Float) and many <= PACKET else []

    def of_corner(corner: int) -> Any:
        slot = (packed >> (8 * corner)) & 255
        if not lights:
            return emission_of_slot(V, table, used, grid, slot, at, active)
        found = lights[0]
        for k in range(1, many):
            found = dr.select(slot == k, lights[k], found)
        return found

    return of_corner


def reflectance(V: Any, coefficients: Any, wavelengths: Any) -> Any:
    """Return S at `wavelengths` of coefficients (x, y, z) of t², t and 1."""
    Value, t = V.UnpolarizedSpectrum, (wavelengths - CENTRE_NM) * (1 / HALF_NM)
    x = dr.fma(dr.fma(Value(coefficients.x), t, Value(coefficients.y)), t, Value(coefficients.z))
    # S(−|x|) without the cancellation of ½ − ½|x|/√(1 + x²), which is all that is left of a deep colour.
    cosine = dr.rsqrt(dr.fma(x, x, 1.0))
    low = 0.5 * cosine * cosine * dr.rcp(dr.fma(dr.abs(x), cosine, 1.0))
    return dr.select(x < 0, low, 1.0 - low)


def gathered(V: Any, kind: Any, array: Any, index: Any, width: int, active: Any) -> Any:
    """Return element `index` of records of `width` numbers, as a `kind`."""
    if dr.is_jit_v(V.Float):
        return dr.gather(kind, array, index, active)
    at = index * width
    return array[at] if width == 1 else kind([array[at + k] for k in range(width)])
