"""EXR files → small pictures for a screen, in memory that does not grow with the map.

A picture is the mean of blocks of pixels, exposed so that the log-average luminance becomes middle grey, taken to
linear sRGB by a matrix and encoded with sRGB's curve. Values up to `KNEE` stay colorimetric; above it each channel
rolls off to white, so that lamps keep some shape. Blocks with a missing pixel are hatched in magenta.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt

from envcal import exr

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]
Shown = npt.NDArray[np.uint8]

#: What linear values above this lose is brightness only in name: they roll off to 1.
KNEE = 0.6
MIDDLE_GREY = 0.18
MAGENTA = (255, 0, 200)
_BAND_PIXELS = 1 << 21


@dataclass(frozen=True, slots=True)
class Reduced:
    """Planes [height, width] made small by an integer `step`, as the page shows them.

    `missing` is true where a pixel of the block was NaN or infinite in a plane that was averaged.
    """

    header: exr.Header
    step: int
    planes: Mapping[str, npt.NDArray[Any]]
    missing: npt.NDArray[np.bool_]

    @property
    def rgb(self) -> Image:
        """R, G, B as an image [height, width, 3]; NaN where a whole block is missing."""
        return np.stack([self.planes[name] for name in "RGB"], axis=-1)


def reduced(path: Path, ways: Mapping[str, Literal["mean", "centre", "max"]], *, longest: int) -> Reduced:
    """Read planes of an EXR, each made small in its own way, until no side is longer than `longest` pixels.

    `mean` leaves out what is not finite, `centre` takes the pixel in the middle of a block (for indices), `max` the
    largest value.
    """
    header = exr.header(path)
    height, width = header.size
    step = max(1, math.ceil(max(height, width) / longest))
    rows = step * max(1, _BAND_PIXELS // (width * step))
    small: dict[str, list[npt.NDArray[Any]]] = {name: [] for name in ways}
    missing: list[npt.NDArray[np.bool_]] = []
    for _, planes in exr.bands(path, list(ways), rows=rows):
        lost = np.zeros(next(iter(planes.values())).shape, np.bool_)
        for name, way in ways.items():
            if way == "mean":
                lost |= ~np.isfinite(planes[name])
            small[name].append(_reduce(planes[name], step, way))
        missing.append(_blocks(np.logical_or, lost, step, np.bool_))
    joined = {name: np.concatenate(parts) for name, parts in small.items()}
    return Reduced(header, step, joined, np.concatenate(missing))


def _reduce(plane: npt.NDArray[Any], step: int, way: str) -> npt.NDArray[Any]:
    if way == "max":
        return _blocks(np.maximum, plane, step, plane.dtype)
    if way == "centre":
        rows, columns = (np.minimum(np.arange(0, n, step) + step // 2, n - 1) for n in plane.shape)
        return plane[np.ix_(rows, columns)]
    finite = np.isfinite(plane)
    total = _blocks(np.add, np.where(finite, plane, 0), step, np.float64)
    count = _blocks(np.add, finite, step, np.int32)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)


def _blocks(operation: np.ufunc, plane: npt.NDArray[Any], step: int, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Combine blocks of step × step by an operation to which 0 makes no difference; those at the edges are smaller."""
    height, width = (-(-n // step) for n in plane.shape)
    rows = np.zeros((height, plane.shape[1]), dtype)
    for k in range(step):
        part = plane[k::step]
        operation(rows[: len(part)], part, out=rows[: len(part)])
    out = np.zeros((height, width), dtype)
    for k in range(step):
        part = rows[:, k::step]
        operation(out[:, : part.shape[1]], part, out=out[:, : part.shape[1]])
    return out


def crop(path: Path, box: tuple[int, int, int, int], *, wrap: bool) -> Image:
    """Read the rectangle `box` (left, top, right, bottom; right and bottom excluded) of R, G, B.

    With `wrap` the columns of a lat-long map go on across its seam; rows must lie inside the image.
    """
    left, top, right, bottom = box
    height, width = exr.header(path).size
    assert 0 <= top < bottom <= height, f"rows {top} to {bottom} of {height}"
    columns = np.arange(left, right) % width if wrap else np.clip(np.arange(left, right), 0, width - 1)
    image = np.empty((bottom - top, right - left, 3), np.float32)
    for first, planes in exr.bands(path, list("RGB"), rows=max(1, _BAND_PIXELS // width)):
        low, high = max(top, first), min(bottom, first + len(planes["R"]))
        if first >= bottom:
            break
        for k, name in enumerate("RGB"):
            if low < high:
                image[low - top : high - top, :, k] = planes[name][low - first : high - first][:, columns]
    return image


def srgb_matrix(space: str) -> Floats:
    """Linear sRGB from a working space, D65 to D65; a space of another white is not adapted, but shown as it is.

    Camera RGB has no colours yet: it is shown as if it were sRGB.
    """
    from uplift.spectrum import RGB_SPACES, rgb_space

    if space not in RGB_SPACES:
        return np.eye(3)
    return np.asarray(rgb_space("sRGB").rgb_from_xyz @ rgb_space(space).xyz_from_rgb)


def luminance(image: npt.NDArray[Any], matrix: Floats) -> Floats:
    """Luminance [...] of an image [..., 3] by the matrix that takes it to linear sRGB (Rec. ITU-R BT.709 weights)."""
    weights = np.array([0.2126, 0.7152, 0.0722]) @ matrix
    return np.asarray(np.asarray(image, np.float64) @ weights)


def exposure(image: Image, matrix: Floats) -> float:
    """The gain that brings the log-average luminance to middle grey, less where a tenth of the picture would burn."""
    y = luminance(image, matrix)
    y = y[np.isfinite(y) & (y > 0)]
    if not y.size:
        return 1.0
    floor = 1e-3 * float(np.percentile(y, 99))
    key = MIDDLE_GREY / float(np.exp(np.mean(np.log(y + floor))))
    return min(key, 4.0 / float(np.percentile(y, 90)))


def brightest_gain(image: Image, matrix: Floats) -> float:
    """The gain with which the brightest part of the picture is just below white."""
    shown = np.asarray(image, np.float64) @ matrix.T
    peak = float(np.nanmax(shown, initial=0.0))
    return KNEE / peak if peak > 0 else 1.0


def display(image: Image, matrix: Floats, *, gain: float, missing: npt.NDArray[np.bool_] | None = None) -> Shown:
    """Return the picture [height, width, 3] of 8-bit sRGB; negative light is black, missing pixels are hatched."""
    linear = np.nan_to_num(np.asarray(image, np.float64) @ (gain * matrix).T, nan=0.0, posinf=0.0, neginf=0.0)
    linear = np.clip(linear, 0.0, None)
    rolled = np.where(linear <= KNEE, linear, 1 - (1 - KNEE) * np.exp((KNEE - linear) / (1 - KNEE)))
    shown = np.round(255 * srgb_encoded(rolled)).astype(np.uint8)
    return shown if missing is None else hatched(shown, missing)


def srgb_encoded(linear: npt.ArrayLike) -> Floats:
    """SRGB's transfer curve (IEC 61966-2-1) on values clipped to 0…1."""
    values = np.clip(np.asarray(linear, np.float64), 0.0, 1.0)
    return np.asarray(np.where(values <= 0.0031308, 12.92 * values, 1.055 * values ** (1 / 2.4) - 0.055))


def hatched(shown: Shown, missing: npt.NDArray[np.bool_]) -> Shown:
    """Draw magenta and black stripes over missing pixels, in a picture of the same size."""
    rows, columns = np.indices(missing.shape)
    stripe = ((rows + columns) // 3) % 2 == 0
    out = shown.copy()
    out[missing & stripe] = MAGENTA
    out[missing & ~stripe] = (30, 0, 25)
    return out


def missing_in(image: Image) -> npt.NDArray[np.bool_]:
    """Where a pixel [height, width] of an image has a channel that is not finite."""
    return np.asarray(~np.isfinite(image).all(axis=2), np.bool_)


def css_colour(rgb: npt.ArrayLike, matrix: Floats) -> str:
    """A working RGB colour as `#rrggbb`, clipped to sRGB; 1 is white."""
    linear = matrix @ np.asarray(rgb, np.float64)
    return "#" + "".join(f"{int(v):02x}" for v in np.round(255 * srgb_encoded(np.nan_to_num(linear))))


def jpeg(shown: Shown, *, quality: int = 84) -> str:
    """A picture as a data URI."""
    return _uri("jpeg", ".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1])


def png(shown: Shown) -> str:
    """A picture of few flat colours as a data URI."""
    return _uri("png", ".png", shown, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def _uri(kind: str, suffix: str, shown: Shown, settings: list[int]) -> str:
    done, data = cv2.imencode(suffix, np.ascontiguousarray(shown[..., ::-1]), settings)
    assert done, f"{kind} of {shown.shape}"
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode('ascii')}"
