"""Drawing a chart's box to its patches.

First by the middles of the flat zones that its patches are. Where the picture is sharp enough, then by its edges:
The chart is flattened with the box at hand and compared with a drawing of itself: patches of the levels just read, dark
gaps between them. The homography that makes both agree best (G. D. Evangelidis and E. Z. Psarakis, "Parametric Image
Alignment Using Enhanced Correlation Coefficient Maximization", 2008), coarsely first, corrects the box to a fraction
of a pixel; a detector's box is off by a tenth of a patch or two.
"""

from collections.abc import Iterator
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate.chart.geometry import (
    BOX_HEIGHT,
    BOX_WIDTH,
    PATCH_WIDTH,
    box_corners,
    image_from_chart,
    patch_quads,
    project,
    signed_area,
)
from calibrate.chart.judge import glance, unevenness
from calibrate.chart.lattice import refined
from calibrate.chart.zones import flat_zones, relative_logarithm

# Pixels a chart unit in the two flattened charts: a patch is 10, then 20 pixels wide.
_UNITS_PX: Final = (4, 8)
# Where the given box was good already, both scatter by noise alone.
_SCATTER_ALLOWED: Final = 1.05
# By so much must a later way make the patches scatter less than an earlier one.
_GAIN: Final = 0.95
# Size of a patch in the picture whose zones are looked at, and how far it is enlarged for that.
_SNAPPED_PATCH_PX: Final = 36.0
_LARGEST_ZOOM: Final = 4.0
# How much of its place a patch fills: the Classic, then smaller editions, whose gaps are wider.
_PATCH_PARTS: Final = (1.0, 0.86)
# The part of the frame that is compared too, in chart units; the dark frame of every edition reaches farther.
_MARGIN: Final = 0.75
# Half a patch is farther than a detector errs; a warp that far has slipped to a neighbour. In chart units.
_FARTHEST: Final = 1.25


def align(image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64]) -> npt.NDArray[np.float64] | None:
    """Return the corners [4, 2] for which the patches are where the box says.

    First the middles of the flat zones (`refined`), then the drawing; each is taken where patches scatter less than before.
    None if neither finds the patches.
    """
    own = signed_area(corners) < 0
    box = corners[::-1] if own else corners
    best, scatter = box, unevenness(image, box)
    found = False
    # In the order of trust: what comes later must be clearly better. Noise and the freedom to shift within the gaps make
    # the scatter a poor judge of small differences.
    for moved in _snapped(image, box):
        spread = unevenness(image, moved)
        if spread < (_GAIN if found else _SCATTER_ALLOWED) * scatter:
            best, scatter, found = moved, spread, True
    drawn = _drawn(image, best)
    if drawn is not None:
        spread = unevenness(image, drawn)
        if spread < (_GAIN if found else _SCATTER_ALLOWED) * scatter:
            best, found = drawn, True
    if not found:
        return None
    return best[::-1] if own else best


def _snapped(image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64]) -> Iterator[npt.NDArray[np.float64]]:
    """Yield boxes through the middles of the flat zones: of all thresholds, then of each."""
    part, local, offset = _cropped(image, corners)
    patch_px = np.sqrt(abs(signed_area(corners)) / (BOX_WIDTH * BOX_HEIGHT)) * PATCH_WIDTH
    zoom = min(_LARGEST_ZOOM, _SNAPPED_PATCH_PX / patch_px)
    seen = relative_logarithm(part)
    method = cv2.INTER_AREA if zoom < 1 else cv2.INTER_CUBIC
    seen = np.asarray(cv2.resize(seen, None, fx=zoom, fy=zoom, interpolation=method), dtype=np.float32)
    area = (patch_px * zoom) ** 2
    zones = flat_zones(seen, smallest=0.02 * area, largest=4 * area)
    zoomed = (local + 0.5) * zoom - 0.5
    for several in (zones, *([one] for one in zones)):
        moved = refined(zoomed, several)
        if moved is not zoomed:
            yield (moved + 0.5) / zoom - 0.5 + offset


