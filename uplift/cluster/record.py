"""What is known of each cluster."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from uplift.cct import cct_duv, mired, xy_of_rgb
from uplift.cluster.count import weighted_median
from uplift.cluster.evidence import Evidence, View, daylight
from uplift.cluster.kmeans import histogram, labelled, squared

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """Which light each pixel belongs to, and what is known of each light's colour.

    Clusters are numbered by falling share of the light. All colours are in the map's own linear RGB.
    """

    labels: npt.NDArray[np.uint32]  # [H, W], 0 … count − 1; pixels without a colour (black, NaN) are 0
    count: int
    means: Floats  # [k, 3] mean RGB of the cluster's pixels, by solid angle (the paper's colour)
    brightest: Floats  # [k, 3] RGB of its brightest pixel of the working map (the paper's outdoor colour)
    # [k, 3] mean RGB of what is seen of the lamp itself, by luminance · solid angle; of the outdoor cluster: what sky
    # and sun together give to a level surface
    lamps: Floats
    direct: Bools  # [k] whether `lamps` rests on a lamp seen directly (else on the brightest surfaces)
    spread_mired: Floats  # [k] robust standard deviation of that evidence, in mired; NaN where not measurable
    outdoor: Bools  # [k] whether the cluster holds the sky
    share: Floats  # [k] of luminance · solid angle of the whole map; sums to 1
    at: Floats  # [k, 2] (u, v) of the cluster's brightest region, 0…1 from the top left of the map
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Described:
    """One cluster, measured on the working map."""

    mean: Floats
    brightest: Floats
    lamp: Floats
    direct: bool
    spread: float
    sky: float
    at: tuple[float, float]


def nothing(image: Image, warning: str) -> Clusters:
    zero = np.zeros((1, 3))
    return Clusters(
        labels=np.zeros(image.shape[:2], np.uint32),
        count=1,
        means=zero,
        brightest=zero,
        lamps=zero,
        direct=np.array([False]),
        spread_mired=np.array([np.nan]),
        outdoor=np.array([False]),
        share=np.array([1.0]),
        at=np.array([[0.5, 0.5]]),
        warnings=(warning,),
    )


def _brightest_region(luminance: Floats, mine: Bools) -> int:
    """Flat index of the pixel about which most of a cluster's own light stands within a hundredth of the map's width.

    A single pixel will not do: the rim of a lamp of another colour has pixels of any colour, brighter than most lamps.
    """
    reach = max(1, luminance.shape[1] // 100)
    wrapped = np.pad(np.where(mine, luminance, 0.0), ((0, 0), (reach, reach)), mode="wrap")
    own = cv2.blur(wrapped, (2 * reach + 1, 2 * reach + 1), borderType=cv2.BORDER_REPLICATE)[:, reach:-reach]
    return int(np.argmax(np.where(mine, own, -1.0)))


def described(
    image: Image,
    view: View,
    found: Evidence,
    centres: Floats,
    *,
    features: Callable[[Floats], Floats],
    xyz_from_rgb: Floats,
) -> Clusters:
    """The record: clusters of the working map measured, put in order of their share, and every pixel labelled."""
    lit = view.luminance > 0
    nearest = np.argmin(squared(features(view.rgb[lit]), centres), axis=1)
    light = view.light[lit]
    share = np.bincount(nearest, light, len(centres)) / light.sum()
    order = np.argsort(-share, kind="stable")
    if share[order[-1]] <= 0:  # a centre that no pixel of the map is nearest to is no cluster
        centres = centres[order[share[order] > 0]]
        return described(image, view, found, centres, features=features, xyz_from_rgb=xyz_from_rgb)
    centres, share = centres[order], share[order]
    height, width = view.rgb.shape[:2]
    label = np.full((height, width), -1)
    label[lit] = np.argsort(order)[nearest]
    speaks = label.ravel()[found.place]
    rows: list[_Described] = []
    for one in range(len(centres)):
        mine = label == one
        place = _brightest_region(view.luminance, mine)
        evidence = speaks == one
        if evidence.any():
            colours, weight, direct = found.rgb[evidence], found.weight[evidence], found.direct
        else:  # a cluster of the paper's metric may hold dark pixels only
            colours, weight, direct = view.rgb[mine], view.light[mine], False
        rows.append(
            _Described(
                mean=np.average(view.rgb[mine], axis=0, weights=view.solid_angle[mine]),
                brightest=view.rgb[mine][np.argmax(view.luminance[mine])],
                lamp=np.average(colours, axis=0, weights=weight / colours.sum(axis=1)),
                direct=direct,
                spread=_spread_mired(colours, weight, xyz_from_rgb),
                sky=0.0 if view.sky is None else float((view.solid_angle * view.sky)[mine].sum()),
                at=((place % width + 0.5) / width, (place // width + 0.5) / height),
            )
        )
    lamps = np.stack([row.lamp for row in rows])
    skies = np.array([row.sky for row in rows])
    outdoor = np.zeros(len(rows), np.bool_)
    if skies.max() > 0:
        outdoor[np.argmax(skies)] = True  # at most one: the one with most of the sky
    if outdoor.any():
        lamps[outdoor] = daylight(view)
    return Clusters(
        labels=labelled(image, centres),
        count=len(rows),
        means=np.stack([row.mean for row in rows]),
        brightest=np.stack([row.brightest for row in rows]),
        lamps=lamps,
        direct=np.array([row.direct for row in rows]),
        spread_mired=np.array([row.spread for row in rows]),
        outdoor=outdoor,
        share=share,
        at=np.array([row.at for row in rows]),
        warnings=(),
    )


def _spread_mired(colours: Floats, weight: Floats, xyz_from_rgb: Floats) -> float:
    """Robust standard deviation of the colours' mired, NaN where fewer than half of the weight has a CCT."""
    points, share = histogram(colours / colours.sum(axis=1, keepdims=True), colours, weight)
    cct, _ = cct_duv(xy_of_rgb(points, xyz_from_rgb))
    known = np.isfinite(cct)
    if share[known].sum() < 0.5:
        return float("nan")
    steps = mired(cct[known])
    middle = weighted_median(steps, share[known])
    return 1.4826 * weighted_median(np.abs(steps - middle), share[known])
