"""Clusters of a lat-long map: which lamps there are, and which of them lights each pixel.

The distance is the one of Tódová and Wilkie (Constrained Spectral Uplifting for HDR Environment Maps, EGSR 2024): the
angle between colours, brightness ignored; k-means; at most six clusters, at most one of them outdoors, no two of
similar temperature. `evidence="bright"` is their method: every pixel that is no darker than the average, k growing
from 1 until a clustering has to be rejected.

That method takes a coloured wall for a lamp. The default, `evidence="lamps"`, first looks for the lamps themselves.
No matt surface is brighter than the irradiance that falls on it over π, so what is far brighter than the greatest
irradiance at the camera over π, and not merely the glow around something brighter still, is a lamp (or a window, or
the sun) seen directly, and its colour is its own. Clusters are formed of those pixels, weighted by luminance times
solid angle (`count`), and less what a lamp throws back of the others' light (`lamps`). Where no lamp is in view, the
locally brightest surfaces take their place, under a stricter test, as they are the ones most likely to be white (Land's
retinex argument). A pixel has the two lights that give most of it, by its colour, its surroundings and its place
(`membership`).

The statistics are made on a map of at most 1024 columns and a histogram of it; only the labels touch every pixel.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from uplift import UpliftError
from uplift.cluster.count import choose, grow_like_the_paper
from uplift.cluster.evidence import bright, lamps_or_surfaces, view_of
from uplift.cluster.record import Clusters, lone, mixed, nothing
from uplift.sky import Sky

__all__ = ["Clusters", "cluster_angles"]

Image = npt.NDArray[np.float32]


def cluster_angles(
    image: Image,
    *,
    luminance_weights: npt.ArrayLike,
    xyz_from_rgb: npt.ArrayLike,
    sky: Sky | None = None,
    k_max: int = 6,
    evidence: Literal["lamps", "bright"] = "lamps",
) -> Clusters:
    """Return the clusters of a lat-long map, found by the angle between colours.

    Scaling the map changes nothing; running it twice gives the same bits. One cluster is always returned, also for a
    black map. Negative values count as 0, NaN and infinite pixels as unknown (label 0).

    Parameters
    ----------
    image
        Shape [H, W, 3], float32, linear RGB, lat-long.
    luminance_weights
        Shape [3]: Y of RGB.
    xyz_from_rgb
        Shape [3, 3]: for the temperatures that tell lamps apart.
    sky
        What `find_sky` returned; None: indoors.
    k_max
        Most clusters, 1–16.
    evidence
        "lamps": the default described in this module's docstring; "bright": the paper's, for reproduction.

    Raises
    ------
    UpliftError
        If the shapes do not fit or `k_max` is out of range.
    """
    image = np.asarray(image, dtype=np.float32)
    if image.ndim != 3 or image.shape[2] != 3 or min(image.shape[:2]) < 1:
        raise UpliftError(f"cluster_angles: image of shape {image.shape}; expected [H, W, 3]")
    if not 1 <= k_max <= 16:
        raise UpliftError(f"cluster_angles: k_max {k_max}; expected 1 to 16 (the paper has 6)")
    if evidence not in ("lamps", "bright"):
        raise UpliftError(f'cluster_angles: evidence {evidence!r}; expected "lamps" or "bright"')
    if sky is not None and sky.mask.shape != image.shape[:2]:
        raise UpliftError(
            f"cluster_angles: sky mask of shape {sky.mask.shape} for a map of {image.shape[:2]}; find the sky on this map"
        )
    matrix = np.asarray(xyz_from_rgb, np.float64)
    view = view_of(image, np.asarray(luminance_weights, np.float64), sky)
    if not (view.luminance > 0).any():
        return nothing(image, "the map holds no light: no pixel has a luminance above zero")
    if evidence == "bright":
        found = bright(view)
        return lone(image, view, found, grow_like_the_paper(found, view.sky, matrix, k_max), matrix)
    matrices = (np.asarray(luminance_weights, np.float64), matrix)
    chosen = choose(lamps_or_surfaces(view), view, k_max, matrices=matrices)
    return mixed(image, view, chosen, sky, matrices=matrices)
