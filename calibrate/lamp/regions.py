"""Regions of a picture that stand out at some threshold, each with a score for looking like the D65 module."""

from dataclasses import replace
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate.chart.geometry import signed_area
from calibrate.difference import D65_XYZ
from calibrate.lamp.curve import adapted_d65_curve, uv_from_xyz
from calibrate.lamp.reading import MOST_REFLECTED, Image, Mask, Points, Region

# Chromaticity distance u'v' at which a region is one sigma from the curve: lamps that are no black bodies, chart
# corrections that are not exact and modules that are not quite D65 each add about 0.01.
_CURVE_SIGMA: Final = 0.015
# From where the camera's own matrix puts D65: over 54 cameras and 22 scene lights, LED modules lie 0.006 away in the
# median, 0.015 in one of twenty; a camera that differs from its matrix by 2 % a channel adds 0.005.
_EXPECTED_SIGMA: Final = 0.012
_FARTHEST: Final = 0.06
# Scatter of u'v' between the parts of a region: modules stay below 0.002; a view through a window does not.
_EVEN_SIGMA: Final = 0.004
_LEAST_FILL: Final = 0.7
_LEAST_PIXELS: Final = 30
_LARGEST_CHARTS: Final = 2.5
_NEAR_CHART_WIDTHS: Final = 1.2
# Modules cover 0.02–0.25 of the chart's area.
_MODEST_SHARE: Final = 0.25
# Panes of one window and tubes of one luminaire differ by less in u'v' and in the logarithm of luminance.
_SAME_COLOUR: Final = 0.004
_SAME_LEVEL: Final = 0.15
# Regions that score less need not be looked at further.
_HOPELESS: Final = 1e-3
_LOWEST_LEVEL: Final = 0.35
# Regions examined at one threshold, the largest first; a noisy picture has thousands of specks.
_MOST_REGIONS: Final = 60


def regions_of(
    image: Image,
    lost: Mask,
    chart: Points,
    xyz_from_rgb: npt.NDArray[np.float64],
    expected_uv: Points | None,
) -> list[Region]:
    """Return every region that stands out at some threshold, scored; the chart itself is left out.

    `expected_uv` [2] is the chromaticity of the lamp where that is known; without it, the curve it lies on.
    """
    luminance = cv2.transform(np.nan_to_num(image), xyz_from_rgb[1:2])
    luminance = luminance.reshape(image.shape[:2])
    height, width = luminance.shape
    # A lost pixel is taken as brighter than everything: where most are lost, the region is refused, not overlooked.
    brightest = float(luminance[~lost].max(initial=0.0))
    luminance = np.where(lost, np.float32(2 * max(brightest, 1.0)), luminance)
    covered = np.zeros((height, width), dtype=np.uint8)
    centre = chart.mean(axis=0)
    cv2.fillConvexPoly(covered, np.round(centre + 1.02 * (chart - centre)).astype(np.int32), 1)
    luminance[covered > 0] = 0

    chart_area = abs(signed_area(chart))
    levels = _LOWEST_LEVEL * np.sqrt(2.0) ** np.arange(
        max(1, int(2 * np.log2(max(brightest, 1.0) / _LOWEST_LEVEL)) + 1)
    )
    found: list[Region] = []
    for level in levels:
        count, labels, stats, _ = cv2.connectedComponentsWithStats((luminance > level).astype(np.uint8), connectivity=4)
        areas = stats[:, cv2.CC_STAT_AREA]
        fits = (areas >= _LEAST_PIXELS) & (areas <= _LARGEST_CHARTS * chart_area)
        fits[0] = False
        for label in sorted(np.flatnonzero(fits[:count]), key=lambda i: -areas[i])[:_MOST_REGIONS]:
            x, y, w, h = stats[label, :4]
            region = _scored(
                image,
                luminance,
                lost=lost,
                labels=labels,
                label=int(label),
                box=(x, y, w, h),
                chart=chart,
                xyz_from_rgb=xyz_from_rgb,
                expected_uv=expected_uv,
            )
            if region is not None:
                found.append(region)
    return _alone(found)


