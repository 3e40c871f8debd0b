"""The colour of a lamp from what is seen of it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from uplift.cluster.evidence import Evidence, View
from uplift.cluster.kmeans import directions, squared
from uplift.cluster.membership import Members, members, membership

Floats = npt.NDArray[np.float64]

# A luminous panel, a shade, a bright window also throws back the other lamps' light: what it throws back is taken to be as
# bright as what stands around it is by their light (measured in three rooms: 1.2 to 3 times as bright; glass: a tenth).
# It counts only for lamps that are no more than some ten times as bright as their surroundings.
REFLECTED = 1.0
AROUND = 20.0 / 360.0  # of the width: what stands around a lamp
LEAST_LEFT = 0.5  # of each component: more is never taken away


@dataclass(frozen=True, slots=True, eq=False)
class Lamps:
    """The lights, and what speaks for each."""

    owner: npt.NDArray[np.int64]  # [P] the light of each piece of evidence
    evidence: Floats  # [P, 3] its colour, less what lamps in view throw back of the others' light
    colours: Floats  # [k, 3]


def lamps_of(view: View, found: Evidence, centres: Floats, outdoor: int, luminance_weights: Floats) -> Lamps:
    """Return the lights around `centres` [k, 3] (directions in RGB), of which `outdoor` (the last; −1: none) is the sky's."""
    count = len(centres)
    lamps_only = centres[: count - (outdoor >= 0)]
    owner = np.zeros(0, np.int64)
    if len(found.place):
        owner = np.argmin(squared(directions(found.rgb), lamps_only), axis=1)

    def colours_of(evidence: Floats) -> Floats:
        out = centres.copy()
        for one in np.unique(owner):
            out[one] = lamp_colour(evidence[owner == one], found.weight[owner == one])
        return out

    evidence, colours = found.rgb, colours_of(found.rgb)
    if found.direct and count > 1:
        tables = membership(view, colours, found, owner, luminance_weights=luminance_weights, lamp_above=found.above)
        before = members(view.rgb.astype(np.float32), tables, view.sky, outdoor)
        evidence = without_reflections(view, found, owner, colours, before, luminance_weights)
        colours = colours_of(evidence)
    return Lamps(owner, evidence, colours)


def lamp_colour(rgb: Floats, weight: Floats) -> Floats:
    """Return the mean colour [3] of evidence [P, 3], its brightness ignored, by `weight` [P]."""
    out: Floats = np.average(rgb, axis=0, weights=weight / rgb.sum(axis=1))
    return out


def without_reflections(
    view: View, found: Evidence, owner: npt.NDArray[np.int64], colours: Floats, own: Members, luminance_weights: Floats
) -> Floats:
    """Return the colours [P, 3] of the evidence less what each lamp throws back of the other lamps' light.

    `owner` [P] is the lamp of each piece; `own` the lights of the pixels of the working map.
    """
    each = colours / (colours @ luminance_weights)[:, np.newaxis]
    free = np.ones(view.luminance.shape, np.float32)
    free.ravel()[found.place] = 0.0
    size = max(1, round(AROUND * view.luminance.shape[1]))
    bare = _around(free, size)
    out = found.rgb.copy()
    for other in range(len(colours)):
        part = np.where(own.first == other, own.weight, 0.0) + np.where(own.second == other, 1.0 - own.weight, 0.0)
        light = (view.luminance * part).astype(np.float32) * free
        everywhere = float((light * view.solid_angle).sum() / max((free * view.solid_angle).sum(), 1e-12))
        near = np.where(bare > 0.01, _around(light, size) / np.maximum(bare, 1e-6), everywhere)
        out -= np.where(owner == other, 0.0, REFLECTED * near.ravel()[found.place])[:, np.newaxis] * each[other]
    return np.maximum(out, LEAST_LEFT * found.rgb)


def _around(plane: npt.NDArray[np.float32], size: int) -> npt.NDArray[np.float32]:
    """Mean over a square of 2·size + 1 pixels, wrapping in x."""
    size = min(size, plane.shape[1] // 2)
    padded = np.pad(plane, ((0, 0), (size, size)), mode="wrap")
    blurred = cv2.blur(padded, (2 * size + 1, 2 * size + 1), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blurred[:, size : blurred.shape[1] - size], np.float32)
