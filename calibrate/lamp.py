"""Find and measure the D65 module: a small lamp of known colour that stands in the view beside the chart.

After the chart correction, the light at the chart looks like D65, whatever it was; the module, which does not share
that light, looks as D65 does to an eye adapted to the scene: bluish under a warm light, yellowish under a blue sky.
Which colours that can be is known, the light is not: `adapted_d65_curve` is the curve of D65 as seen from lights of
1800–12000 K. The module is looked for as a region that

- stands out from its surround at one of many thresholds, each a factor of √2 above the last,
- is compact: it fills its smallest rectangle, and is neither tiny nor larger than a few charts,
- has one chromaticity, on or near that curve,
- shines: usually brighter than the chart's white, and than what surrounds it,
- is near the chart.

Each of these is a factor between 0 and 1; their product is the score. No lamp is guessed: below a least score the search is
refused with its remedy, which is to name a rectangle. The reading is the mean over the interior, so edges do not mix.

The module's own deviation from D65 is not corrected here.
"""

import functools
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.adapt import CONE_FROM_XYZ
from calibrate.chart.geometry import BOX_HEIGHT, BOX_WIDTH, image_from_chart, project, signed_area
from calibrate.chart.patches import trimmed_mean
from calibrate.difference import D65_XYZ

Points = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

# Chromaticity distance u'v' at which a region is one sigma from the curve: lamps that are no black bodies, chart
# corrections that are not exact and modules that are not quite D65 each add about 0.01.
_CURVE_SIGMA: Final = 0.015
_FARTHEST_FROM_CURVE: Final = 0.06
# Scatter of u'v' inside the region, ditto; an evenly lit module stays below 0.005.
_EVEN_SIGMA: Final = 0.02
_LEAST_FILL: Final = 0.7
_LEAST_PIXELS: Final = 30
_FEW_PIXELS: Final = 60
_LARGEST_CHARTS: Final = 2.5
_NEAR_CHART_WIDTHS: Final = 2.0
_LEAST_SCORE: Final = 0.02
_CLOSE_RUNNER_UP: Final = 0.5
_MOST_CLIPPED: Final = 0.3
_UNEVEN: Final = 0.01
_LOWEST_LEVEL: Final = 0.35
# Regions examined at one threshold, the largest first; a noisy picture has thousands of specks.
_MOST_REGIONS: Final = 60


@dataclass(frozen=True, slots=True)
class Lamp:
    """A lamp as it reads.

    `rgb` [3] is the mean working RGB over the interior, `noise` [3] its standard error; `polygon` [N, 2] outlines it in pixels
    (x, y), integer = centre (in a lat-long map x is continuous across the seam). `pixels` were used, `clipped` were NaN or
    marked. `score` 0…1 is how much it looks like the module (NaN if it was named), `runner_up` that of the next
    candidate (0 if none). `unevenness` is the scatter of u'v' inside.
    """

    rgb: npt.NDArray[np.float64]
    noise: npt.NDArray[np.float64]
    polygon: Points
    pixels: int
    clipped: int
    score: float
    runner_up: float
    unevenness: float
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _Region:
    polygon: Points
    inside: Mask
    origin: tuple[int, int]
    score: float
    clipped: float