def _scored(
    image: Image,
    luminance: npt.NDArray[np.float32],
    *,
    lost: Mask,
    labels: npt.NDArray[np.int32],
    label: int,
    box: tuple[int, int, int, int],
    chart: Points,
    xyz_from_rgb: npt.NDArray[np.float64],
    expected_uv: Points | None,
) -> Region | None:
    x, y, w, h = box
    height, width = luminance.shape
    pad = 4
    x0, y0, x1, y1 = max(x - pad, 0), max(y - pad, 0), min(x + w + pad, width), min(y + h + pad, height)
    own = (labels[y0:y1, x0:x1] == label).astype(np.uint8)
    contour = max(cv2.findContours(own, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0], key=len)
    rectangle = cv2.minAreaRect(contour)
    # A contour runs through pixel centres, so the region is one pixel wider and higher than its rectangle.
    (rw, rh), filled = rectangle[1], int(own.sum())
    fill = filled / ((rw + 1) * (rh + 1))
    if fill < _LEAST_FILL:
        return None
    inside = cv2.erode(own, np.ones((3, 3), np.uint8)) > 0
    if min(rw, rh) >= 16:
        inside = cv2.erode(own, np.ones((5, 5), np.uint8)) > 0
    if inside.sum() < _LEAST_PIXELS:
        return None
    part = (slice(y0, y1), slice(x0, x1))
    clipped = float(lost[part][inside].mean())
    polygon = cv2.boxPoints(rectangle).astype(np.float64) + np.array([float(x0), float(y0)])

    ring = (cv2.dilate(own, np.ones((7, 7), np.uint8)) > 0) & ~(cv2.dilate(own, np.ones((3, 3), np.uint8)) > 0)
    surround = luminance[part][ring]
    usable = inside & ~lost[part]
    if usable.sum() < _LEAST_PIXELS:
        # Nothing but clipped pixels: form and place must do, and the brightness is unknown.
        shape = _shape_score(fill, polygon, chart, (width, height))
        return Region(polygon, inside, (x0, y0), 0.5 * shape, clipped)
    rgb = image[part].astype(np.float64)
    xyz = rgb[usable] @ xyz_from_rgb.T
    mean = xyz.mean(axis=0)
    if mean[1] <= 0:
        return None
    uv = uv_from_xyz(mean)
    known = expected_uv is not None
    places = adapted_d65_curve() if expected_uv is None else expected_uv[None]
    distance = _distance(mean, places)
    if distance > _FARTHEST:
        return None
    contrast = mean[1] / max(float(np.median(surround)) if surround.size else 0.0, 1e-6 * mean[1])
    # Heavy tails: a chart under a lamp of three narrow bands makes a matrix that errs more than most.
    right_colour = (1 + (distance / (_EXPECTED_SIGMA if known else _CURVE_SIGMA)) ** 2) ** -1.5
    # A neutral region may be paper in the scene's own light; a tinted one on the curve hardly is.
    tinted = 0.4 + 0.6 * min(1.0, float(np.hypot(*(uv - uv_from_xyz(D65_XYZ)))) / 0.03)
    even = 1 / (1 + (_unevenness(rgb, usable, xyz_from_rgb) / _EVEN_SIGMA) ** 2)
    # A white paper in the light of the chart reads 0.9; from 1.2 on it needs a lamp of its own.
    shining = 1 / (1 + (1.1 / mean[1]) ** 4)
    isolated = np.clip((contrast - 1.05) / 1.0, 0, 1)
    seen_well = inside.sum() / (inside.sum() + 40.0)
    score = right_colour * tinted * even * shining * isolated * seen_well
    if score < _HOPELESS:
        return None
    score *= _shape_score(fill, polygon, chart, (width, height))
    return Region(polygon, inside, (x0, y0), float(score), clipped, mean)


def _distance(mean: npt.NDArray[np.float64], places: Points) -> float:
    """How far in u'v' XYZ [3] is from the nearest of `places` [N, 2], whatever it reflects of the light on the chart."""
    most = min(MOST_REFLECTED, 0.8 * float(mean[1]))
    own = mean - np.linspace(0.0, most, 8)[:, None] * D65_XYZ
    return float(np.hypot(*np.moveaxis(uv_from_xyz(own)[:, None] - places, -1, 0)).min())


