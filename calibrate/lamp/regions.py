"""Regions of a picture that stand out at some threshold, each with a score for looking like the D65 module."""

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate.chart.geometry import signed_area
from calibrate.difference import D65_XYZ
from calibrate.lamp.curve import adapted_d65_curve, uv_from_xyz
from calibrate.lamp.reading import Image, Mask, Points, Region

# Chromaticity distance u'v' at which a region is one sigma from the curve: lamps that are no black bodies, chart
# corrections that are not exact and modules that are not quite D65 each add about 0.01.
_CURVE_SIGMA: Final = 0.015
_FARTHEST_FROM_CURVE: Final = 0.06
# Scatter of u'v' inside the region, ditto; an evenly lit module stays below 0.005.
_EVEN_SIGMA: Final = 0.02
_LEAST_FILL: Final = 0.7
_LEAST_PIXELS: Final = 30
_LARGEST_CHARTS: Final = 2.5
_NEAR_CHART_WIDTHS: Final = 2.0
_LOWEST_LEVEL: Final = 0.35
# Regions examined at one threshold, the largest first; a noisy picture has thousands of specks.
_MOST_REGIONS: Final = 60


def regions_of(image: Image, lost: Mask, chart: Points, xyz_from_rgb: npt.NDArray[np.float64]) -> list[Region]:
    """Return every region that stands out at some threshold, scored; the chart itself is left out."""
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
            )
            if region is not None:
                found.append(region)
    return found


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
        shape = _shape_score(fill, polygon, chart)
        return Region(polygon, inside, (x0, y0), 0.5 * shape, clipped)
    xyz = image[part][usable].astype(np.float64) @ xyz_from_rgb.T
    mean = xyz.mean(axis=0)
    if mean[1] <= 0:
        return None
    uv = uv_from_xyz(mean)
    distance = float(np.hypot(*(adapted_d65_curve() - uv).T).min())
    if distance > _FARTHEST_FROM_CURVE:
        return None
    contrast = mean[1] / max(float(np.median(surround)) if surround.size else 0.0, 1e-6 * mean[1])
    on_curve = np.exp(-0.5 * (distance / _CURVE_SIGMA) ** 2)
    # A neutral region may be paper in the scene's own light; a tinted one on the curve hardly is.
    tinted = 0.4 + 0.6 * min(1.0, float(np.hypot(*(uv - uv_from_xyz(D65_XYZ)))) / 0.03)
    even = np.exp(-0.5 * (float(uv_from_xyz(xyz).std(axis=0).max()) / _EVEN_SIGMA) ** 2)
    # A white paper in the light of the chart reads 0.9; from 1.2 on it needs a lamp of its own.
    shining = 1 / (1 + (1.1 / mean[1]) ** 4)
    isolated = np.clip((contrast - 1.05) / 1.0, 0, 1)
    score = on_curve * tinted * even * shining * isolated * _shape_score(fill, polygon, chart)
    return Region(polygon, inside, (x0, y0), float(score), clipped)


def _shape_score(fill: float, polygon: Points, chart: Points) -> float:
    """How well form, size and place suit a module that stands beside the chart."""
    width = float(np.hypot(*(chart[1] - chart[0])))
    gap = float(np.hypot(*(polygon[:, None, :] - chart[None, :, :]).transpose(2, 0, 1)).min())
    near = 1 / (1 + (gap / (_NEAR_CHART_WIDTHS * width)) ** 2)
    size = abs(signed_area(polygon)) / abs(signed_area(chart))
    modest = 1 / (1 + (size / 1.0) ** 2)
    return float(near * modest * np.clip((fill - 0.5) / 0.35, 0, 1))


def overlap(one: Region, other: Region) -> bool:
    """Return whether the bounding boxes of two regions meet: thresholds nest."""
    a0, a1 = one.polygon.min(axis=0), one.polygon.max(axis=0)
    b0, b1 = other.polygon.min(axis=0), other.polygon.max(axis=0)
    return bool((a0 <= b1 + 2).all() and (b0 <= a1 + 2).all())
