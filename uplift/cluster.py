"""Clusters of a lat-long map: which lamps there are, and which of them lights each pixel.

The distance is the one of Tódová and Wilkie (Constrained Spectral Uplifting for HDR Environment Maps, EGSR 2024): the
angle between colours, brightness ignored; k-means; at most six clusters, at most one of them outdoors, no two of
similar temperature. `evidence="bright"` is their method: every pixel that is no darker than the average, k growing
from 1 until a clustering has to be rejected.

That method takes a coloured wall for a lamp. The default, `evidence="lamps"`, first looks for the lamps themselves.
No matt surface is brighter than the irradiance that falls on it over π, so what is far brighter than the greatest
irradiance at the camera over π, and not merely the glow around something brighter still, is a lamp (or a window, or
the sun) seen directly, and its colour is its own. Clusters are formed of those pixels, weighted by luminance times
solid angle, and every other pixel goes to the nearest. Where no lamp is in view, the locally brightest surfaces take
their place, under a stricter test, as they are the ones most likely to be white (Land's retinex argument).

The statistics are made on a map of at most 1024 columns and a histogram of it; only the labels touch every pixel.

Left out: soft membership (a pixel lit by two lamps gets the nearer one), and any use of where a pixel is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import cv2
import numba
import numpy as np
import numpy.typing as npt

from uplift import UpliftError
from uplift.cct import cct_duv, mired, uv_of_xy, xy_of_rgb
from uplift.sky import Sky

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]

WORK_WIDTH = 1024  # columns of the map on which statistics are made
BINS = 256  # of each angle; bins keep their mean, so this bounds what is told apart, not the accuracy
# Above this many times (greatest irradiance)/π a pixel is taken for a lamp seen directly. Measured on 54 relit rooms of
# one to three lamps: with 4 all numbers of lamps came out right, with 2 up to 11 walls beside a lamp were called lamps.
LAMP_ABOVE_DIFFUSE = 4.0
GLOW_RADIUS = 10.0 / 360.0  # of the width: how far the glow of a lamp reaches on what stands beside it
GLOW_BELOW = 0.25  # of the brightest within that radius: below it a pixel is glow, not lamp
MIN_LAMP_LIGHT = 0.02  # share of all light that must be seen directly; else surfaces are the evidence
MIN_SHARE = 0.03  # of the evidence's light, for a cluster to be one
MIN_SHARE_SURFACES = 0.10
MIN_SHARE_UNDER_SKY = 0.10  # of lamps seen under an open sky, where glitter on water is as bright as a lamp
SKY_MARGIN = 4.0 / 360.0  # of the width: how far beyond the sky's border the sun's glare is still the sky's
ALIKE_MIRED = 25.0  # closer than this (and than ALIKE_DUV across the locus) two clusters are one lamp's light
ALIKE_MIRED_SURFACES = 50.0
ALIKE_DUV = 0.010
ALIKE_UV = 0.012  # where a CCT does not exist; 25 mired are 0.009 to 0.012 along the locus
SEPARATION = 4.0  # Ashman's D (1994) with robust spreads; an even spread cut in two has 2.7, two lamps far more


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
class _Evidence:
    """Pixels that speak for the lamps: positions in the working map, colours and weights."""

    rgb: Floats  # [P, 3]
    weight: Floats  # [P]
    place: npt.NDArray[np.int64]  # [P] flat index into the working map
    direct: bool


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
    weights = np.asarray(luminance_weights, np.float64)
    matrix = np.asarray(xyz_from_rgb, np.float64)

    work = _working_map(image)
    luminance = np.maximum(work @ weights, 0.0)
    solid_angle = _solid_angle(*luminance.shape)
    in_sky = _sky_of_working_map(sky, work.shape[:2])
    if not (luminance > 0).any():
        return _nothing(image, "the map holds no light: no pixel has a luminance above zero")

    if evidence == "bright":
        found = _bright(work, luminance, solid_angle)
        centres = _grow_like_the_paper(found, in_sky, matrix, k_max)
    else:
        found = _lamps_or_surfaces(work, luminance, solid_angle)
        centres = _choose(found, in_sky, matrix, k_max)
    features = _angles if evidence == "bright" else _directions
    return _described(image, work, luminance, solid_angle, in_sky, found, centres, features, matrix)


# ---- the working map ----


def _working_map(image: Image) -> Floats:
    """The map at most 1024 wide, without NaN, infinities and negative values, float64."""
    height, width = image.shape[:2]
    small = image
    if width > WORK_WIDTH:
        size = (WORK_WIDTH, max(1, round(height * WORK_WIDTH / width)))
        # an average with a NaN in it is NaN; such pixels are few, and their neighbours speak for them
        small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)
    out = np.where(np.isfinite(small).all(axis=2, keepdims=True), small, 0.0).astype(np.float64)
    return np.maximum(out, 0.0)


def _solid_angle(height: int, width: int) -> Floats:
    """Solid angle of each pixel as a share of the sphere, [H, W]; sums to 1."""
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    rows = (edges[:-1] - edges[1:]) / (2.0 * width)
    return np.repeat(rows[:, np.newaxis], width, axis=1)


def _sky_of_working_map(sky: Sky | None, shape: tuple[int, int]) -> Bools | None:
    if sky is None or not sky.present:
        return None
    mask = sky.mask.astype(np.uint8)
    return cv2.resize(mask, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST).astype(np.bool_)


def _daylight(work: Floats, solid_angle: Floats, in_sky: Bools) -> Floats:
    """RGB [3] of what the sky and the sun in it give to a level surface."""
    cosine = np.maximum(np.cos(np.pi * (np.arange(len(work)) + 0.5) / len(work)), 0.0)
    weight = solid_angle * cosine[:, np.newaxis] * in_sky
    out: Floats = (work * weight[..., np.newaxis]).sum(axis=(0, 1))
    return out / max(float(weight.sum()), 1e-300)


def _greatest_irradiance(luminance: Floats, solid_angle: Floats) -> float:
    """The greatest irradiance any orientation receives at the camera, over π: a white card's greatest luminance."""
    size = (min(64, luminance.shape[1]), min(32, luminance.shape[0]))
    flux = luminance * solid_angle
    small = cv2.resize(flux, size, interpolation=cv2.INTER_AREA)
    small = small * (flux.sum() / small.sum())
    theta = np.pi * (np.arange(size[1]) + 0.5) / size[1]
    phi = 2.0 * np.pi * ((np.arange(size[0]) + 0.5) / size[0] - 0.5)
    directions = np.stack(
        [
            np.outer(np.sin(theta), np.sin(phi)),
            np.outer(np.cos(theta), np.ones_like(phi)),
            -np.outer(np.sin(theta), np.cos(phi)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    cosines = np.maximum(directions @ directions.T, 0.0)
    return float(4.0 * (cosines @ small.ravel()).max())  # 4π of the sphere over π


def _greatest_nearby(luminance: Floats, radius: int) -> Floats:
    """Greatest luminance within `radius` pixels of the working map, wrapping in x."""
    radius = max(1, min(radius, luminance.shape[1] // 2))
    padded = np.pad(luminance, ((0, 0), (radius, radius)), mode="wrap")
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    grown = cv2.dilate(padded, disc)
    return np.asarray(grown[:, radius:-radius], np.float64)


# ---- the evidence ----


def _evidence(work: Floats, weight: Floats, chosen: Bools, *, direct: bool) -> _Evidence:
    place = np.flatnonzero(chosen & (work.sum(axis=2) > 0))
    return _Evidence(work.reshape(-1, 3)[place], weight.ravel()[place], place, direct)


def _bright(work: Floats, luminance: Floats, solid_angle: Floats) -> _Evidence:
    """The paper's: every pixel that is no darker than the average, each by its solid angle."""
    mean = float((luminance * solid_angle).sum())
    return _evidence(work, solid_angle, luminance >= mean * (1 - 1e-9), direct=False)


def _lamps_or_surfaces(work: Floats, luminance: Floats, solid_angle: Floats) -> _Evidence:
    light = luminance * solid_angle
    nearby = _greatest_nearby(luminance, round(GLOW_RADIUS * luminance.shape[1]))
    white_card = _greatest_irradiance(luminance, solid_angle)
    lamps = (luminance > LAMP_ABOVE_DIFFUSE * white_card) & (luminance >= GLOW_BELOW * nearby)
    if light[lamps].sum() >= MIN_LAMP_LIGHT * light.sum():
        return _evidence(work, light, lamps, direct=True)
    surfaces = (luminance >= light.sum() * (1 - 1e-9)) & (luminance >= 2 * GLOW_BELOW * nearby)
    return _evidence(work, light, surfaces, direct=False)


# ---- k-means on a histogram ----


def _angles(rgb: Floats) -> Floats:
    """The paper's features [..., 2]: polar angle from the blue axis, and azimuth from red to green."""
    radius = np.sqrt((rgb**2).sum(axis=-1))
    with np.errstate(divide="ignore", invalid="ignore"):
        theta = np.arccos(np.clip(rgb[..., 2] / radius, -1.0, 1.0))
    return np.stack([np.where(radius > 0, theta, 0.0), np.arctan2(rgb[..., 1], rgb[..., 0])], axis=-1)


def _directions(rgb: Floats) -> Floats:
    """Unit vectors [..., 3]: chords between them grow with the angle between colours, without poles."""
    radius = np.sqrt((rgb**2).sum(axis=-1, keepdims=True))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(radius > 0, rgb / radius, 0.0)


def _histogram(features: Floats, rgb: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Mean feature [B, F] and weight [B] of the occupied bins of both angles."""
    angles = _angles(rgb) * (BINS / (np.pi / 2))
    cells = np.clip(angles.astype(np.int64), 0, BINS - 1)
    bins = cells[:, 0] * BINS + cells[:, 1]
    total = np.bincount(bins, weight, BINS * BINS)
    used = np.flatnonzero(total > 0)
    sums = [
        np.bincount(bins, weight * features[:, i], BINS * BINS)[used] / total[used] for i in range(features.shape[1])
    ]
    return np.stack(sums, axis=1), total[used] / total[used].sum()


def _squared(points: Floats, centres: Floats) -> Floats:
    """Squared distances [P, k]."""
    out: Floats = ((points[:, np.newaxis] - centres) ** 2).sum(axis=2)
    return out


def _kmeans_up_to(points: Floats, weight: Floats, k_max: int) -> list[Floats]:
    """Centres [k, F] for k = 1 … k_max, each grown from the last (fast global k-means, Likas et al. 2003).

    The new centre starts at the heaviest of up to 512 bins that lessens the variance most, so nothing is random.
    """
    centres = (weight @ points / weight.sum())[np.newaxis]
    steps = [centres]
    heavy = np.argsort(-weight, kind="stable")[:512]
    between = _squared(points, points[heavy])
    for _ in range(1, min(k_max, len(points))):
        nearest = _squared(points, centres).min(axis=1)
        gain = weight @ np.maximum(nearest[:, np.newaxis] - between, 0.0)
        if gain.max() <= 1e-12:
            break  # every bin stands on a centre: one more would be empty
        centres = _lloyd(points, weight, np.vstack([centres, points[heavy[np.argmax(gain)]]]))
        steps.append(centres)
    return steps


def _lloyd(points: Floats, weight: Floats, centres: Floats) -> Floats:
    for _ in range(100):
        label = np.argmin(_squared(points, centres), axis=1)
        mass = np.bincount(label, weight, len(centres))
        sums = [np.bincount(label, weight * points[:, i], len(centres)) for i in range(points.shape[1])]
        moved = np.where(
            mass[:, np.newaxis] > 0, np.stack(sums, axis=1) / np.maximum(mass, 1e-300)[:, np.newaxis], centres
        )
        if np.abs(moved - centres).max() < 1e-9:
            break
        centres = moved
    return centres


# ---- how many ----


def _lamp_colours(found: _Evidence, label: npt.NDArray[np.int64], count: int) -> Floats:
    """Light-weighted mean colour [k, 3] of each cluster's evidence (its brightness means nothing)."""
    scaled = found.rgb / found.rgb.sum(axis=1, keepdims=True) * found.weight[:, np.newaxis]
    return np.stack([np.bincount(label, scaled[:, i], count) for i in range(3)], axis=1)


def _alike(colours: Floats, xyz_from_rgb: Floats, *, least_mired: float) -> Bools:
    """[k, k]: which pairs of colours may be the light of one kind of lamp."""
    xy = xy_of_rgb(colours, xyz_from_rgb)
    cct, duv = cct_duv(xy)
    uv = uv_of_xy(xy)
    apart = np.abs(mired(cct)[:, np.newaxis] - mired(cct))
    across = np.abs(duv[:, np.newaxis] - duv)
    on_plane = np.hypot(*np.moveaxis(uv[:, np.newaxis] - uv, -1, 0))
    nearly = (apart < least_mired) & (across < ALIKE_DUV)
    out: Bools = np.where(np.isfinite(apart), nearly, on_plane < ALIKE_UV)
    return out


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
                middle = _weighted_median(along, weight[mine])
                middles.append(middle)
                spreads.append(1.4826 * _weighted_median(np.abs(along - middle), weight[mine]))
            both = max(float(np.hypot(*spreads)), 1e-9)
            least = min(least, np.sqrt(2.0) * abs(middles[0] - middles[1]) / both)
    return least


def _weighted_median(values: Floats, weight: Floats) -> float:
    if not len(values):
        return 0.0
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])


def _choose(found: _Evidence, in_sky: Bools | None, xyz_from_rgb: Floats, k_max: int) -> Floats:
    """Centres [k, 3] of the default method: as many lamps as differ clearly, the sky's light counting as one."""
    outdoors: list[Floats] = []
    keep = np.ones(len(found.place), np.bool_)
    if in_sky is not None:
        margin = round(SKY_MARGIN * in_sky.shape[1])
        above = _greatest_nearby(in_sky.astype(np.float64), margin).ravel()[found.place] > 0
        # Without the sun in view nothing outdoors is a lamp; with it, sun and sky are one outdoor light. Surfaces
        # under an open sky speak for no other lamp.
        keep = ~above if found.direct else np.zeros_like(above)
        if found.weight[keep].sum() < MIN_SHARE_UNDER_SKY * found.weight.sum():
            keep[:] = False
        rest = ~keep
        if rest.any():
            outdoors = [_lamp_colours(found, np.where(rest, 0, 1), 2)[:1]]
    if not keep.any():
        return _directions(np.vstack(outdoors))
    room = k_max - len(outdoors)
    if room < 1:
        return _directions(np.vstack(outdoors))
    least_mired, least_share = (ALIKE_MIRED, MIN_SHARE) if found.direct else (ALIKE_MIRED_SURFACES, MIN_SHARE_SURFACES)
    points, weight = _histogram(_directions(found.rgb[keep]), found.rgb[keep], found.weight[keep])
    best = None
    for centres in _kmeans_up_to(points, weight, room):
        label = np.argmin(_squared(points, centres), axis=1)
        share = np.bincount(label, weight, len(centres))
        alike = _alike(np.vstack([centres, *outdoors]), xyz_from_rgb, least_mired=least_mired)
        np.fill_diagonal(alike, False)
        if len(centres) == 1 and not (outdoors and alike.any()):
            best = centres
        elif (
            share.min() >= least_share and not alike.any() and _separation(points, weight, label, centres) >= SEPARATION
        ):
            best = centres
    return _directions(np.vstack([*([] if best is None else [best]), *outdoors]))


def _grow_like_the_paper(found: _Evidence, in_sky: Bools | None, xyz_from_rgb: Floats, k_max: int) -> Floats:
    """Centres [k, 2] of the paper's method: k grows until two clusters are alike or two are outdoors."""
    features = _angles(found.rgb)
    points, weight = _histogram(features, found.rgb, found.weight)
    steps = _kmeans_up_to(points, weight, k_max)
    accepted = steps[0]
    for centres in steps[1:]:
        label = np.argmin(_squared(features, centres), axis=1)
        colours = _lamp_colours(found, label, len(centres))
        alike = _alike(colours, xyz_from_rgb, least_mired=ALIKE_MIRED)
        np.fill_diagonal(alike, False)
        outdoor = 0
        if in_sky is not None:
            above = in_sky.ravel()[found.place]
            outdoor = int((np.bincount(label[above], minlength=len(centres)) > 0).sum())
        if alike.any() or outdoor > 1:
            break
        accepted = centres
    return accepted


# ---- every pixel, and the record ----


@numba.njit(cache=True, parallel=True)  # type: ignore[misc,untyped-decorator,unused-ignore]
def _label_directions(image, centres, labels):  # type: ignore[no-untyped-def]
    """Nearest centre by the angle between colours: the greatest dot product with its unit vector."""
    for y in numba.prange(image.shape[0]):
        for x in range(image.shape[1]):
            r, g, b = max(image[y, x, 0], 0.0), max(image[y, x, 1], 0.0), max(image[y, x, 2], 0.0)
            best, greatest = 0, 0.0
            if np.isfinite(r + g + b):
                for i in range(centres.shape[0]):
                    dot = r * centres[i, 0] + g * centres[i, 1] + b * centres[i, 2]
                    if dot > greatest:
                        best, greatest = i, dot
            labels[y, x] = best


def _labels(image: Image, centres: Floats) -> npt.NDArray[np.uint32]:
    labels = np.zeros(image.shape[:2], np.uint32)
    if len(centres) == 1:
        return labels
    if centres.shape[1] == 3:
        _label_directions(image, centres, labels)
        return labels
    for start in range(0, len(image), 64):  # the paper's metric, in strips of rows
        strip = image[start : start + 64]
        fine = np.isfinite(strip).all(axis=2)
        rgb = np.where(fine[..., np.newaxis], np.maximum(strip, 0.0), 0.0).astype(np.float64)
        nearest = np.argmin(_squared(_angles(rgb).reshape(-1, 2), centres), axis=1).reshape(fine.shape)
        labels[start : start + 64] = np.where(fine & (rgb.sum(axis=2) > 0), nearest, 0)
    return labels


def _nothing(image: Image, warning: str) -> Clusters:
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


def _described(
    image: Image,
    work: Floats,
    luminance: Floats,
    solid_angle: Floats,
    in_sky: Bools | None,
    found: _Evidence,
    centres: Floats,
    features: Callable[[Floats], Floats],
    xyz_from_rgb: Floats,
) -> Clusters:
    """The record: clusters of the working map measured, put in order of their share, and every pixel labelled."""
    lit = luminance > 0
    nearest = np.argmin(_squared(features(work[lit]), centres), axis=1)
    light = (luminance * solid_angle)[lit]
    share = np.bincount(nearest, light, len(centres)) / light.sum()
    order = np.argsort(-share, kind="stable")
    order = order[share[order] > 0]
    centres, share = centres[order], share[order]
    label = np.full(luminance.shape, -1)
    label[lit] = np.argmin(_squared(features(work[lit]), centres), axis=1)
    speaks = label.ravel()[found.place]
    smooth = cv2.blur(luminance, (3, 3), borderType=cv2.BORDER_REPLICATE)

    rows: list[_Described] = []
    for one in range(len(centres)):
        mine = label == one
        place = int(np.argmax(np.where(mine, smooth, -1.0)))
        evidence = speaks == one
        if evidence.any():
            colours, weight, direct = found.rgb[evidence], found.weight[evidence], found.direct
        else:  # a cluster of the paper's metric may hold dark pixels only
            colours, weight, direct = work[mine], (luminance * solid_angle)[mine], False
        rows.append(
            _Described(
                mean=np.average(work[mine], axis=0, weights=solid_angle[mine]),
                brightest=work[mine][np.argmax(luminance[mine])],
                lamp=np.average(colours, axis=0, weights=weight / colours.sum(axis=1)),
                direct=direct,
                spread=_spread_mired(colours, weight, xyz_from_rgb),
                sky=0.0 if in_sky is None else float((solid_angle * in_sky)[mine].sum()),
                at=((place % label.shape[1] + 0.5) / label.shape[1], (place // label.shape[1] + 0.5) / len(label)),
            )
        )
    lamps = np.stack([row.lamp for row in rows])
    skies = np.array([row.sky for row in rows])
    outdoor = np.zeros(len(rows), np.bool_)
    if skies.max() > 0:
        outdoor[np.argmax(skies)] = True  # at most one: the one with most of the sky
    if in_sky is not None and outdoor.any():
        lamps[outdoor] = _daylight(work, solid_angle, in_sky)
    return Clusters(
        labels=_labels(image, centres),
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
    points, share = _histogram(colours / colours.sum(axis=1, keepdims=True), colours, weight)
    cct, _ = cct_duv(xy_of_rgb(points, xyz_from_rgb))
    known = np.isfinite(cct)
    if share[known].sum() < 0.5:
        return float("nan")
    steps = mired(cct[known])
    middle = _weighted_median(steps, share[known])
    return 1.4826 * _weighted_median(np.abs(steps - middle), share[known])