def _unevenness(rgb: npt.NDArray[np.float64], usable: Mask, xyz_from_rgb: npt.NDArray[np.float64]) -> float:
    """Scatter of u'v' between the parts of a region, of 4×4: noise, which is as large as the pixels are few, averages out."""
    rows, columns = np.nonzero(usable)
    cells = 4 * ((rows - rows.min()) * 4 // (np.ptp(rows) + 1)) + (columns - columns.min()) * 4 // (np.ptp(columns) + 1)
    count = np.bincount(cells, minlength=16)
    samples = rgb[rows, columns]
    parts = np.stack([np.bincount(cells, weights=samples[:, k], minlength=16) for k in range(3)], axis=1)
    large = count * 40 >= len(rows)
    uv = uv_from_xyz(parts[large] @ xyz_from_rgb.T)
    return float(
        np.sqrt(
            np.average((uv - np.average(uv, axis=0, weights=count[large])) ** 2, axis=0, weights=count[large]).sum()
        )
    )


def _shape_score(fill: float, polygon: Points, chart: Points, size: tuple[int, int]) -> float:
    """How well form, size and place suit a module that stands beside the chart in a picture of `size` (width, height)."""
    width = float(np.hypot(*(chart[1] - chart[0])))
    near = 1 / (1 + (max(_gap(polygon, chart), 0.0) / (_NEAR_CHART_WIDTHS * width)) ** 2)
    share = abs(signed_area(polygon)) / abs(signed_area(chart))
    modest = 1 / (1 + (share / _MODEST_SHARE) ** 2)
    # What the picture's border cuts is rarely a lamp that was put up to be photographed.
    border = polygon.min() < 1 or (polygon.max(axis=0) > np.array(size) - 2).any()
    return float(near * modest * np.clip((fill - 0.5) / 0.35, 0, 1)) * (0.3 if border else 1.0)


def _gap(polygon: Points, chart: Points) -> float:
    """Distance in pixels between two convex outlines; not positive where they meet."""
    both = (polygon, chart)
    distances = []
    for own, other in (both, both[::-1]):
        hull = np.ascontiguousarray(other, np.float32).reshape(-1, 1, 2)
        share = np.linspace(0.0, 1.0, 8, endpoint=False)[:, None, None]
        border = (own * (1 - share) + np.roll(own, -1, axis=0) * share).reshape(-1, 2)
        distances += [-cv2.pointPolygonTest(hull, (float(x), float(y)), True) for x, y in border]
    return float(min(distances))


def _alone(regions: list[Region]) -> list[Region]:
    """Lower the scores of regions that have others of their colour and brightness beside them, as panes of a window have."""
    lit = [region for region in regions if region.xyz is not None and region.score > _HOPELESS]
    if not lit:
        return regions
    xyz = np.array([region.xyz for region in lit])
    uv, level = uv_from_xyz(xyz), np.log(xyz[:, 1])
    low = np.array([region.polygon.min(axis=0) for region in lit])
    high = np.array([region.polygon.max(axis=0) for region in lit])
    area = np.array([abs(signed_area(region.polygon)) for region in lit])
    out = [region for region in regions if region.xyz is None or region.score <= _HOPELESS]
    for n, region in enumerate(lit):
        like = (np.hypot(*(uv - uv[n]).T) < _SAME_COLOUR) & (np.abs(level - level[n]) < _SAME_LEVEL)
        like &= (area > 0.2 * area[n]) & ((low > high[n] + 2) | (high < low[n] - 2)).any(axis=1)
        # Thresholds nest: regions that overlap are one.
        others: list[int] = []
        for k in np.flatnonzero(like):
            if all(((low[k] > high[m] + 2) | (high[k] < low[m] - 2)).any() for m in others):
                others.append(int(k))
        out.append(replace(region, score=region.score / (1 + 0.5 * len(others))))
    return out


def overlap(one: Region, other: Region) -> bool:
    """Return whether the bounding boxes of two regions meet: thresholds nest."""
    a0, a1 = one.polygon.min(axis=0), one.polygon.max(axis=0)
    b0, b1 = other.polygon.min(axis=0), other.polygon.max(axis=0)
    return bool((a0 <= b1 + 2).all() and (b0 <= a1 + 2).all())
