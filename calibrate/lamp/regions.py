"""Regions of a picture that stand out at some threshold, and what of each may tell a lamp from other things."""

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate.chart.geometry import BOX_HEIGHT, BOX_WIDTH, signed_area
from calibrate.lamp.curve import uv_from_xyz
from calibrate.lamp.reading import Image, Mask, Points, Region

_LEAST_FILL: Final = 0.7
_LEAST_PIXELS: Final = 30
# With a rim of two pixels left out, what blur and demosaicing mix is left out, if as many pixels remain.
_ENOUGH_PIXELS: Final = 60
_LARGEST_CHARTS: Final = 2.5
# Panes of one window and tubes of one luminaire differ by less in u'v' and in the logarithm of luminance.
_SAME_COLOUR: Final = 0.004
_SAME_LEVEL: Final = 0.15
_LOWEST_LEVEL: Final = 0.35
# Regions examined at one threshold, the largest first; a noisy picture has thousands of specks.
_MOST_REGIONS: Final = 60
# Neighbouring thresholds at which a region of a sharp edge keeps its area, as far as its contrast reaches.
_SAME_AREA: Final = 0.8
_PARTS: Final = 16


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A region that stands out, and what was measured of it.

    `gap`, `thick` and `long` are in widths of the chart: its distance from the chart, its short and its long side; `fill` is its share of
    its smallest rectangle or of the ellipse in that. `rgb` and `xyz` [3] are means over what is not clipped, chart white 1; with
    `rim`, over its brightest rim, since all else is clipped. `contrast` is how many times as bright as its surround it is,
    `steady` the share of the thresholds in that contrast at which it keeps its area; `tints` and `levels` the scatter between
    its parts, of u'v' and of the logarithm of luminance, beyond their noise; `alike` the number of others of its colour
    and brightness; `border`: the picture's border cuts it.
    """

    region: Region
    gap: float
    thick: float
    long: float
    fill: float
    border: bool
    rgb: Points
    xyz: Points
    rim: bool
    contrast: float
    steady: float
    tints: float
    levels: float
    alike: int = 0


def candidates(image: Image, lost: Mask, chart: Points, xyz_from_rgb: npt.NDArray[np.float64]) -> list[Candidate]:
    """Return every region that stands out at thresholds a factor √2 apart; the chart itself is left out."""
    luminance = cv2.transform(np.nan_to_num(image), xyz_from_rgb[1:2])
    luminance = luminance.reshape(image.shape[:2])
    # A lost pixel is taken as brighter than everything: where most are lost, the region is refused, not overlooked.
    brightest = float(luminance[~lost].max(initial=0.0))
    luminance = np.where(lost, np.float32(2 * max(brightest, 1.0)), luminance)
    covered = np.zeros(luminance.shape, dtype=np.uint8)
    centre = chart.mean(axis=0)
    cv2.fillConvexPoly(covered, np.round(centre + 1.02 * (chart - centre)).astype(np.int32), 1)
    luminance[covered > 0] = 0

    chart_area = abs(signed_area(chart))
    steps = max(1, int(2 * np.log2(max(brightest, 1.0) / _LOWEST_LEVEL)) + 1)
    seen: list[tuple[Candidate, int, float]] = []
    for step, level in enumerate(_LOWEST_LEVEL * np.sqrt(2.0) ** np.arange(steps)):
        count, labels, stats, _ = cv2.connectedComponentsWithStats((luminance > level).astype(np.uint8), connectivity=4)
        areas = stats[:, cv2.CC_STAT_AREA]
        fits = (areas >= _LEAST_PIXELS) & (areas <= _LARGEST_CHARTS * chart_area)
        fits[0] = False
        for label in sorted(np.flatnonzero(fits[:count]), key=lambda i: -areas[i])[:_MOST_REGIONS]:
            x, y, w, h = (int(v) for v in stats[label, :4])
            pad = 4
            x0, y0 = max(x - pad, 0), max(y - pad, 0)
            part = (slice(y0, y + h + pad), slice(x0, x + w + pad))
            own = np.asarray(labels[part] == label, np.uint8)
            found = _measured(image, luminance, own, lost=lost, part=part, chart=chart, xyz_from_rgb=xyz_from_rgb)
            if found is not None:
                seen.append((found, step, float(areas[label])))
    return _alone(_steady(seen))


def _measured(
    image: Image,
    luminance: npt.NDArray[np.float32],
    own: npt.NDArray[np.uint8],
    *,
    lost: Mask,
    part: tuple[slice, slice],
    chart: Points,
    xyz_from_rgb: npt.NDArray[np.float64],
) -> Candidate | None:
    """Measure the region `own`, cut out as `part`; None if it is too ragged or too small."""
    y0, x0 = part[0].start, part[1].start
    height, width = luminance.shape
    contour = max(cv2.findContours(own, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0], key=len)
    rectangle = cv2.minAreaRect(contour)
    # A contour runs through pixel centres, so the region is one pixel wider and higher than its rectangle.
    (rw, rh), filled = rectangle[1], int(own.sum())
    fill = filled / ((rw + 1) * (rh + 1))
    if fill < _LEAST_FILL:
        return None
    inside = _interior(own)
    if inside.sum() < _LEAST_PIXELS:
        return None
    polygon = cv2.boxPoints(rectangle).astype(np.float64) + np.array([float(x0), float(y0)])
    ring = (cv2.dilate(own, np.ones((7, 7), np.uint8)) > 0) & ~(cv2.dilate(own, np.ones((3, 3), np.uint8)) > 0)
    surround = luminance[part][ring & ~lost[part]]
    usable = inside & ~lost[part]
    rim = usable.sum() < _LEAST_PIXELS
    rgb_of = image[part].astype(np.float64)
    if rim:
        # Beside a clipped core only its rim is left, in which it outshines what it is mixed with.
        near = cv2.dilate(own, np.ones((5, 5), np.uint8)) > 0
        usable = near & ~lost[part]
        if not usable.any():
            return None
        usable &= luminance[part] >= np.quantile(luminance[part][usable], 0.8)
    samples = rgb_of[usable]
    rgb = samples.mean(axis=0)
    xyz = np.asarray(xyz_from_rgb, np.float64) @ rgb
    if (xyz <= 0).any():
        return None
    tints, levels = (0.0, 0.0) if rim else _scatter(rgb_of, usable, rectangle[2], xyz_from_rgb)
    around = float(np.median(surround)) if surround.size else 0.0
    scale = max(
        (np.hypot(*(chart[1] - chart[0])) + np.hypot(*(chart[2] - chart[3]))) / 2,
        (np.hypot(*(chart[3] - chart[0])) + np.hypot(*(chart[2] - chart[1]))) / 2 * BOX_WIDTH / BOX_HEIGHT,
    )
    border = polygon.min() < 1 or (polygon.max(axis=0) > np.array([width, height]) - 2).any()
    return Candidate(
        Region(polygon, inside, (x0, y0), float(lost[part][inside].mean())),
        gap=max(_gap(polygon, chart), 0.0) / scale,
        thick=(min(rw, rh) + 1) / scale,
        long=(max(rw, rh) + 1) / scale,
        fill=min(1.0, max(fill, 1.0 - abs(fill / (np.pi / 4) - 1))),
        border=bool(border),
        rgb=rgb,
        xyz=xyz,
        rim=bool(rim),
        contrast=float(xyz[1]) / max(around, 1e-6 * float(xyz[1])),
        steady=0.0,
        tints=tints,
        levels=levels,
    )


def _interior(own: npt.NDArray[np.uint8]) -> Mask:
    """The region without a rim of two pixels, or of one where little would be left."""
    inner = cv2.erode(own, np.ones((5, 5), np.uint8)) > 0
    return np.asarray(inner if inner.sum() >= _ENOUGH_PIXELS else cv2.erode(own, np.ones((3, 3), np.uint8)) > 0)


def _scatter(
    rgb: npt.NDArray[np.float64], usable: Mask, angle_deg: float, xyz_from_rgb: npt.NDArray[np.float64]
) -> tuple[float, float]:
    """Scatter of u'v' and of log luminance between the parts of a region, without what noise makes of them.

    The parts are slices across the region's long side and halves along it, of like numbers of pixels each: a thin strip has no rows to spare.
    """
    rows, columns = np.nonzero(usable)
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    axes = np.stack([c * columns + s * rows, -s * columns + c * rows])
    along, across = axes if np.ptp(axes[0]) >= np.ptp(axes[1]) else axes[::-1]
    count = len(rows)
    slices = np.argsort(np.argsort(along, kind="stable"), kind="stable") * (_PARTS // 2) // count
    halves = across > np.median(across)
    cells = 2 * slices + halves
    number = np.bincount(cells, minlength=_PARTS)
    large = number >= max(1, count // (4 * _PARTS))
    samples = rgb[rows, columns] @ xyz_from_rgb.T
    parts = np.stack([np.bincount(cells, weights=samples[:, k], minlength=_PARTS) for k in range(3)], axis=1)[large]
    weight = number[large].astype(np.float64)
    parts /= weight[:, None]
    # The noise of a part's mean, from what its pixels scatter about it.
    within = np.stack([np.bincount(cells, weights=samples[:, k] ** 2, minlength=_PARTS) for k in range(3)], axis=1)[large]
    variance = np.maximum(within / weight[:, None] - parts**2, 0) / weight[:, None]
    if (parts <= 0).any():
        return 1.0, 1.0
    uv = uv_from_xyz(parts)
    slopes = [(uv_from_xyz(parts * np.where(np.arange(3) == k, 1.001, 1.0)) - uv) / (0.001 * parts[:, k : k + 1]) for k in range(3)]
    noise = sum(float(np.average((slope**2).sum(axis=1) * variance[:, k], weights=weight)) for k, slope in enumerate(slopes))
    spread = np.average((uv - np.average(uv, axis=0, weights=weight)) ** 2, axis=0, weights=weight).sum()
    level = np.log(parts[:, 1])
    spread_level = np.average((level - np.average(level, weights=weight)) ** 2, weights=weight)
    noise_level = np.average(variance[:, 1] / parts[:, 1] ** 2, weights=weight)
    return float(np.sqrt(max(spread - noise, 0.0))), float(np.sqrt(max(spread_level - noise_level, 0.0)))


def _steady(seen: list[tuple[Candidate, int, float]]) -> list[Candidate]:
    """Tell of each candidate at how many of the thresholds within its contrast it keeps its area."""
    out = []
    for one, step, area in seen:
        centre = one.region.polygon.mean(axis=0)
        same = {
            other_step
            for other, other_step, other_area in seen
            if min(area, other_area) > _SAME_AREA * max(area, other_area)
            and np.hypot(*(other.region.polygon.mean(axis=0) - centre)) < 0.25 * np.sqrt(area)
        } | {step}
        reach = max(1.0, 2 * np.log2(min(one.contrast, float(one.xyz[1]) / _LOWEST_LEVEL)))
        out.append(replace(one, steady=min(1.0, len(same) / reach)))
    return out


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


def _alone(found: list[Candidate]) -> list[Candidate]:
    """Count of each candidate the others of its colour and brightness, as panes of a window are to one another."""
    lit = [one for one in found if not one.rim]
    if not lit:
        return found
    xyz = np.array([one.xyz for one in lit])
    uv, level = uv_from_xyz(xyz), np.log(xyz[:, 1])
    low = np.array([one.region.polygon.min(axis=0) for one in lit])
    high = np.array([one.region.polygon.max(axis=0) for one in lit])
    area = np.array([one.thick * one.long for one in lit])
    out = [one for one in found if one.rim]
    for n, one in enumerate(lit):
        like = (np.hypot(*(uv - uv[n]).T) < _SAME_COLOUR) & (np.abs(level - level[n]) < _SAME_LEVEL)
        like &= (area > 0.2 * area[n]) & ((low > high[n] + 2) | (high < low[n] - 2)).any(axis=1)
        # Thresholds nest: regions that overlap are one.
        others: list[int] = []
        for k in np.flatnonzero(like):
            if all(((low[k] > high[m] + 2) | (high[k] < low[m] - 2)).any() for m in others):
                others.append(int(k))
        out.append(replace(one, alike=len(others)))
    return out


def overlap(one: Region, other: Region) -> bool:
    """Return whether two regions share a pixel of their insides: thresholds nest."""
    low = np.maximum(one.origin, other.origin)
    high = np.minimum(
        np.array(one.origin) + one.inside.shape[::-1], np.array(other.origin) + other.inside.shape[::-1]
    )
    if (high <= low).any():
        return False
    cuts = []
    for region in (one, other):
        a, b = low - region.origin, high - region.origin
        cuts.append(region.inside[a[1] : b[1], a[0] : b[0]])
    return bool((cuts[0] & cuts[1]).any())
