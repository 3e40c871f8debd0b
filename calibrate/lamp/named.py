"""A lamp whose place is given: in pixels of the picture, or as seen from the chart."""

from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.chart.geometry import CLASSIC, image_from_chart, project
from calibrate.lamp.expected import ExpectedColour
from calibrate.lamp.reading import Image, Lamp, Mask, Points, Region, read_region
from calibrate.lamp.reflected import doubts_of_mixing

#: Of the lamp's colour from the one expected; one right lamp in 700 is farther off, if errors are normal.
_MOST_SIGMAS: Final = 3.6


def measure_lamp(
    image: Image,
    polygon: Points | None = None,
    *,
    rectangle: tuple[float, float, float, float] | None = None,
    xyz_from_rgb: npt.NDArray[np.float64],
    clipped: Mask | None = None,
    latlong: bool = False,
    expected: ExpectedColour | None = None,
    alone: bool = False,
) -> Lamp:
    """Return the lamp inside a `polygon` [N, 2] or a `rectangle` (x, y, width, height) of `image` [H, W, 3], in pixels.

    The rectangle covers the pixels x … x + width − 1. All of the area counts, so it should lie inside the lamp. `clipped`
    [H, W] marks samples to leave out besides NaN. `expected`, the colour that the camera should
    see, bounds what the lamp may reflect. `alone`: the picture holds the lamp's light and no other.

    Raises
    ------
    CalibrateError
        If the area leaves the image, is too small, dark, or more than 30 % clipped.
    """
    if (polygon is None) == (rectangle is None):
        raise CalibrateError("balance.lamp: give either a polygon or a rectangle (x, y, width, height) in pixels.")
    if rectangle is not None:
        x, y, w, h = rectangle
        polygon = np.array([[x, y], [x + w - 1, y], [x + w - 1, y + h - 1], [x, y + h - 1]], dtype=np.float64)
    area = np.asarray(polygon, dtype=np.float64)
    height, width = image.shape[:2]
    low, high = np.ceil(area.min(axis=0) - 1e-6).astype(int), np.floor(area.max(axis=0) + 1e-6).astype(int)
    beyond = low[1] < 0 or high[1] >= height or (not latlong and (low[0] < 0 or high[0] >= width))
    if beyond or (high < low).any():
        raise CalibrateError(
            f"balance.lamp: the area {area.round(1).tolist()} does not lie inside the image of {width}×{height} pixels; "
            "expected x and y in pixels from the top left. Correct `balance.lamp`, or set it to `auto`."
        )
    y_grid, x_grid = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    sides = np.roll(area, -1, axis=0) - area
    crosses = np.stack(
        [dx * (y_grid - y0) - dy * (x_grid - x0) for (x0, y0), (dx, dy) in zip(area, sides, strict=True)]
    )
    inside: Mask = np.asarray((crosses >= -1e-6).all(axis=0) | (crosses <= 1e-6).all(axis=0))
    region = Region(area, inside, (int(low[0]), int(low[1])), 0.0)
    lamp = read_region(image, region, xyz_from_rgb=xyz_from_rgb, clipped=clipped, latlong=latlong)
    doubts = _another_colour(lamp, expected)
    if not alone:
        doubts += doubts_of_mixing(lamp, xyz_from_rgb, expected)
    return replace(lamp, warnings=(*lamp.warnings, *doubts))


def _another_colour(lamp: Lamp, expected: ExpectedColour | None) -> tuple[str, ...]:
    """A named area is believed to be the lamp; but not without a word if no D65 lamp looks so."""
    if expected is None or not (lamp.rgb > 0).any():
        return ()
    off = expected.ratios(lamp.rgb)
    away = float(np.sqrt(off @ np.linalg.solve(expected.covariance(), off)))
    if away <= _MOST_SIGMAS:
        return ()
    red, blue = np.exp(off)
    return (
        f"balance.lamp: the area that is named has another colour than the lamp can have in this camera: red over green is "
        f"{red:.2f} and blue over green {blue:.2f} times what was expected ({away:.0f} standard deviations; up to {_MOST_SIGMAS:g} is usual). If "
        "it is not the lamp, every colour of the map is wrong: look at the report, correct `balance.lamp`, or set it to `auto`.",
    )


def rectangle_from_chart(rectangle: tuple[float, float, float, float], chart_corners: Points) -> Points:
    """Return the polygon [4, 2] in pixels of a rectangle given in the chart's own coordinates.

    `rectangle` is (x, y, width, height): x and width in units of the width of the chart's box, y and height in its height,
    from its top left; (1.05, 0, 0.1, 1) is a strip at the right of the chart.
    """
    x, y, w, h = rectangle
    if not (np.isfinite(rectangle).all() and w > 0 and h > 0):
        raise CalibrateError(
            f"balance.lamp: rectangle {rectangle} in chart coordinates; expected finite x, y, width, height with positive "
            "width and height. Correct `balance.lamp`."
        )
    corners = np.array([[x, y], [x + w, y], [x + w, y + h], [x, y + h]], dtype=np.float64)
    return project(image_from_chart(chart_corners), corners * np.array(CLASSIC.box))
