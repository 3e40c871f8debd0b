"""What is known of each cluster."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from uplift.cct import cct_duv, mired, xy_of_rgb
from uplift.cluster.count import ALIKE_DUV, ALIKE_MIRED, Chosen, alike, weighted_median
from uplift.cluster.evidence import Evidence, View, daylight
from uplift.cluster.kmeans import angles, histogram, labelled, squared
from uplift.cluster.lamps import lamp_colour, lamps_of
from uplift.cluster.membership import Members, members, membership
from uplift.sky import Sky

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]

EVENLY = 0.99  # of the greatest: pixels that have as much light about them are one region
NO_MIDDLE = 0.1  # length of the mean direction: what surrounds the camera on all sides has no middle


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """Which light each pixel belongs to, and what is known of each light's colour.

    Clusters are numbered by falling share of the light. All colours are in the map's own linear RGB.
    """

    labels: npt.NDArray[np.uint32]  # [H, W], 0 … count − 1; pixels without a colour (black, NaN) are 0
    second: npt.NDArray[np.uint32]  # [H, W] the light that has most of what is left; = labels where there is none
    weight: (
        Image  # [H, W] share of `labels` in what both lights give to the pixel, 0.5 … 1; 1 − weight is that of `second`
    )
    count: int
    means: Floats  # [k, 3] mean RGB of the cluster's pixels, by solid angle (the paper's colour)
    brightest: Floats  # [k, 3] RGB of its brightest pixel of the working map (the paper's outdoor colour)
    # [k, 3] mean RGB of what is seen of the lamp itself, by luminance · solid angle; of the outdoor cluster: what sky
    # and sun together give to a level surface
    lamps: Floats
    direct: Bools  # [k] whether `lamps` rests on a lamp seen directly (else on the brightest surfaces)
    spread_mired: Floats  # [k] robust standard deviation of that evidence, in mired; NaN where not measurable
    spread_duv: Floats  # [k] the same of its Duv
    outdoor: Bools  # [k] whether the cluster holds the sky
    share: Floats  # [k] of luminance · solid angle of the whole map; sums to 1
    at: Floats  # [k, 2] (u, v) of the cluster's brightest region, 0…1 from the top left of the map
    warnings: tuple[str, ...]
    lamp_above: float = (
        np.inf
    )  # luminance above which a pixel was taken for a lamp seen directly; infinite where none was
    alike: tuple[float, float] = (
        ALIKE_MIRED,
        ALIKE_DUV,
    )  # apart by less than both of these, in mired and Duv, lights are one


def nothing(image: Image, warning: str) -> Clusters:
    zero = np.zeros((1, 3))
    return Clusters(
        labels=np.zeros(image.shape[:2], np.uint32),
        second=np.zeros(image.shape[:2], np.uint32),
        weight=np.ones(image.shape[:2], np.float32),
        count=1,
        means=zero,
        brightest=zero,
        lamps=zero,
        direct=np.array([False]),
        spread_mired=np.array([np.nan]),
        spread_duv=np.array([np.nan]),
        outdoor=np.array([False]),
        share=np.array([1.0]),
        at=np.array([[0.5, 0.5]]),
        warnings=(warning,),
    )


def mixed(image: Image, view: View, chosen: Chosen, sky: Sky | None, *, matrices: tuple[Floats, Floats]) -> Clusters:
    """The record of the default method: a pixel may have two lights.

    `matrices` are the luminance weights [3] and XYZ from RGB [3, 3].
    """
    weights, xyz_from_rgb = matrices
    found, outdoor = chosen.evidence, chosen.outdoor
    count = len(chosen.centres)
    lamps = lamps_of(view, found, chosen.centres, outdoor, weights)
    owner, evidence = lamps.owner, lamps.evidence
    final = membership(view, lamps.colours, found, owner, luminance_weights=weights, lamp_above=found.above)
    small = view.rgb.astype(np.float32)
    own = members(small, final, view.sky, outdoor)
    light = view.light
    lit = light.ravel() > 0
    total = np.bincount(own.first.ravel()[lit], (light * own.weight).ravel()[lit], count)
    total += np.bincount(own.second.ravel()[lit], (light * (1.0 - own.weight)).ravel()[lit], count)
    share = total / total.sum()
    main = np.bincount(own.first.ravel()[lit], minlength=count)
    order = np.argsort(-share, kind="stable")
    if (main == 0).any():  # a light that is the first of no pixel is no cluster
        left = [one for one in range(count) if main[one]]
        still = outdoor in left
        speaks = np.isin(owner, left)
        kept = Chosen(chosen.centres[left], len(left) - 1 if still else -1, found.kept(speaks))
        return mixed(image, view, kept, sky, matrices=matrices)
    rank = np.argsort(order)
    everywhere = members(image, final, sky.mask if sky is not None and sky.present else None, outdoor, rank=rank)
    label = np.where(light > 0, rank[own.first], -1)
    rows = [
        _one(
            view,
            label == place,
            evidence[owner == one] if one != outdoor else evidence[:0],
            found.weight[owner == one] if one != outdoor else found.weight[:0],
            found.direct,
            xyz_from_rgb,
        )
        for place, one in enumerate(order)
    ]
    outdoors = order == outdoor
    return _record(view, rows, share[order], everywhere, outdoors, found)


def lone(image: Image, view: View, found: Evidence, centres: Floats, xyz_from_rgb: Floats) -> Clusters:
    """The record of the paper's method: every pixel has the light of the nearest centre [k, 2]."""
    lit = view.luminance > 0
    nearest = np.argmin(squared(angles(view.rgb[lit]), centres), axis=1)
    light = view.light[lit]
    share = np.bincount(nearest, light, len(centres)) / light.sum()
    order = np.argsort(-share, kind="stable")
    if share[order[-1]] <= 0:  # a centre that no pixel of the map is nearest to is no cluster
        return lone(image, view, found, centres[order[share[order] > 0]], xyz_from_rgb)
    label = np.full(view.luminance.shape, -1)
    label[lit] = np.argsort(order)[nearest]
    speaks = label.ravel()[found.place]
    rows, skies = [], []
    for one in range(len(centres)):
        rows.append(
            _one(view, label == one, found.rgb[speaks == one], found.weight[speaks == one], found.direct, xyz_from_rgb)
        )
        skies.append(0.0 if view.sky is None else float((view.solid_angle * view.sky)[label == one].sum()))
    outdoors = np.zeros(len(rows), np.bool_)
    if max(skies) > 0:
        outdoors[int(np.argmax(skies))] = True  # at most one: the one with most of the sky
    labels = labelled(image, centres[order])
    own = Members(labels, labels, np.ones(labels.shape, np.float32))
    return _record(view, rows, share[order], own, outdoors)


