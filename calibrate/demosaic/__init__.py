"""Three colours for every pixel of a mosaic, in float and without a range limit.

Bayer mosaics: edge-directed interpolation in a logarithmic scale (`edges`), or the linear filters of Malvar, He and Cutler
(`malvar`). Other mosaics: a weighted mean of the near samples of each colour (`near`). A sensor without filters gives
three equal channels; a frame that has three colours at every photosite needs nothing. Measured samples always pass
through unchanged, and what is interpolated lies between the samples that it is interpolated from.

Left out: removal of colour moiré, and any repair of lost samples.
"""

from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.demosaic.edges import interpolate_along_edges
from calibrate.demosaic.malvar import interpolate_linearly
from calibrate.demosaic.near import interpolate_near, spread
from calibrate.exposure import BAYER_PATTERNS, LINEAR, MONOCHROME, known_pattern

__all__ = ["METHODS", "demosaic", "lost_pixels", "spread"]

METHODS = ("edges", "malvar")
_SMALLEST = 4

# Rows at a time that stay in a core's cache.
_BAND = 16


def demosaic(
    mosaic: npt.NDArray[Any],
    cfa: str,
    *,
    lost: npt.NDArray[np.bool_] | None = None,
    method: Literal["edges", "malvar"] = "edges",
) -> npt.NDArray[np.float32]:
    """Return the image that a mosaic samples.

    Measured samples pass through unchanged. An interpolated value lies within the range of the two or four nearest
    samples of its colour (of those within two photosites, for a 6×6 pattern). Constant images come out exact, and the
    image of k·mosaic is k times that of the mosaic.

    Parameters
    ----------
    mosaic
        Shape (H, columns), float32, linear. NaN (or infinite) where lost. Reflected at the border without repeating
        the edge row, which keeps the colours of the pattern in place.
    cfa
        Colours of the top-left pattern, row by row: "RGGB", "BGGR", "GRBG" or "GBRG", 36 letters of a 6×6, "W", or "RGB"
        for three colours side by side at every photosite.
    lost
        Shape (H, columns): samples to take as lost besides those that are not finite.
    method
        For Bayer mosaics: `edges` or `malvar`.

    Returns
    -------
    Shape (H, W, 3), float32: camera RGB in the mosaic's unit. A channel is NaN where its own sample is lost or one
    of the two or four nearest samples that it is interpolated from. `lost_pixels` gives the mask.

    Raises
    ------
    CalibrateError
        An unknown pattern or method, not a two-dimensional mosaic of at least 4×4, or a mask of another shape.
    """
    if not known_pattern(cfa):
        raise CalibrateError(
            f"demosaic: colour filter array {cfa!r}; one of {', '.join(BAYER_PATTERNS)}, 36 letters of a 6×6, W or RGB is "
            "expected. Pass the colours of the mosaic's top-left pattern, row by row."
        )
    if method not in METHODS:
        raise CalibrateError(
            f"demosaic: method {method!r}; {' or '.join(METHODS)} is expected. Correct `merge.demosaic`."
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
    if cfa == MONOCHROME:
        return np.repeat(np.where(np.isfinite(samples), samples, np.float32(np.nan))[..., None], 3, axis=2)
    if cfa == LINEAR:
        image = samples.reshape(samples.shape[0], -1, 3)
        return np.where(np.isfinite(image), image, np.float32(np.nan))
    if cfa not in BAYER_PATTERNS:
        return interpolate_near(samples, cfa)
    red = cfa.index("R")
    if method == "malvar":
        padded = cv2.copyMakeBorder(samples, 2, 2, 2, 2, cv2.BORDER_REFLECT_101)
        return interpolate_linearly(padded, red // 2, red % 2)
    return interpolate_along_edges(samples, red // 2, red % 2)


def lost_pixels(image: npt.NDArray[np.float32]) -> npt.NDArray[np.bool_]:
    """Return the mask (H, W) of the pixels of an image (H, W, 3) that miss a channel."""
    lost = np.zeros(image.shape[:2], np.bool_)
    for top in range(0, len(image), _BAND):
        band = image[top : top + _BAND]
        # Most bands miss none, as their sum tells.
        with np.errstate(invalid="ignore", over="ignore"):
            some = np.isnan(band.sum())
        if some:
            missing = np.isnan(band)
            lost[top : top + _BAND] = missing[..., 0] | missing[..., 1] | missing[..., 2]
    return lost
