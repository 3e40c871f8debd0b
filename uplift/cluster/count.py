"""How many lamps there are: as many as differ clearly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uplift.cct import cct_duv, mired, uv_of_xy, xy_of_rgb
from uplift.cluster.evidence import Evidence, View, daylight, greatest_nearby
from uplift.cluster.kmeans import angles, directions, histogram, kmeans_up_to, squared
from uplift.cluster.lamps import lamps_of

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

MIN_SHARE = 0.01  # of the evidence's light, for a cluster to be one
MIN_SHARE_SURFACES = 0.20
MIN_SHARE_UNDER_SKY = 0.10  # of all light, for lamps under an open sky, where glitter on water is as bright as a lamp
SKY_MARGIN = 4.0 / 360.0  # of the width: how far beyond the sky's border the sun's glare is still the sky's
ALIKE_MIRED = 25.0  # closer than this (and than ALIKE_DUV across the locus) two clusters are one lamp's light
ALIKE_MIRED_SURFACES = 60.0
ALIKE_DUV = 0.010
ALIKE_UV = 0.012  # where a CCT does not exist; 25 mired are 0.009 to 0.012 along the locus
# Lamps in view look nearer to one another than they are, as each throws back some of the others' light, and not all of that
# can be taken off again. Over 192 relit rooms of two and three lamps, lamps 25 mired apart and more came out 23 apart at least
# (21 as seen; in one other room 19), and one lamp cut in two 6 at most. WORTH_A_LOOK: nearer than that, taking off what they
# throw back is not tried.
SEEN_NEARER, WORTH_A_LOOK = 0.8, 0.4
SEPARATION = 4.0  # Ashman's D (1994) with robust spreads; an even spread cut in two has 2.7, two lamps far more


def alike(*, direct: bool) -> tuple[float, float]:
    """Return the mired and the Duv nearer than which, both, lights found by lamps in view (or by surfaces) are one."""
    return (SEEN_NEARER * ALIKE_MIRED, SEEN_NEARER * ALIKE_DUV) if direct else (ALIKE_MIRED_SURFACES, ALIKE_DUV)


def lamp_colours(found: Evidence, label: npt.NDArray[np.int64], count: int) -> Floats:
    """Light-weighted mean colour [k, 3] of each cluster's evidence (its brightness means nothing)."""
    scaled = found.rgb / found.rgb.sum(axis=1, keepdims=True) * found.weight[:, np.newaxis]
    return np.stack([np.bincount(label, scaled[:, i], count) for i in range(3)], axis=1)


def _any_alike(colours: Floats, xyz_from_rgb: Floats, *, least_mired: float, nearer: float = 1.0) -> bool:
    """Whether two of the colours [k, 3], seen `nearer` to one another than they are, may be the light of one kind of lamp."""
    xy = xy_of_rgb(colours, xyz_from_rgb)
    cct, duv = cct_duv(xy)
    uv = uv_of_xy(xy)
    apart = np.abs(mired(cct)[:, np.newaxis] - mired(cct))
    across = np.abs(duv[:, np.newaxis] - duv)
    on_plane = np.sqrt(((uv[:, np.newaxis] - uv) ** 2).sum(axis=-1))
    nearly = (apart < nearer * least_mired) & (across < nearer * ALIKE_DUV)
    alike = np.where(np.isfinite(apart), nearly, on_plane < nearer * ALIKE_UV)
    return bool((alike & ~np.eye(len(colours), dtype=np.bool_)).any())


def _separation(points: Floats, weight: Floats, label: npt.NDArray[np.int64], centres: Floats) -> float:
    """The least Ashman's D over pairs of clusters: distance of two middles over their spreads along that line."""
    least = np.inf
    for i in range(len(centres)):
        for j in range(i):
            axis = centres[i] - centres[j]
            length = float(np.sqrt(axis @ axis))
            if length == 0:
                return 0.0
            spreads, middles = [], []
            for one in (i, j):
                mine = label == one
                along = points[mine] @ (axis / length)
                middle = weighted_median(along, weight[mine])
                middles.append(middle)
                spreads.append(1.4826 * weighted_median(np.abs(along - middle), weight[mine]))
            both = max(float(np.hypot(spreads[0], spreads[1])), 1e-9)
            least = min(least, float(np.sqrt(2.0)) * abs(middles[0] - middles[1]) / both)
    return least


