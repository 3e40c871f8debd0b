"""Mixtures of two lights, for the pixels that both of them light.

An uplifted pixel has one emission. Where two lamps of known spectra share a surface, that of the stronger one bends its
spectrum; a mixture in steps of a quarter, as `cluster.membership` tells the shares, does so less. Emissions have Y = 1, so a
mixture by shares of luminance has it too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from uplift import UpliftError

Floats = npt.NDArray[np.float64]
Labels = npt.NDArray[np.uint32]

STEPS = 4
MOST_PAIRS = 6  # those with most light: each costs three tables, and a renderer three emissions more


@dataclass(frozen=True, slots=True, eq=False)
class Mixtures:
    """The emissions that are added behind those of the lights, and which pixels have them."""

    parts: tuple[tuple[int, int, float], ...]  # of each: two lights, and the first one's part
    emissions: Floats  # [M, N], Y = 1
    start: npt.NDArray[np.int64]  # [k, k] label of the first mixture of a pair, lower light first; −1: there is none

    def labels(self, first: Labels, second: Labels, weight: npt.NDArray[np.float32]) -> Labels:
        """Return the emission of each pixel [...], from its two lights and the first one's share, 0.5 … 1."""
        quarters = np.rint(STEPS * weight.astype(np.float64)).astype(np.int64)
        low, high = np.minimum(first, second), np.maximum(first, second)
        start = self.start[low, high]
        of_low = np.where(first == low, quarters, STEPS - quarters)
        mixed = (start >= 0) & (first != second) & (quarters < STEPS)
        return np.where(mixed, start + (STEPS - 1 - of_low), first).astype(np.uint32)


def mixtures_of(
    emissions: Sequence[npt.ArrayLike], shares: Sequence[float], known: Sequence[bool], *, room: int
) -> Mixtures:
    """Return mixtures of the pairs of lights whose spectra are `known`, at most `room` of them in all.

    Lights of unknown kind are not mixed: of two smooth spectra it was measured to change nothing.

    Parameters
    ----------
    emissions
        Shape [k][N], each of Y = 1.
    shares
        Shape [k]. The pairs with most light, by the lesser share of the two, come first.
    known
        Shape [k]: whether a light's spectrum is declared, measured or that of a kind of lamp.

    Raises
    ------
    UpliftError
        If the three are not of one length.
    """
    count = len(emissions)
    if not count == len(shares) == len(known):
        raise UpliftError(
            f"mixtures: {count} emissions, {len(shares)} shares and {len(known)} known; expected one of each a light"
        )
    lights = np.asarray(emissions, np.float64)
    pairs = [(i, j) for i, j in combinations(range(count), 2) if known[i] and known[j]]
    pairs.sort(key=lambda pair: -min(shares[pair[0]], shares[pair[1]]))
    pairs = pairs[: min(MOST_PAIRS, max(room, 0) // (STEPS - 1))]
    start = np.full((count, count), -1, np.int64)
    parts: list[tuple[int, int, float]] = []
    for i, j in pairs:
        start[i, j] = count + len(parts)
        parts += [(i, j, quarter / STEPS) for quarter in range(STEPS - 1, 0, -1)]
    mixed = [part * lights[i] + (1.0 - part) * lights[j] for i, j, part in parts]
    return Mixtures(tuple(parts), np.array(mixed).reshape(len(parts), *lights.shape[1:]), start)
