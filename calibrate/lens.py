"""The fall-off of a lens towards the corners, taken out in camera RGB.

The light at the distance r from the middle of the picture, 1 in its corners, is 1 + k₁r² + k₂r⁴ + k₃r⁶ of that in the middle,
by channel: the even polynomial of Adobe's lens profiles and of lensfun's `pa` model. It holds for the lens, aperture and focus
that it was measured with.

Left out: distortion and lateral colour (shots are not warped before they are a map), a middle of the lens that is not that of
the picture.
"""

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.exposure import LINEAR, MONOCHROME, FrameInfo

Plane = npt.NDArray[np.float32]
Row = tuple[float, float, float]
#: (k₁, k₂, k₃) of red, green and blue.
Vignetting = tuple[Row, Row, Row]

# Light in a corner below this share of the middle's is no fall-off that can be taken out.
_DARKEST = 0.02

# A flat field: the mean of cells this large, in patterns; its brightness and what may remain of it after the fit.
_CELL = 8
_BRIGHTNESS = (0.05, 0.95)
_UNEVEN = 0.03


def remove_vignetting(image: Plane, vignetting: Vignetting) -> Plane:
    """Return an image, shape (H, W, 3), camera RGB, as a lens without fall-off would have given it.

    The middle of the picture keeps its values. NaN stays NaN.

    Raises
    ------
    CalibrateError
        A polynomial that leaves less than 2 % of the light somewhere.
    """
    squares = _squares(image.shape[0], image.shape[1])
    out = np.empty_like(image)
    for k, (a, b, c) in enumerate(vignetting):
        light = 1 + squares * (np.float32(a) + squares * (np.float32(b) + squares * np.float32(c)))
        if not light.min() > _DARKEST:
            raise CalibrateError(
                f"vignetting ({a:g}, {b:g}, {c:g}): leaves {float(light.min()):.2g} of the light somewhere in the picture; more "
                f"than {_DARKEST} is expected. Correct `merge.vignetting`, or photograph another `merge.flat_field`."
            )
        out[..., k] = image[..., k] / light
    return out


def on_sensor(row: Row, scale: float) -> Row:
    """Return the polynomial of one channel for another sensor: its corners lie at r = `scale` of that it was measured on.

    The ratio of the crop factors, that of the measurement over this one's.
    """
    k1, k2, k3 = row
    return k1 * scale**2, k2 * scale**4, k3 * scale**6


def measure_vignetting(mosaic: npt.NDArray[np.uint16], info: FrameInfo) -> Vignetting:
    """Return the fall-off that a flat field shows: a RAW frame of an evenly bright surface, hardly clipped nowhere dark.

    Raises
    ------
    CalibrateError
        A flat field that is clipped, too dark, or departs from the polynomial by more than 3 % (RMS): it is not even.
    """
    rows, columns = info.period
    black, white = np.array(info.black_dn), np.array(info.white_dn)
    found: dict[str, Row] = {}
    for colour in sorted(set(info.cfa)):
        values, squares = [], []
        for p in (p for p, c in enumerate(info.cfa) if c == colour):
            y, x = divmod(p, columns)
            plane = mosaic[y::rows, x::columns].astype(np.float64)
            place = (plane - black[p]) / (white[p] - black[p])
            height, width = (n // _CELL * _CELL for n in place.shape)
            if min(height, width) < 4 * _CELL:
                raise CalibrateError(f"{info.name}: too small for a flat field. Give `merge.flat_field` a whole frame.")
            cells = place[:height, :width].reshape(height // _CELL, _CELL, width // _CELL, _CELL).mean(axis=(1, 3))
            across = 1 if info.cfa == LINEAR else columns
            at_y = (np.arange(height // _CELL) + 0.5) * _CELL * rows - 0.5 * rows + y + 0.5
            at_x = (np.arange(width // _CELL) + 0.5) * _CELL * across - 0.5 * across + (0 if across == 1 else x) + 0.5
            values.append(cells.ravel())
            squares.append(_squares_at(at_y, at_x, info.height, info.width).ravel())
        found[colour] = _fit(np.concatenate(values), np.concatenate(squares), info.name)
    if info.cfa == MONOCHROME:
        return found["W"], found["W"], found["W"]
    return found["R"], found["G"], found["B"]


def _fit(values: npt.NDArray[np.float64], squares: npt.NDArray[np.float64], name: str) -> Row:
    low, high = np.quantile(values, 0.01), np.quantile(values, 0.999)
    if not (low >= _BRIGHTNESS[0] * 0.2 and _BRIGHTNESS[0] <= high <= _BRIGHTNESS[1]):
        raise CalibrateError(
            f"{name}: the flat field lies between {low:.2f} and {high:.2f} of the range; its bright parts between "
            f"{_BRIGHTNESS[0]} and {_BRIGHTNESS[1]}, nothing clipped, is expected. Photograph it again, a stop below clipping."
        )
    powers = np.stack([np.ones_like(squares), squares, squares**2, squares**3], axis=1)
    solved = np.linalg.lstsq(powers, values, rcond=None)[0]
    left = float(np.sqrt(np.mean((values / (powers @ solved) - 1) ** 2)))
    if left > _UNEVEN:
        raise CalibrateError(
            f"{name}: the flat field departs from a round fall-off by {left:.1%}; at most {_UNEVEN:.0%} is expected. Photograph "
            "an evenly lit surface, out of focus, without shadows."
        )
    return float(solved[1] / solved[0]), float(solved[2] / solved[0]), float(solved[3] / solved[0])


def _squares(height: int, width: int) -> Plane:
    """Return r² of every pixel's centre."""
    return _squares_at(np.arange(height) + 0.5, np.arange(width) + 0.5, height, width).astype(np.float32)


def _squares_at(
    y: npt.NDArray[np.floating], x: npt.NDArray[np.floating], height: int, width: int
) -> npt.NDArray[np.float64]:
    corner = (height / 2) ** 2 + (width / 2) ** 2
    return np.asarray(((y - height / 2)[:, None] ** 2 + (x - width / 2) ** 2) / corner, np.float64)
