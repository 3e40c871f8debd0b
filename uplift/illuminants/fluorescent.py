"""Fluorescent light: the CIE's FL illuminants.

FL1–FL6 are the standard halophosphate lamps; they are the nodes, 2939–6426 K, as in Tódová and Wilkie (EGSR 2024).
The broad-band (FL7–FL9), three-band (FL10–FL12) and the FL3.x lamps are had by name: their spectra are so different
that a CCT cannot choose among them.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

from uplift.illuminants.nodes import Node, check_range, interpolated, nodes_of
from uplift.spectrum import Observer, illuminant

NODES = ("FL1", "FL2", "FL3", "FL4", "FL5", "FL6")
NAMES = (*(f"FL{i}" for i in range(1, 13)), *(f"FL3.{i}" for i in range(1, 16)))
RANGE_K = (2940.0, 6425.0)  # of the nodes, FL4 to FL1, in whole kelvin


def fluorescent(cct: float, observer: Observer) -> npt.NDArray[np.float64]:
    """Return the emission [N], Y = 1, of a halophosphate lamp of `cct` kelvin, 2940–6425 (see `NAMES` for others).

    Raises UpliftError outside that range.
    """
    check_range("fluorescent", cct, *RANGE_K, "Give one of the lamps by name (FL7 … FL3.15) or a measured spectrum.")
    return interpolated(fluorescent_nodes(observer), cct, observer)


@cache
def fluorescent_nodes(observer: Observer) -> tuple[Node, ...]:
    """Return FL1–FL6 in order of CCT."""
    return nodes_of([(name, illuminant(name, observer)) for name in NODES], observer)
