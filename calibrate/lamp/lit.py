"""The lamp in its own light: the brightest region of the difference between lamp on and lamp off."""

from dataclasses import replace
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.lamp.pair import LampAlone
from calibrate.lamp.reading import Image, Lamp, Points, Region, read_region

# A pixel of the lamp stands out by this many of its standard deviations; regions from this share of the peak on are the lamp.
_LEAST_SIGNIFICANCE: Final = 8.0
_OF_PEAK: Final = 0.4
_LEAST_PIXELS: Final = 9
_SECOND_AREA: Final = 0.25


def find_lit_lamp(
    alone: LampAlone,
    working: Image,
    *,
    xyz_from_rgb: npt.NDArray[np.float64],
    latlong: bool = False,
) -> Lamp:
    """Return the lamp as it reads in its own light: the brightest region of the difference.

    `working` [H, W, 3] is `alone.light` in working RGB. What the lamp lights is darker than the lamp, so nothing need be known of its
    colour, form or place.

    Raises
    ------
    CalibrateError
        If nothing lights up, or the lamp is too dim, too small or clipped.
    """
    calm, peak = _lit(alone)
    width = working.shape[1]
    shift = width // 2 - int(np.unravel_index(np.argmax(calm), calm.shape)[1]) if latlong else 0
    region, area, second = _brightest_region(np.roll(calm > _OF_PEAK * peak, shift, axis=1).astype(np.uint8))
    lamp = read_region(
        np.roll(working, shift, axis=1),
        region,
        xyz_from_rgb=xyz_from_rgb,
        clipped=np.roll(alone.clipped, shift, axis=1),
        latlong=False,
    )
    warnings = lamp.warnings
    if second > max(_SECOND_AREA * area, 4 * _LEAST_PIXELS):
        warnings += (
            f"capture.lamp_off: another region of {second} pixels lights up as well, beside the {area} taken. If it is "
            "no reflection, switch only the module, or set `balance.lamp` to a rectangle inside it.",
        )
    return replace(lamp, polygon=lamp.polygon - np.array([float(shift), 0.0]), score=1.0, warnings=warnings)


def _lit(alone: LampAlone) -> tuple[Image, float]:
    """Green of the difference [H, W] without single photosites, which are no lamp, and its peak where it is not clipped."""
    largest = np.finfo(np.float32).max
    green = np.where(alone.clipped, largest, np.nan_to_num(alone.light[..., 1]))
    noise = np.nan_to_num(alone.sigma[..., 1], nan=np.inf)
    calm = np.asarray(cv2.medianBlur(np.asarray(green, np.float32), 3), np.float32)
    known = np.isfinite(noise) & (calm < largest)
    significance = float((calm[known] / np.maximum(noise[known], 1e-30)).max(initial=0.0))
    if not alone.clipped.any() and significance < _LEAST_SIGNIFICANCE:
        raise CalibrateError(
            f"capture.lamp_off: nothing lights up between the brackets: the brightest difference is {significance:.1f} standard deviations "
            f"of its noise; expected at least {_LEAST_SIGNIFICANCE:.0f}. Check that the lamp is on in `capture.reference` and off in "
            "`capture.lamp_off`, or expose longer."
        )
    return calm, float(calm[known].max(initial=0.0))


def _brightest_region(bright: npt.NDArray[np.uint8]) -> tuple[Region, int, int]:
    """The largest region of a mask [H, W] without its rim, its area in pixels, and that of the next largest."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(bright, connectivity=8)
    areas = stats[1:count, cv2.CC_STAT_AREA]
    label = 1 + int(np.argmax(areas))
    own = np.asarray(labels == label, np.uint8)
    inside = cv2.erode(own, np.ones((3, 3), np.uint8))
    if cv2.erode(own, np.ones((9, 9), np.uint8)).any():
        inside = cv2.erode(own, np.ones((5, 5), np.uint8))
    if inside.sum() < _LEAST_PIXELS:
        raise CalibrateError(
            f"capture.lamp_off: what lights up covers {int(inside.sum())} pixels without its rim; at least {_LEAST_PIXELS} are needed, "
            "60 are good. Photograph the module larger."
        )
    x, y, w, h = (int(v) for v in stats[label, :4])
    contour = max(cv2.findContours(own, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0], key=len)
    polygon: Points = cv2.boxPoints(cv2.minAreaRect(contour)).astype(np.float64)
    region = Region(polygon, inside[y : y + h, x : x + w] > 0, (x, y), 0.0)
    return region, int(areas[label - 1]), int(np.delete(areas, label - 1).max(initial=0))