@dataclass(frozen=True, slots=True, eq=False)
class _Described:
    """One cluster, measured on the working map."""

    mean: Floats
    brightest: Floats
    lamp: Floats
    direct: bool
    spread: tuple[float, float]  # mired, Duv
    at: tuple[float, float]


def _one(view: View, mine: Bools, colours: Floats, weight: Floats, direct: bool, xyz_from_rgb: Floats) -> _Described:
    height, width = view.luminance.shape
    place = _brightest_region(view.luminance, mine)
    if not len(colours):  # a cluster of the paper's metric may hold dark pixels only
        colours, weight, direct = view.rgb[mine], view.light[mine], False
    rgb = view.rgb.reshape(-1, 3)
    own = np.where(
        mine, view.solid_angle, 0.0
    ).ravel()  # no gathering of pixels: that costs twice as much as all the rest
    return _Described(
        mean=own @ rgb / own.sum(),
        brightest=rgb[np.argmax(np.where(mine, view.luminance, -1.0))],
        lamp=lamp_colour(colours, weight),
        direct=direct,
        spread=_spreads(colours, weight, xyz_from_rgb),
        at=((place % width + 0.5) / width, (place // width + 0.5) / height),
    )


def _record(
    view: View, rows: list[_Described], share: Floats, own: Members, outdoor: Bools, found: Evidence | None = None
) -> Clusters:
    lamps = np.stack([row.lamp for row in rows])
    if outdoor.any():
        lamps[outdoor] = daylight(view)
    return Clusters(
        labels=own.first,
        second=own.second,
        weight=own.weight,
        count=len(rows),
        means=np.stack([row.mean for row in rows]),
        brightest=np.stack([row.brightest for row in rows]),
        lamps=lamps,
        direct=np.array([row.direct for row in rows]),
        spread_mired=np.array([row.spread[0] for row in rows]),
        spread_duv=np.array([row.spread[1] for row in rows]),
        outdoor=outdoor,
        share=share,
        at=np.array([row.at for row in rows]),
        warnings=(),
        lamp_above=np.inf if found is None else found.above,
        alike=(ALIKE_MIRED, ALIKE_DUV) if found is None else alike(direct=found.direct),
    )


def _brightest_region(luminance: Floats, mine: Bools) -> int:
    """Flat index of the pixel about which most of a cluster's own light stands within a hundredth of the map's width.

    A single pixel will not do: the rim of a lamp of another colour has pixels of any colour, brighter than most lamps.
    Where many pixels have as much about them, as in a panel that shines evenly, it is the one in their middle.
    """
    reach = max(1, luminance.shape[1] // 100)
    shone = np.where(mine, luminance, 0.0).astype(np.float32)
    wrapped = np.pad(shone, ((0, 0), (reach, reach)), mode="wrap")
    blurred = cv2.blur(wrapped, (2 * reach + 1, 2 * reach + 1), borderType=cv2.BORDER_REPLICATE)[:, reach:-reach]
    own = np.where(mine, blurred, -1.0)
    return _middle(own >= EVENLY * own.max(), int(np.argmax(own)))


def _middle(those: Bools, first: int) -> int:
    """Flat index of the pixel in the middle, on the sphere, of those that hang together with `first`."""
    height, width = those.shape
    shift = width // 2 - first % width  # so that what lies across the seam hangs together
    _, part = cv2.connectedComponents(np.roll(those, shift, axis=1).astype(np.uint8))
    rows, columns = np.nonzero(part == part[first // width, width // 2])
    theta, phi = np.pi * (rows + 0.5) / height, 2.0 * np.pi * (columns + 0.5) / width
    ways = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    mean = np.sin(theta) @ ways / np.sin(theta).sum()
    if np.sqrt(mean @ mean) < NO_MIDDLE:
        return first
    nearest = int(np.argmax(ways @ mean))
    return int(rows[nearest] * width + (columns[nearest] - shift) % width)


def _spreads(colours: Floats, weight: Floats, xyz_from_rgb: Floats) -> tuple[float, float]:
    """Robust standard deviations of the colours' mired and Duv, NaN where fewer than half of the weight has a CCT."""
    points, share = histogram(colours / colours.sum(axis=1, keepdims=True), colours, weight)
    cct, duv = cct_duv(xy_of_rgb(points, xyz_from_rgb))
    known = np.isfinite(cct)
    if share[known].sum() < 0.5:
        return float("nan"), float("nan")
    found = []
    for values in (mired(cct[known]), duv[known]):
        middle = weighted_median(values, share[known])
        found.append(1.4826 * weighted_median(np.abs(values - middle), share[known]))
    return found[0], found[1]
