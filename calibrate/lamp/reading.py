"""What a lamp reads: the mean over its interior, its standard error, and doubts about it."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.chart.geometry import CLASSIC, image_from_chart, project
from calibrate.chart.patches import trimmed_mean
from calibrate.difference import D65_XYZ
from calibrate.lamp.curve import uv_from_xyz

Points = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

MOST_CLIPPED: Final = 0.3
# Of the light on the chart, what an unlit module may reflect: opal covers and white circuit boards about this.
MOST_REFLECTED: Final = 0.7
_FEW_PIXELS: Final = 60
_FEWEST_PIXELS: Final = 4
# Scatter of u'v' inside a lamp, of one channel's noise or so; an evenly lit module stays below 0.005.
_UNEVEN: Final = 0.01
# Relative standard error of the reading in its worst channel.
_NOISY: Final = 0.01
_TOO_NOISY: Final = 0.05
# Error of u'v' by reflected light: a tenth of the way from D65 to the colour of tungsten light.
_MIXED: Final = 0.01


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
class Region:
    """An area of an image: its outline, the pixels `inside` a box whose first pixel is `origin` (x, y), a score, how much
    of it is clipped, and its mean XYZ where anything of it is not.
    """

    polygon: Points
    inside: Mask
    origin: tuple[int, int]
    score: float
    clipped: float
    xyz: npt.NDArray[np.float64] | None = None


def measure_lamp(
    image: Image,
    polygon: Points | None = None,
    *,
    rectangle: tuple[float, float, float, float] | None = None,
    xyz_from_rgb: npt.NDArray[np.float64],
    clipped: Mask | None = None,
    latlong: bool = False,
    alone: bool = False,
) -> Lamp:
    """Return the lamp inside a `polygon` [N, 2] or a `rectangle` (x, y, width, height) of `image` [H, W, 3], in pixels.

    The rectangle covers the pixels x … x + width − 1. All of the area counts, so it should lie inside the lamp. `clipped`
    [H, W] marks samples to leave out besides NaN. `alone`: the picture holds the lamp's light and no other.

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
    region = Region(area, inside, (int(low[0]), int(low[1])), float("nan"), 0.0)
    lamp = read_region(image, region, xyz_from_rgb=xyz_from_rgb, clipped=clipped, latlong=latlong)
    return lamp if alone else replace(lamp, warnings=(*lamp.warnings, *doubts_of_mixing(lamp, xyz_from_rgb)))


def doubts_of_mixing(lamp: Lamp, xyz_from_rgb: npt.NDArray[np.float64]) -> tuple[str, ...]:
    """Return a warning if light of the scene that the lamp may reflect could shift its colour."""
    xyz = np.asarray(xyz_from_rgb, np.float64) @ lamp.rgb
    own = xyz - MOST_REFLECTED * D65_XYZ
    share = min(1.0, MOST_REFLECTED / float(xyz[1]))
    shift = float(np.hypot(*(uv_from_xyz(xyz) - uv_from_xyz(own)))) if (own > 0).all() else float("inf")
    if shift <= _MIXED:
        return ()
    x, y = lamp.polygon.mean(axis=0)
    error = f"its u'v' off by up to {shift:.3f}" if np.isfinite(shift) else "its colour that of the scene's light"
    return (
        f"balance.lamp: the lamp at ({x:.0f}, {y:.0f}) is {xyz[1]:.2g} times as bright as the chart's white, so up to {share:.0%} of what it "
        f"shows may be light of the scene that it reflects, and {error} (up to {_MIXED} does no harm). Make it brighter or "
        "shade it, or photograph the view with the lamp off too (`capture.lamp_off`).",
    )


def _doubts_of_noise(rgb: npt.NDArray[np.float64], noise: npt.NDArray[np.float64], place: str) -> tuple[str, ...]:
    """Return a warning if the reading is noisy, as a dim lamp's is; refuse it where it is hopeless."""
    worst = float((noise / np.maximum(np.abs(rgb), 1e-30)).max())
    told = (
        f"{place} is known to {worst:.1%} in its worst channel; expected {_NOISY:.0%} or better. "
        "Add longer exposures to the bracket, or photograph the module larger or brighter."
    )
    if worst > _TOO_NOISY:
        raise CalibrateError(told)
    return (told,) if worst > _NOISY else ()


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


def read_region(
    image: Image,
    region: Region,
    *,
    xyz_from_rgb: npt.NDArray[np.float64],
    clipped: Mask | None,
    latlong: bool,
) -> Lamp:
    """Return mean, standard error and doubts of a region; refuse it where it is clipped, tiny or dark."""
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
    if lost > MOST_CLIPPED * len(samples):
        raise CalibrateError(
            f"{place} is clipped in {lost} of {len(samples)} pixels; at most {MOST_CLIPPED:.0%} may be. Add a shorter "
            "exposure to the bracket, or set `balance.lamp` to a rectangle that leaves the clipped part out."
        )
    if valid.sum() < _FEWEST_PIXELS:
        raise CalibrateError(
            f"{place} covers {int(valid.sum())} usable pixels; at least {_FEWEST_PIXELS} are needed, 60 are good. Enlarge the rectangle in "
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
    unevenness = float(uv_from_xyz(xyz).std(axis=0).max())
    warnings = _doubts_of_noise(rgb, noise, place)
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