def measure_lamp(
    image: Image,
    polygon: Points | None = None,
    *,
    rectangle: tuple[float, float, float, float] | None = None,
    xyz_from_rgb: npt.NDArray[np.float64],
    clipped: Mask | None = None,
    latlong: bool = False,
) -> Lamp:
    """Return the lamp inside a `polygon` [N, 2] or a `rectangle` (x, y, width, height) of `image` [H, W, 3], in pixels.

    The rectangle covers the pixels x … x + width − 1. All of the area counts, so it should lie inside the lamp. `clipped`
    [H, W] marks samples to leave out besides NaN.

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
    region = _Region(area, inside, (int(low[0]), int(low[1])), float("nan"), 0.0)
    return _read(image, region, xyz_from_rgb=xyz_from_rgb, clipped=clipped, latlong=latlong)


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
    return project(image_from_chart(chart_corners), corners * np.array([BOX_WIDTH, BOX_HEIGHT]))


def find_lamp(
    image: Image,
    *,
    chart_corners: Points,
    xyz_from_rgb: npt.NDArray[np.float64],
    clipped: Mask | None = None,
    latlong: bool = False,
) -> Lamp:
    """Return the D65 module in `image` [H, W, 3], corrected working RGB (1.0 = perfect white at the chart).

    Parameters
    ----------
    chart_corners
        Shape (4, 2), px. The chart itself is left out, and gives the scale of sizes and distances.
    xyz_from_rgb
        Shape (3, 3). The working space.
    clipped
        Shape (H, W). Pixels that are clipped; NaN counts as clipped as well.
    latlong
        x wraps at the image's width.

    Raises
    ------
    CalibrateError
        If nothing looks like the module, or it is clipped in more than 30 % of its pixels.
    """
    chart = np.asarray(chart_corners, dtype=np.float64)
    width = image.shape[1]
    # The chart in the middle of a map, so that the seam is far from what stands beside it.
    shift = round(width / 2 - float(chart[:, 0].mean())) if latlong else 0
    seen = np.roll(image, shift, axis=1) if shift else image
    lost: Mask = np.asarray(~np.isfinite(seen).all(axis=2))
    if clipped is not None:
        lost = lost | np.roll(clipped, shift, axis=1)
    offset = np.array([float(shift), 0.0])
    regions = _regions(seen, lost, chart + offset, np.asarray(xyz_from_rgb, dtype=np.float64))
    usable = [region for region in regions if region.clipped <= _MOST_CLIPPED and region.score >= _LEAST_SCORE]
    spoilt = [region for region in regions if region.clipped > _MOST_CLIPPED and region.score >= _LEAST_SCORE]
    best = max(usable, key=lambda region: region.score, default=None)
    worst = max(spoilt, key=lambda region: region.score, default=None)
    if worst is not None and (best is None or worst.score > best.score):
        x, y = worst.polygon.mean(axis=0) - offset
        raise CalibrateError(
            f"balance.lamp: what looks like the lamp, at ({x:.0f}, {y:.0f}), is clipped in {worst.clipped:.0%} of its pixels; "
            f"at most {_MOST_CLIPPED:.0%} may be. Add a shorter exposure to the bracket, or set `balance.lamp` to a "
            "rectangle on another lamp of known colour."
        )
    if best is None:
        score = max((region.score for region in regions), default=0.0)
        raise CalibrateError(
            "balance.lamp: no region looks like a D65 module (compact, of one colour, on the curve of D65 seen from "
            f"another light, brighter than its surround; best score {score:.3f}, least {_LEAST_SCORE}). Set "
            "`balance.lamp` to a rectangle [x, y, width, height] inside the module."
        )
    runner_up = max((r.score for r in usable if not _overlap(r, best)), default=0.0)
    lamp = _read(seen, best, xyz_from_rgb=xyz_from_rgb, clipped=lost, latlong=False)
    warnings = lamp.warnings
    if runner_up > _CLOSE_RUNNER_UP * best.score:
        other = max((r for r in usable if not _overlap(r, best)), key=lambda region: region.score)
        x, y = other.polygon.mean(axis=0) - offset
        warnings += (
            f"balance.lamp: another region, at ({x:.0f}, {y:.0f}), scores {runner_up:.2f} against {best.score:.2f} of the one "
            "taken. Look at the report; if it is the wrong one, set `balance.lamp` to a rectangle inside the module.",
        )
    return replace(lamp, polygon=lamp.polygon - offset, score=best.score, runner_up=runner_up, warnings=warnings)


@functools.cache
def adapted_d65_curve() -> npt.NDArray[np.float64]:
    """Return u'v' [N, 2] of D65 as it looks after a light of 1800–12000 K has been adapted to D65.

    Planckian radiators below 4000 K (B. Kim et al., US patent 7024034, cubic fits), CIE daylight above; the
    adaptation is CAT16. Spaced by 10 mired.
    """
    mired = np.arange(1e6 / 12000, 1e6 / 1800, 10.0)
    t = 1e6 / mired
    planck_x = -0.2661239e9 / t**3 - 0.2343589e6 / t**2 + 0.8776956e3 / t + 0.179910
    warm, x2, x3 = t < 2222, planck_x**2, planck_x**3
    planck_y = np.where(
        warm,
        -1.1063814 * x3 - 1.34811020 * x2 + 2.18555832 * planck_x - 0.20219683,
        -0.9549476 * x3 - 1.37418593 * x2 + 2.09137015 * planck_x - 0.16748867,
    )
    low = 0.244063 + 0.09911e3 / t + 2.9678e6 / t**2 - 4.6070e9 / t**3
    high = 0.237040 + 0.24748e3 / t + 1.9018e6 / t**2 - 2.0064e9 / t**3
    day_x = np.where(t <= 7000, low, high)
    day_y = -3.0 * day_x**2 + 2.870 * day_x - 0.275
    x, y = np.where(t < 4000, planck_x, day_x), np.where(t < 4000, planck_y, day_y)
    lights = np.stack([x / y, np.ones_like(x), (1 - x - y) / y], axis=-1)
    cones = CONE_FROM_XYZ["CAT16"]
    white = cones @ D65_XYZ
    seen = (white**2 / (lights @ cones.T)) @ np.linalg.inv(cones).T
    curve = _uv(seen)
    curve.setflags(write=False)
    return curve


def _uv(xyz: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """CIE 1976 u'v' [..., 2]."""
    x, y, z = np.moveaxis(xyz, -1, 0)
    total = np.maximum(x + 15 * y + 3 * z, 1e-12)
    return np.stack([4 * x / total, 9 * y / total], axis=-1)


def _regions(image: Image, lost: Mask, chart: Points, xyz_from_rgb: npt.NDArray[np.float64]) -> list[_Region]:
    """Every region that stands out at some threshold, scored."""
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
    found: list[_Region] = []
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
) -> _Region | None:
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
        return _Region(polygon, inside, (x0, y0), 0.5 * shape, clipped)
    xyz = image[part][usable].astype(np.float64) @ xyz_from_rgb.T
    mean = xyz.mean(axis=0)
    if mean[1] <= 0:
        return None
    uv = _uv(mean)
    distance = float(np.hypot(*(adapted_d65_curve() - uv).T).min())
    if distance > _FARTHEST_FROM_CURVE:
        return None
    contrast = mean[1] / max(float(np.median(surround)) if surround.size else 0.0, 1e-6 * mean[1])
    on_curve = np.exp(-0.5 * (distance / _CURVE_SIGMA) ** 2)
    # A neutral region may be paper in the scene's own light; a tinted one on the curve hardly is.
    tinted = 0.4 + 0.6 * min(1.0, float(np.hypot(*(uv - _uv(D65_XYZ)))) / 0.03)
    even = np.exp(-0.5 * (float(_uv(xyz).std(axis=0).max()) / _EVEN_SIGMA) ** 2)
    # A white paper in the light of the chart reads 0.9; from 1.2 on it needs a lamp of its own.
    shining = 1 / (1 + (1.1 / mean[1]) ** 4)
    isolated = np.clip((contrast - 1.05) / 1.0, 0, 1)
    score = on_curve * tinted * even * shining * isolated * _shape_score(fill, polygon, chart)
    return _Region(polygon, inside, (x0, y0), float(score), clipped)


def _shape_score(fill: float, polygon: Points, chart: Points) -> float:
    """How well form, size and place suit a module that stands beside the chart."""
    width = float(np.hypot(*(chart[1] - chart[0])))
    gap = float(np.hypot(*(polygon[:, None, :] - chart[None, :, :]).transpose(2, 0, 1)).min())
    near = 1 / (1 + (gap / (_NEAR_CHART_WIDTHS * width)) ** 2)
    size = abs(signed_area(polygon)) / abs(signed_area(chart))
    modest = 1 / (1 + (size / 1.0) ** 2)
    return float(near * modest * np.clip((fill - 0.5) / 0.35, 0, 1))


def _overlap(one: _Region, other: _Region) -> bool:
    """Whether the bounding boxes of two regions meet: thresholds nest."""
    a0, a1 = one.polygon.min(axis=0), one.polygon.max(axis=0)
    b0, b1 = other.polygon.min(axis=0), other.polygon.max(axis=0)
    return bool((a0 <= b1 + 2).all() and (b0 <= a1 + 2).all())


def _read(
    image: Image,
    region: _Region,
    *,
    xyz_from_rgb: npt.NDArray[np.float64],
    clipped: Mask | None,
    latlong: bool,
) -> Lamp:
    """Mean, standard error and doubts of a region."""
    rows, columns = np.nonzero(region.inside)
    x, y = columns + region.origin[0], rows + region.origin[1]
    if latlong:
        x = x % image.shape[1]
    samples = image[y, x].astype(np.float64)
    valid = np.isfinite(samples).all(axis=1)
    if clipped is not None:
        valid &= ~clipped[y, x]
    lost = int((~valid).sum())
    place = f"balance.lamp: the lamp at ({region.polygon[:, 0].mean():.0f}, {region.polygon[:, 1].mean():.0f})"
    if lost > _MOST_CLIPPED * len(samples):
        raise CalibrateError(
            f"{place} is clipped in {lost} of {len(samples)} pixels; at most {_MOST_CLIPPED:.0%} may be. Add a shorter "
            "exposure to the bracket, or set `balance.lamp` to a rectangle that leaves the clipped part out."
        )
    if valid.sum() < 4:
        raise CalibrateError(
            f"{place} covers {int(valid.sum())} usable pixels; at least 4 are needed, 60 are good. Enlarge the rectangle in "
            "`balance.lamp`, or photograph the module larger."
        )
    statistics = [trimmed_mean(samples[valid, channel]) for channel in range(3)]
    rgb = np.array([mean for mean, _, _ in statistics])
    noise = np.array([deviation / np.sqrt(count) for _, deviation, count in statistics])
    xyz = samples[valid] @ np.asarray(xyz_from_rgb, dtype=np.float64).T
    if (rgb @ np.asarray(xyz_from_rgb, dtype=np.float64).T <= 0).any():
        raise CalibrateError(
            f"{place} reads {rgb.round(5).tolist()}, which is no light; expected positive XYZ. Point `balance.lamp` at the "
            "module."
        )
    # Noise makes single pixels differ; what counts is whether one part of the lamp differs from another.
    unevenness = float(_uv(xyz).std(axis=0).max())
    warnings: tuple[str, ...] = ()
    if valid.sum() < _FEW_PIXELS:
        warnings += (f"{place} has only {int(valid.sum())} pixels inside. Photograph the module larger.",)
    if lost:
        warnings += (f"{place} has {lost} clipped pixels, left out. Add a shorter exposure to the bracket.",)
    if unevenness > _UNEVEN:
        warnings += (
            f"{place} is not of one colour: u'v' scatters by {unevenness:.3f}, more than {_UNEVEN}. Check that the area "
            "lies inside the module, and that the module is diffused.",
        )
    return Lamp(
        rgb=rgb,
        noise=noise,
        polygon=region.polygon,
        pixels=int(valid.sum()),
        clipped=lost,
        score=float("nan"),
        runner_up=0.0,
        unevenness=unevenness,
        warnings=warnings,
    )
