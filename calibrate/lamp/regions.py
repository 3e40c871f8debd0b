"""The regions of a picture that stand out at some threshold: candidates for the lamp."""

from dataclasses import replace
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate.chart.geometry import signed_area
from calibrate.lamp.candidate import LEAST_PIXELS, Candidate, measured
from calibrate.lamp.curve import uv_from_xyz
from calibrate.lamp.reading import Image, Mask, Points, Region

_LARGEST_CHARTS: Final = 2.5
# Panes of one window and tubes of one luminaire differ by less in u'v' and in the logarithm of luminance.
_SAME_COLOUR: Final = 0.004
_SAME_LEVEL: Final = 0.15
# … and in the logarithm of each side: something may stand before one of them.
_SAME_SIZE: Final = 0.5
_LOWEST_LEVEL: Final = 0.35
# Regions examined at one threshold, the largest first; a noisy picture has thousands of specks.
_MOST_REGIONS: Final = 60
# Neighbouring thresholds at which a region of a sharp edge keeps its area, as far as its contrast reaches.
_SAME_AREA: Final = 0.8


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
        fits = (areas >= LEAST_PIXELS) & (areas <= _LARGEST_CHARTS * chart_area)
        fits[0] = False
        for label in sorted(np.flatnonzero(fits[:count]), key=lambda i: -areas[i])[:_MOST_REGIONS]:
            x, y, w, h = (int(v) for v in stats[label, :4])
            pad = 4
            x0, y0 = max(x - pad, 0), max(y - pad, 0)
            part = (slice(y0, y + h + pad), slice(x0, x + w + pad))
            own = np.asarray(labels[part] == label, np.uint8)
            found = measured(
                image, luminance, own, level=float(level), lost=lost, part=part, chart=chart, xyz_from_rgb=xyz_from_rgb
            )
            if found is not None:
                seen.append((found, step, float(areas[label])))
    return _alone(_steady(seen))


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


def _alone(found: list[Candidate]) -> list[Candidate]:
    """Count of each candidate the others of its colour, brightness and size, as panes of a window are to one another."""
    lit = [one for one in found if not one.rim]
    if not lit:
        return found
    xyz = np.array([one.xyz for one in lit])
    uv, level = uv_from_xyz(xyz), np.log(xyz[:, 1])
    low = np.array([one.region.polygon.min(axis=0) for one in lit])
    high = np.array([one.region.polygon.max(axis=0) for one in lit])
    sides = np.log([[one.thick, one.long] for one in lit])
    out = [one for one in found if one.rim]
    for n, one in enumerate(lit):
        like = (np.hypot(*(uv - uv[n]).T) < _SAME_COLOUR) & (np.abs(level - level[n]) < _SAME_LEVEL)
        like &= (np.abs(sides - sides[n]) < _SAME_SIZE).all(axis=1) & ((low > high[n] + 2) | (high < low[n] - 2)).any(
            axis=1
        )
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
    high = np.minimum(np.array(one.origin) + one.inside.shape[::-1], np.array(other.origin) + other.inside.shape[::-1])
    if (high <= low).any():
        return False
    cuts = []
    for region in (one, other):
        a, b = low - region.origin, high - region.origin
        cuts.append(region.inside[a[1] : b[1], a[0] : b[0]])
    return bool((cuts[0] & cuts[1]).any())
