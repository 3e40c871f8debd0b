"""Spectra between published ones: neighbours in CCT, mixed so that the asked CCT is met exactly.

This is how Tódová and Wilkie (EGSR 2024) get a spectrum from a type and a CCT, but for the weight: they take it linear
in CCT, which misses the asked CCT by up to some hundred kelvin; here it is solved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uplift import UpliftError
from uplift.cct import cct_duv
from uplift.spectrum import Observer, normalised, xyz_of

Floats = npt.NDArray[np.float64]

ON_NODE_K = 0.05  # an asked CCT this close to a published spectrum's is that spectrum, to the last bit


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """A spectrum that others are interpolated from."""

    name: str
    cct: float
    emission: Floats  # [N], Y = 1


def cct_duv_of(emission: npt.ArrayLike, observer: Observer) -> tuple[float, float]:
    """Return CCT (K) and Duv of an emission [N] as `observer` sees it; NaN where they do not exist."""
    xyz = xyz_of(emission, observer)
    cct, duv = cct_duv(xyz[:2] / xyz.sum())
    return float(cct), float(duv)


def nodes_of(spectra: Sequence[tuple[str, Floats]], observer: Observer) -> tuple[Node, ...]:
    """Return named spectra [N], each of Y = 1, as nodes, ascending in CCT."""
    found = [Node(name, cct_duv_of(emission, observer)[0], emission) for name, emission in spectra]
    return tuple(sorted(found, key=lambda node: node.cct))


def interpolated(nodes: Sequence[Node], cct: float, observer: Observer) -> Floats:
    """Return the emission [N], Y = 1, of exactly `cct`: a node, or a mix of the two nodes around it."""
    for node in nodes:
        if abs(node.cct - cct) <= ON_NODE_K:
            return node.emission
    above = int(np.searchsorted([node.cct for node in nodes], cct))
    warm, cool = nodes[above - 1].emission, nodes[above].emission

    def mixed(weight: float) -> Floats:
        return (1.0 - weight) * warm + weight * cool

    return normalised(mixed(solved(lambda w: cct_duv_of(mixed(w), observer)[0] - cct, 0.0, 1.0)), observer)


def solved(offset: Callable[[float], float], low: float, high: float) -> float:
    """Return the zero of a monotonic function between `low` and `high` (regula falsi, Illinois rule)."""
    at_low, at_high = offset(low), offset(high)
    middle = low
    for _ in range(60):
        if at_high == at_low:
            break
        middle = (low * at_high - high * at_low) / (at_high - at_low)
        here = offset(middle)
        if abs(here) < 1e-6:
            break
        if (here > 0) == (at_high > 0):
            high, at_high = middle, here
            at_low /= 2.0
        else:
            low, at_low = middle, here
            at_high /= 2.0
    return middle


def check_range(family: str, cct: float, low: float, high: float, remedy: str) -> None:
    """Raise UpliftError if `cct` is not a number from `low` to `high`."""
    if not low <= cct <= high:
        raise UpliftError(f"{family}: {cct:.6g} K is out of range; expected {low:g} to {high:g} K. {remedy}")
