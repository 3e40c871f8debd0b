"""Three colours for every pixel of a Bayer mosaic, in float and without a range limit.

The linear filters of Malvar, He and Cutler (2004, "High-quality linear interpolation for demosaicing of
Bayer-patterned color images", ICASSP): bilinear interpolation plus a share of the Laplacian of the colour that
was measured at the place. Chosen because it is linear in the light, needs no display range and costs one pass.
A linear filter with negative lobes rings beside a lamp that is 10⁵ times its surroundings, so every interpolated
value is held between the smallest and the largest of the samples it lies between.

Left out: edge-directed methods (they decide by differences that mean nothing across an HDR edge), removal of
colour moiré, and any repair of lost samples.
"""

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit, prange

from calibrate import CalibrateError
from calibrate.exposure import BAYER_PATTERNS

_SMALLEST = 4


def demosaic(
    mosaic: npt.NDArray[Any], cfa: str, *, lost: npt.NDArray[np.bool_] | None = None
) -> npt.NDArray[np.float32]:
    """Return the image that a Bayer mosaic samples.

    Measured samples pass through unchanged. An interpolated value lies within the range of the two or four nearest
    samples of its colour. Constant images and linear ramps come out exact, away from the border, and the image of
    k·mosaic is k times that of the mosaic.

    Parameters
    ----------
    mosaic
        Shape (H, W), float32, linear. NaN (or infinite) where lost. Reflected at the border without repeating
        the edge row, which keeps the colours of the pattern in place.
    cfa
        Colours of the top-left 2×2, row by row: "RGGB", "BGGR", "GRBG" or "GBRG".
    lost
        Shape (H, W): samples to take as lost besides those that are not finite.

    Returns
    -------
    Shape (H, W, 3), float32: camera RGB in the mosaic's unit. A channel is NaN where its own sample is lost or one
    of the two or four nearest samples that it is interpolated from; where only the Laplacian's samples are lost,
    the value is the bilinear one. `lost_pixels` gives the mask.

    Raises
    ------
    CalibrateError
        An unknown pattern, not a two-dimensional mosaic of at least 4×4, or a mask of another shape.
    """
    if cfa not in BAYER_PATTERNS:
        raise CalibrateError(
            f"demosaic: colour filter array {cfa!r}; one of {', '.join(BAYER_PATTERNS)} is expected. "
            "Pass the colours of the mosaic's top-left 2×2, row by row."
        )
    if mosaic.ndim != 2 or min(mosaic.shape) < _SMALLEST:
        raise CalibrateError(
            f"demosaic: array of shape {mosaic.shape}; a mosaic (H, W) of at least 4×4 is expected. "
            "Pass the merged mosaic itself, not an image."
        )
    if lost is not None and lost.shape != mosaic.shape:
        raise CalibrateError(
            f"demosaic: mask of shape {lost.shape} for a mosaic of shape {mosaic.shape}; they must agree. "
            "Pass the mask that the merge returned with this mosaic."
        )
    samples = mosaic.astype(np.float32, copy=lost is not None)
    if lost is not None:
        samples[lost] = np.nan
    padded = cv2.copyMakeBorder(samples, 2, 2, 2, 2, cv2.BORDER_REFLECT_101)
    red = cfa.index("R")
    image = np.empty((*mosaic.shape, 3), np.float32)
    _interpolate(padded, red // 2, red % 2, image)
    return image


def lost_pixels(image: npt.NDArray[np.float32]) -> npt.NDArray[np.bool_]:
    """Return the mask (H, W) of the pixels of an image (H, W, 3) that miss a channel."""
    missing = np.isnan(image)
    return missing[..., 0] | missing[..., 1] | missing[..., 2]


@njit(cache=True, error_model="numpy")
def _held(mean: float, correction: float, smallest: float, largest: float) -> float:  # pragma: no cover - compiled
    if not np.isfinite(mean):
        return np.nan
    if not np.isfinite(correction):
        return mean
    return min(max(mean + correction, smallest), largest)


@njit(cache=True, parallel=True, error_model="numpy")
def _interpolate(
    m: npt.NDArray[np.float32], red_row: int, red_column: int, image: npt.NDArray[np.float32]
) -> None:  # pragma: no cover - compiled
    """Fill `image` from the mosaic `m`, which has two reflected samples around it; float64 within a pixel."""
    height, width = image.shape[:2]
    for y in prange(height):
        for x in range(width):
            j, i = y + 2, x + 2
            here = np.float64(m[j, i])
            n, s, w, e = (
                np.float64(m[j - 1, i]),
                np.float64(m[j + 1, i]),
                np.float64(m[j, i - 1]),
                np.float64(m[j, i + 1]),
            )
            nw, ne = np.float64(m[j - 1, i - 1]), np.float64(m[j - 1, i + 1])
            sw, se = np.float64(m[j + 1, i - 1]), np.float64(m[j + 1, i + 1])
            vertical = np.float64(m[j - 2, i]) + np.float64(m[j + 2, i])
            horizontal = np.float64(m[j, i - 2]) + np.float64(m[j, i + 2])
            diagonal = (nw + ne) + (sw + se)
            measured = here if np.isfinite(here) else np.nan
            in_red_row = y % 2 == red_row
            if in_red_row == (x % 2 == red_column):  # a red or a blue site
                green = _held(
                    ((n + s) + (w + e)) / 4.0,
                    (4.0 * here - (vertical + horizontal)) / 8.0,
                    min(n, s, w, e),
                    max(n, s, w, e),
                )
                opposite = _held(
                    diagonal / 4.0,
                    (6.0 * here - 1.5 * (vertical + horizontal)) / 8.0,
                    min(nw, ne, sw, se),
                    max(nw, ne, sw, se),
                )
                red, blue = (measured, opposite) if in_red_row else (opposite, measured)
            else:
                green = measured
                beside = _held(
                    (w + e) / 2.0,
                    (5.0 * here - horizontal - diagonal + 0.5 * vertical) / 8.0,
                    min(w, e),
                    max(w, e),
                )
                above = _held(
                    (n + s) / 2.0,
                    (5.0 * here - vertical - diagonal + 0.5 * horizontal) / 8.0,
                    min(n, s),
                    max(n, s),
                )
                red, blue = (beside, above) if in_red_row else (above, beside)
            image[y, x, 0] = red
            image[y, x, 1] = green
            image[y, x, 2] = blue