def weighted_median(values: Floats, weight: Floats) -> float:
    if not len(values):
        return 0.0
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """The lights of a map by the default method."""

    centres: Floats  # [k, 3] directions in RGB
    outdoor: int  # which of them is the sky's light (the last); −1: none
    evidence: Evidence  # what speaks for the others


def choose(found: Evidence, view: View, k_max: int, *, matrices: tuple[Floats, Floats]) -> Chosen:
    """Return as many lamps as differ clearly, the sky's light counting as one.

    `matrices` are the luminance weights [3] and XYZ from RGB [3, 3].
    """
    luminance_weights, xyz_from_rgb = matrices
    outdoors: list[Floats] = []
    keep = np.ones(len(found.place), np.bool_)
    if view.sky is not None:
        # Sun and sky are one outdoor light, and surfaces under an open sky speak for no other lamp.
        outdoors = [daylight(view)[np.newaxis]]
        margin = round(SKY_MARGIN * view.sky.shape[1])
        above = greatest_nearby(view.sky.astype(np.float64), margin).ravel()[found.place] > 0
        keep = ~above if found.direct else np.zeros_like(above)
        if found.weight[keep].sum() < MIN_SHARE_UNDER_SKY * view.light.sum():
            keep[:] = False
    room = k_max - len(outdoors)
    kept = found.kept(keep)
    if not keep.any() or room < 1:
        return Chosen(directions(np.vstack(outdoors)), 0, kept)
    least_mired, least_share = (ALIKE_MIRED, MIN_SHARE) if found.direct else (ALIKE_MIRED_SURFACES, MIN_SHARE_SURFACES)
    points, weight = histogram(directions(kept.rgb), kept.rgb, kept.weight)
    best = None
    for centres in kmeans_up_to(points, weight, room):
        together = np.vstack([centres, *outdoors])
        if _any_alike(together, xyz_from_rgb, least_mired=least_mired, nearer=WORTH_A_LOOK if found.direct else 1.0):
            continue
        label = np.argmin(squared(points, centres), axis=1)
        share = np.bincount(label, weight, len(centres))
        clear = share.min() >= least_share and _separation(points, weight, label, centres) >= SEPARATION
        if len(centres) > 1 and not clear:
            continue
        if found.direct and _any_alike(together, xyz_from_rgb, least_mired=least_mired, nearer=SEEN_NEARER):
            outdoor = len(centres) if outdoors else -1
            together = lamps_of(view, kept, directions(together), outdoor, luminance_weights).colours
            if _any_alike(together, xyz_from_rgb, least_mired=least_mired, nearer=SEEN_NEARER):
                continue
        best = centres
    if best is None:  # every number of lamps would have had one that is the sky's light again
        return Chosen(directions(np.vstack(outdoors)), 0, kept.kept(np.zeros(len(kept.place), np.bool_)))
    centres = directions(np.vstack([best, *outdoors]))
    return Chosen(centres, len(centres) - 1 if outdoors else -1, kept)


def grow_like_the_paper(found: Evidence, in_sky: Bools | None, xyz_from_rgb: Floats, k_max: int) -> Floats:
    """Centres [k, 2] of the paper's method: k grows until two clusters are alike or two are outdoors."""
    features = angles(found.rgb)
    points, weight = histogram(features, found.rgb, found.weight)
    steps = kmeans_up_to(points, weight, k_max)
    accepted = steps[0]
    for centres in steps[1:]:
        label = np.argmin(squared(features, centres), axis=1)
        colours = lamp_colours(found, label, len(centres))
        outdoor = 0
        if in_sky is not None:
            above = in_sky.ravel()[found.place]
            outdoor = int((np.bincount(label[above], minlength=len(centres)) > 0).sum())
        if outdoor > 1 or _any_alike(colours, xyz_from_rgb, least_mired=ALIKE_MIRED):
            break
        accepted = centres
    return accepted
