"""The colour of a lamp from what is seen of it."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from uplift.cluster.evidence import Evidence, View
from uplift.cluster.membership import Members

Floats = npt.NDArray[np.float64]

# A luminous panel, a shade, a bright window also throws back the other lamps' light: what it throws back is taken to be as
# bright as what stands around it is by their light (measured in three rooms: 1.2 to 3 times as bright; glass: a tenth).
# It counts only for lamps that are no more than some ten times as bright as their surroundings.
REFLECTED = 1.0
AROUND = 20.0 / 360.0  # of the width: what stands around a lamp
LEAST_LEFT = 0.5  # of each component: more is never taken away


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
