"""The lamp alone: the difference of two pictures of one view, with the lamp on and off.

Light adds up, so the difference holds the lamp's light and nothing of the scene's, whatever the lamp's surface reflects
of that. It holds only if camera and scene stood still. Both are checked on the rest of the picture, in tiles: a tile's difference
is fitted by its own picture times a gain (the light it gets from the lamp, or a change of the scene's light) and by the picture's
slopes (a shift of the camera), weighted by the noise of both pictures. The lamp's light on a tile is never negative and has
the lamp's colour; a change of the scene's light has the scene's. Where the two colours are alike, only the tiles that the
lamp reaches least tell the change.

Left out: turns of the camera about its axis, as far as their shifts cancel; things that moved and got no darker.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.lamp.reading import Image, Lamp, Mask, Points, Region, read_region

_TILE: Final = 24
# A tile speaks of the gain if that is known to this, and of the shift if that is known to a tenth of a pixel.
_KNOWN_GAIN: Final = 0.02
_KNOWN_SHIFT_PX: Final = 0.1
_SMOOTHING: Final = 1.2
# Differences of fourth order: those of two neighbours alone underestimate the slopes of edges by a quarter.
_SLOPE: Final = np.array([1.0, -8.0, 0.0, 8.0, -1.0], np.float32) / 12
_FEWEST_TILES: Final = 12
# Inside the lamp nothing changes by a fifth of a pixel; half a pixel is no tripod.
_NOTABLE_SHIFT_PX: Final = 0.2
_LARGEST_SHIFT_PX: Final = 0.5
# Of the scene's light. What reaches the reading is this times what the lamp's surface reflects over what it shines.
_NOTABLE_CHANGE: Final = 0.01
_LARGEST_CHANGE: Final = 0.03
# Share of the tiles that may have become darker by more than the largest change.
_MOST_DARKENED: Final = 0.05
# The colours of lamp and scene tell their lights apart from this standard deviation of their log ratios on.
_COLOURS_DIFFER: Final = 0.1
# A pixel of the lamp stands out by this many of its standard deviations; regions from this share of the peak on are the lamp.
_LEAST_SIGNIFICANCE: Final = 8.0
_OF_PEAK: Final = 0.4
_OF_RIM: Final = 0.05
_LEAST_PIXELS: Final = 9
_SECOND_AREA: Final = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class LampAlone:
    """The light of the lamp [H, W, 3] in camera RGB and its standard deviation [H, W, 3]; NaN where either picture is lost.

    `clipped` [H, W]: lost with the lamp on and not without it. `shift_px` (x, y) is how the camera moved, `change` how the scene's
    light changed (0.01: 1 % brighter with the lamp on), `darkened` the share of the picture that became darker.
    """

    light: Image
    sigma: Image
    clipped: Mask
    shift_px: tuple[float, float]
    change: float
    darkened: float
    warnings: tuple[str, ...] = ()


def lamp_alone(
    on: Image,
    off: Image,
    *,
    sigma_on: Image,
    sigma_off: Image,
    white_rgb: npt.NDArray[np.float64],
) -> LampAlone:
    """Return the difference of two pictures [H, W, 3] in linear camera RGB of one unit, after a check that all else is the same.

    Parameters
    ----------
    on, off
        Shape (H, W, 3). With the lamp on and off; NaN where lost.
    sigma_on, sigma_off
        Shape (H, W, 3). Their standard deviations.
    white_rgb
        Shape (3,). Camera RGB of something white in the scene's light, any scale.

    Raises
    ------
    CalibrateError
        If the sizes differ, too little is seen to check, the camera moved or the scene's light changed.
    """
    if on.shape != off.shape or sigma_on.shape != on.shape or sigma_off.shape != off.shape:
        raise CalibrateError(
            f"capture.lamp_off: a picture of {off.shape[1]}×{off.shape[0]} pixels; the reference has {on.shape[1]}×{on.shape[0]}. "
            "Photograph both brackets with one camera, from one tripod."
        )
    light = np.asarray(on - off, np.float32)
    sigma = np.asarray(np.hypot(sigma_on, sigma_off), np.float32)
    lost_on, lost_off = (~np.isfinite(picture).all(axis=2) for picture in (on, off))
    gains, errors, shifts, shift_errors = _tiles(light, off, sigma, left_out=_lamp_itself(light, sigma))
    sure = (errors < _KNOWN_GAIN).all(axis=1)
    if sure.sum() < _FEWEST_TILES:
        raise CalibrateError(
            f"capture.lamp_off: only {int(sure.sum())} parts of the picture are seen well enough to tell whether the scene stood "
            f"still; expected at least {_FEWEST_TILES}. Add longer exposures to both brackets."
        )
    steady = (shift_errors < _KNOWN_SHIFT_PX).all(axis=1)
    moved = np.median(shifts[steady], axis=0) if steady.sum() >= _FEWEST_TILES else np.zeros(2)
    far = _coarse_shift(on, off)
    shift = far if np.hypot(*far) > 1.5 else moved
    if np.hypot(*shift) > _LARGEST_SHIFT_PX:
        raise CalibrateError(
            f"capture.lamp_off: the camera moved by {np.hypot(*shift):.1f} pixels between the brackets; at most {_LARGEST_SHIFT_PX} "
            "may be. Photograph both from a tripod without touching it, or leave `capture.lamp_off` out."
        )
    cast = np.log(np.maximum(_brightest(light, sigma) / np.asarray(white_rgb, np.float64), 1e-12))
    change = _change(gains[sure], np.exp(cast - cast.mean()))
    brightness, error = gains[sure].mean(axis=1), np.sqrt((errors[sure] ** 2).sum(axis=1)) / 3
    darkened = float((brightness < -_LARGEST_CHANGE - 4 * error).mean())
    if abs(change) > _LARGEST_CHANGE or darkened > _MOST_DARKENED:
        raise CalibrateError(
            f"capture.lamp_off: with the lamp on, the scene's own light differs by {change:+.1%} from what it is without, and {darkened:.0%} of "
            f"the picture is darker by more than {_LARGEST_CHANGE:.0%} and noise (at most {_LARGEST_CHANGE:.0%}, and "
            f"{_MOST_DARKENED:.0%} of the picture). Photograph both brackets right after one another, in steady light and with "
            "nobody in view, or leave `capture.lamp_off` out."
        )
    warnings: tuple[str, ...] = ()
    if abs(change) > _NOTABLE_CHANGE:
        warnings += (
            f"capture.lamp_off: the scene's own light changed by {change:+.1%} between the brackets; up to {_NOTABLE_CHANGE:.0%} does no "
            "harm. Photograph both right after one another.",
        )
    if np.hypot(*shift) > _NOTABLE_SHIFT_PX:
        warnings += (
            f"capture.lamp_off: the camera moved by {np.hypot(*shift):.2f} pixels between the brackets; up to {_NOTABLE_SHIFT_PX} does no "
            "harm. Use a tripod and a remote release.",
        )
    return LampAlone(
        light, sigma, np.asarray(lost_on & ~lost_off), (float(shift[0]), float(shift[1])), change, darkened, warnings
    )


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
    width = working.shape[1]
    green = np.where(alone.clipped, np.float32(np.inf), np.nan_to_num(alone.light[..., 1]))
    noise = np.nan_to_num(alone.sigma[..., 1], nan=np.inf)
    # A single photosite is no lamp.
    calm = cv2.medianBlur(np.asarray(np.where(np.isinf(green), np.finfo(np.float32).max, green), np.float32), 3)
    known = np.isfinite(noise) & (calm < np.finfo(np.float32).max)
    peak = float(calm[known].max(initial=0.0))
    significance = float((calm[known] / np.maximum(noise[known], 1e-30)).max(initial=0.0))
    if not alone.clipped.any() and significance < _LEAST_SIGNIFICANCE:
        raise CalibrateError(
            f"capture.lamp_off: nothing lights up between the brackets: the brightest difference is {significance:.1f} standard deviations "
            f"of its noise; expected at least {_LEAST_SIGNIFICANCE:.0f}. Check that the lamp is on in `capture.reference` and off in "
            "`capture.lamp_off`, or expose longer."
        )
    shift = width // 2 - int(np.unravel_index(np.argmax(calm), calm.shape)[1]) if latlong else 0
    seen = np.roll(calm > _OF_PEAK * peak, shift, axis=1).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(seen, connectivity=8)
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
    lamp = read_region(
        np.roll(working, shift, axis=1),
        region,
        xyz_from_rgb=xyz_from_rgb,
        clipped=np.roll(alone.clipped, shift, axis=1),
        latlong=False,
    )
    warnings = lamp.warnings
    second = int(np.delete(areas, label - 1).max(initial=0))
    if second > max(_SECOND_AREA * areas[label - 1], 4 * _LEAST_PIXELS):
        warnings += (
            f"capture.lamp_off: another region of {second} pixels lights up as well, beside the {int(areas[label - 1])} taken. If it is "
            "no reflection, switch only the module, or set `balance.lamp` to a rectangle inside it.",
        )
    return Lamp(
        rgb=lamp.rgb,
        noise=lamp.noise,
        polygon=lamp.polygon - np.array([float(shift), 0.0]),
        pixels=lamp.pixels,
        clipped=lamp.clipped,
        score=1.0,
        runner_up=0.0,
        unevenness=lamp.unevenness,
        warnings=warnings,
    )


def _tiles(
    light: Image, off: Image, sigma: Image, *, left_out: Mask
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return gains [T, 3], their errors, shifts [T, 2] (green's) and their errors, of tiles that are wholly known."""
    height, width = (size // _TILE * _TILE for size in light.shape[:2])

    def cut(plane: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
        rows, columns = height // _TILE, width // _TILE
        parts = plane[:height, :width].reshape(rows, _TILE, columns, _TILE).swapaxes(1, 2)
        return np.asarray(parts.reshape(rows * columns, -1), np.float64)

    gains, errors, shifts, shift_errors = [], [], np.zeros((0, 2)), np.zeros((0, 2))
    lost = (left_out | ~np.isfinite((light + sigma + off).sum(axis=2))).astype(np.uint8)
    whole = ~cut(cv2.dilate(lost, np.ones((9, 9), np.uint8))).any(axis=1)
    for channel in range(3):
        # Differences of neighbours are slopes only of what is smooth; the noise is then less than `sigma` says.
        picture, smooth = (
            cv2.GaussianBlur(np.nan_to_num(plane[..., channel]), (0, 0), _SMOOTHING) for plane in (off, light)
        )
        slope_x, slope_y = (cv2.filter2D(picture, -1, kernel) for kernel in (_SLOPE[None], _SLOPE[:, None]))
        basis = np.stack([cut(picture), -cut(slope_x), -cut(slope_y)], axis=2)[whole]
        weight = 1 / np.maximum(cut(sigma[..., channel])[whole], 1e-30) ** 2
        difference = cut(smooth)[whole]
        normal = np.einsum("tni,tn,tnj->tij", basis, weight, basis)
        scale = np.sqrt(np.maximum(np.einsum("tii->ti", normal), 1e-30))
        ridge = normal / (scale[:, :, None] * scale[:, None, :]) + 1e-9 * np.eye(3)
        inverse = np.linalg.inv(ridge) / (scale[:, :, None] * scale[:, None, :])
        found = np.einsum("tij,tj->ti", inverse, np.einsum("tni,tn,tn->ti", basis, weight, difference))
        spread = np.sqrt(np.maximum(np.einsum("tii->ti", inverse), 0))
        gains.append(found[:, 0])
        errors.append(spread[:, 0])
        if channel == 1:
            shifts, shift_errors = found[:, 1:], spread[:, 1:]
    return np.stack(gains, axis=1), np.stack(errors, axis=1), shifts, shift_errors


def _lamp_itself(light: Image, sigma: Image) -> Mask:
    """The lamp and its rim [H, W]: what hangs together with the brightest spot of the difference."""
    spot = cv2.GaussianBlur(np.nan_to_num(light[..., 1]), (0, 0), _SMOOTHING)
    noise = np.nan_to_num(sigma[..., 1], nan=np.inf)
    row, column = np.unravel_index(np.argmax(spot), spot.shape)
    bright = (spot > _OF_RIM * spot[row, column]) & (spot > _LEAST_SIGNIFICANCE * noise)
    labels = cv2.connectedComponents(bright.astype(np.uint8), connectivity=8)[1]
    return np.asarray(bright & (labels == labels[row, column]))


def _coarse_shift(on: Image, off: Image) -> npt.NDArray[np.float64]:
    """Shift (x, y) by phase correlation of log green, for moves that slopes do not reach; 0 where it is not clear."""
    pictures = []
    for picture in (on, off):
        green = np.nan_to_num(picture[..., 1], nan=float(np.nanmax(picture[..., 1])))
        pictures.append(np.log(np.maximum(green, max(float(np.median(green)), 1e-30) / 30)))
    window = cv2.createHanningWindow(on.shape[1::-1], cv2.CV_32F)
    lit, unlit = (np.asarray(picture, np.float32) for picture in pictures)
    (x, y), response = cv2.phaseCorrelate(lit, unlit, window)
    return np.array([x, y]) if response > 0.2 else np.zeros(2)


def _brightest(light: Image, sigma: Image) -> npt.NDArray[np.float64]:
    """Mean camera RGB [3] of the thousandth of the picture that became brightest."""
    known = np.isfinite(light).all(axis=2) & np.isfinite(sigma).all(axis=2)
    samples = light[known].astype(np.float64)
    count = max(9, len(samples) // 1000)
    order = np.argsort(samples[:, 1])[-count:]
    return np.asarray(samples[order].mean(axis=0))


def _change(gains: npt.NDArray[np.float64], cast: npt.NDArray[np.float64]) -> float:
    """By how much the scene's light changed, from gains [T, 3] = change + lamp · `cast` [3], the lamp's colour seen from it."""
    if float(np.log(cast).std()) > _COLOURS_DIFFER:
        basis = np.stack([np.ones(3), cast], axis=1)
        return float(np.median(gains @ np.linalg.pinv(basis)[0]))
    return float(np.percentile(gains.mean(axis=1), 10))