def _drawn(image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64]) -> npt.NDArray[np.float64] | None:
    """Return the corners for which a drawing of the chart covers the chart best; None if that slips or fails."""
    limit = _FARTHEST * np.sqrt(abs(signed_area(corners)) / (BOX_WIDTH * BOX_HEIGHT))
    scatter = unevenness(image, corners)
    for part in _PATCH_PARTS:
        aligned: npt.NDArray[np.float64] | None = corners
        for unit in _UNITS_PX:
            if aligned is not None:
                aligned = _aligned_once(image, aligned, unit, part)
        if aligned is None or np.abs(aligned - corners).max() > limit:
            continue
        if unevenness(image, aligned) <= _SCATTER_ALLOWED * scatter:
            return aligned
    return None


def _aligned_once(
    image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64], unit: int, part: float
) -> npt.NDArray[np.float64] | None:
    levels = glance(image, corners).sum(axis=1)
    if not np.isfinite(levels).all():
        return None
    size = (round((BOX_WIDTH + 2 * _MARGIN) * unit), round((BOX_HEIGHT + 2 * _MARGIN) * unit))
    # Flattened pixel (x, y), integer = centre, shows the chart at ((x + ½)/unit − margin, …).
    chart_from_flat = np.array([[1 / unit, 0, 0.5 / unit - _MARGIN], [0, 1 / unit, 0.5 / unit - _MARGIN], [0, 0, 1]])
    image, corners, offset = _cropped(image, corners)
    image_from_flat = image_from_chart(corners) @ chart_from_flat
    image_px_per_unit = np.sqrt(abs(signed_area(corners)) / (BOX_WIDTH * BOX_HEIGHT))
    if image_px_per_unit > 1.5 * unit:
        # Around lost pixels the blur is that of the others alone.
        known: npt.NDArray[np.float32] = np.asarray(np.isfinite(image).all(axis=2), dtype=np.float32)
        weight = cv2.GaussianBlur(known, (0, 0), 0.35 * image_px_per_unit / unit)
        blurred = cv2.GaussianBlur(np.where(known[..., None] > 0, image, 0), (0, 0), 0.35 * image_px_per_unit / unit)
        image = np.where(weight[..., None] > 0.3, blurred / np.maximum(weight, 0.3)[..., None], np.float32(np.nan))
    flat = cv2.warpPerspective(
        image,
        image_from_flat,
        size,
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(np.nan, np.nan, np.nan, np.nan),
    )
    white = max(float(levels.max()), 1e-12)
    valid = np.isfinite(flat).all(axis=2).astype(np.uint8)
    grey = np.cbrt(np.clip(np.nan_to_num(flat.sum(axis=2)) / white, 0, 1.5)).astype(np.float32)
    drawing = _drawing(
        np.cbrt(np.clip(levels / white, 0, 1.5)), unit, size, part=part, blur=0.6 * unit / image_px_per_unit
    )
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-6)
    try:
        _, warp = cv2.findTransformECC(
            drawing, grey, np.eye(3, dtype=np.float32), cv2.MOTION_HOMOGRAPHY, criteria, valid, 3
        )
    except cv2.error:  # it did not converge
        return None
    flat_from_chart = np.linalg.inv(chart_from_flat)
    moved = project(image_from_flat @ warp.astype(np.float64) @ flat_from_chart, box_corners())
    return moved + offset if np.isfinite(moved).all() else None


def _cropped(
    image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """The part of the image around the box, the corners in it, and where it was cut out (x, y)."""
    height, width = image.shape[:2]
    low, high = corners.min(axis=0), corners.max(axis=0)
    border = 0.2 * (high - low) + 4
    x0, y0 = np.clip((low - border).astype(int), 0, [width - 1, height - 1])
    x1, y1 = np.clip((high + border).astype(int) + 1, [x0 + 1, y0 + 1], [width, height])
    offset = np.array([x0, y0], dtype=np.float64)
    return np.ascontiguousarray(image[y0:y1, x0:x1]), corners - offset, offset


def _drawing(
    levels: npt.NDArray[np.float64], unit: int, size: tuple[int, int], *, part: float, blur: float
) -> npt.NDArray[np.float32]:
    """The flattened chart as it should look: `levels` [24] on a dark ground, as blurred as the photograph's pixels are."""
    drawing = np.full(size[::-1], 0.8 * float(levels.min()), dtype=np.float32)
    for quad, level in zip(patch_quads(part), levels, strict=True):
        (left, top), (right, bottom) = ((quad[[0, 2]] + _MARGIN) * unit).round().astype(int)
        drawing[top:bottom, left:right] = level
    return np.asarray(cv2.GaussianBlur(drawing, (0, 0), max(blur, 0.6)), dtype=np.float32)
