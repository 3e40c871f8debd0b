"""A region of a picture that may be the lamp, and what of it may tell a lamp from other things."""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate.chart.geometry import CLASSIC
from calibrate.lamp.curve import uv_from_xyz
from calibrate.lamp.reading import Image, Mask, Points, Region

_LEAST_FILL: Final = 0.7
LEAST_PIXELS: Final = 30
# With a rim of two pixels left out, what blur and demosaicing mix is left out, if as many pixels remain.
_ENOUGH_PIXELS: Final = 60
_PARTS: Final = 16


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A region that stands out, and what was measured of it.

    `gap`, `thick` and `long` are in widths of the chart: its distance from the chart, its short and its long side; `fill` is its share of
    its smallest rectangle or of the ellipse in that. `rgb` and `xyz` [3] are means over what is not clipped, chart white 1; with
    `rim`, over its brightest rim, since all else is clipped. `contrast` is how many times as bright as its surround it is,
    `steady` the share of the thresholds in that contrast at which it keeps its area; `tints` and `levels` the scatter between
    its parts, of u'v' and of the logarithm of luminance, beyond their noise; `alike` the number of others of its
    colour, brightness and size; `border`: the picture's border cuts it. `level`: the luminance that all of it exceeds.
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
    level: float
    alike: int = 0


def measured(
    image: Image,
    luminance: npt.NDArray[np.float32],
    own: npt.NDArray[np.uint8],
    *,
    level: float,
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
    if inside.sum() < LEAST_PIXELS:
        return None
    polygon = cv2.boxPoints(rectangle).astype(np.float64) + np.array([float(x0), float(y0)])
    ring = (cv2.dilate(own, np.ones((7, 7), np.uint8)) > 0) & ~(cv2.dilate(own, np.ones((3, 3), np.uint8)) > 0)
    surround = luminance[part][ring & ~lost[part]]
    usable = inside & ~lost[part]
    rim = usable.sum() < LEAST_PIXELS
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
    scale = chart_width(chart)
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
        level=level,
    )


def chart_width(chart: Points) -> float:
    """Return the width in pixels that a chart with these corners [4, 2] would have face on, by its less foreshortened sides."""
    across = np.hypot(*(chart[1] - chart[0])) + np.hypot(*(chart[2] - chart[3]))
    down = np.hypot(*(chart[3] - chart[0])) + np.hypot(*(chart[2] - chart[1]))
    return float(max(across, down * CLASSIC.box[0] / CLASSIC.box[1])) / 2


def _interior(own: npt.NDArray[np.uint8]) -> Mask:
    """The region without a rim of two pixels, or of one where little would be left."""
    inner = cv2.erode(own, np.ones((5, 5), np.uint8)) > 0
    return np.asarray(inner if inner.sum() >= _ENOUGH_PIXELS else cv2.erode(own, np.ones((3, 3), np.uint8)) > 0)


def _scatter(
    rgb: npt.NDArray[np.float64], usable: Mask, angle_deg: float, xyz_from_rgb: npt.NDArray[np.float64]
) -> tuple[float, float]:
    """Scatter of u'v' and of log luminance between the parts of a region, without what noise makes of them.

    The parts are slices of the region's long side, each in two halves, of like numbers of pixels: a thin strip has no rows to
    spare.
    """
    rows, columns = np.nonzero(usable)
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    axes = np.stack([c * columns + s * rows, -s * columns + c * rows])
    along, across = axes if np.ptp(axes[0]) >= np.ptp(axes[1]) else axes[::-1]
    count = len(rows)
    slices = np.argsort(np.argsort(along, kind="stable"), kind="stable") * (_PARTS // 2) // count
    cells = 2 * slices + (across > np.median(across))
    number = np.bincount(cells, minlength=_PARTS)
    large = number >= max(1, count // (4 * _PARTS))
    samples = rgb[rows, columns] @ xyz_from_rgb.T
    means, squares = (
        np.stack([np.bincount(cells, weights=samples[:, k] ** power, minlength=_PARTS) for k in range(3)], axis=1)[
            large
        ]
        / number[large, None]
        for power in (1, 2)
    )
    if (means <= 0).any():
        return 1.0, 1.0
    weight = number[large].astype(np.float64)
    # The noise of a part's mean, from what its pixels scatter about it.
    variance = np.maximum(squares - means**2, 0) / weight[:, None]
    uv, level = uv_from_xyz(means), np.log(means[:, 1:2])
    noise, noise_level = np.zeros(len(means)), variance[:, 1] / means[:, 1] ** 2
    for k in range(3):
        step = np.where(np.arange(3) == k, 0.001 * means, 0.0)
        slope = (uv_from_xyz(means + step) - uv) / step[:, k : k + 1]
        noise += (slope**2).sum(axis=1) * variance[:, k]
    return _beyond(uv, noise, weight), _beyond(level, noise_level, weight)


def _beyond(values: Points, noise: npt.NDArray[np.float64], weight: npt.NDArray[np.float64]) -> float:
    """Standard deviation of values [N, K] about their mean, less the variance [N] that noise gives them."""
    squared = ((values - np.average(values, axis=0, weights=weight)) ** 2).sum(axis=1)
    return float(np.sqrt(max(float(np.average(squared - noise, weights=weight)), 0.0)))


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
