"""Whether camera and scene stood still between two pictures of one view, lamp on and lamp off.

The rest of the picture tells, in tiles: a tile's difference is fitted by its own picture times a gain (the light it gets from the
lamp, or a change of the scene's light) and by the picture's slopes (a shift of the camera), weighted by the noise of both
pictures. The lamp's light on a tile is never negative and has the lamp's colour; a change of the scene's light has the scene's.
Where the two colours are alike, only the tiles that the lamp reaches least tell the change.

Left out: turns of the camera about its axis, as far as their shifts cancel; things that moved and got no darker.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.lamp.reading import Image, Mask

_TILE: Final = 24
# A tile speaks of the gain if that is known to this, and of the shift if that is known to a tenth of a pixel.
_KNOWN_GAIN: Final = 0.02
_KNOWN_SHIFT_PX: Final = 0.1
_SMOOTHING: Final = 1.2
# Differences of fourth order: those of two neighbours alone underestimate the slopes of edges by a quarter.
_SLOPE: Final = np.array([1.0, -8.0, 0.0, 8.0, -1.0], np.float32) / 12
_FEWEST_TILES: Final = 12
# Beyond this, slopes say little of a shift.
_FAR_PX: Final = 1.5
# The colours of lamp and scene tell their lights apart from this standard deviation of their log ratios on.
_COLOURS_DIFFER: Final = 0.1
# The lamp is left out: what hangs together with the brightest spot, above so many standard deviations and this share of it.
_LEAST_SIGNIFICANCE: Final = 8.0
_OF_RIM: Final = 0.05
# From here on a tile is darker for certain, in standard deviations.
_CERTAIN: Final = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Stillness:
    """How the camera moved, `shift_px` (x, y), by how much the scene's light changed, and the share of the picture that became
    darker by more than was asked for.
    """

    shift_px: tuple[float, float]
    change: float
    darkened: float


def stillness(
    on: Image, off: Image, sigma: Image, *, white_rgb: npt.NDArray[np.float64], notable_change: float
) -> Stillness:
    """Measure how two pictures [H, W, 3] in camera RGB, `sigma` that of their difference, differ beside the lamp.

    Raises
    ------
    CalibrateError
        If too little is seen well enough to tell.
    """
    light = np.asarray(on - off, np.float32)
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
    x, y = far if np.hypot(*far) > _FAR_PX else moved
    cast = np.log(np.maximum(_brightest(light, sigma) / np.asarray(white_rgb, np.float64), 1e-12))
    brightness, error = gains[sure].mean(axis=1), np.sqrt((errors[sure] ** 2).sum(axis=1)) / 3
    return Stillness(
        (float(x), float(y)),
        _change(gains[sure], np.exp(cast - cast.mean())),
        float((brightness < -notable_change - _CERTAIN * error).mean()),
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
