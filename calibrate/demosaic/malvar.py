"""The linear filters of Malvar, He and Cutler (2004, "High-quality linear interpolation for demosaicing of
Bayer-patterned color images", ICASSP): bilinear interpolation plus a share of the Laplacian of the colour that was
measured at the place.

Linear in the light and one pass. A linear filter with negative lobes rings beside a lamp that is 10⁵ times its
surroundings, so every interpolated value is held between the smallest and the largest of the samples it lies between.
"""

import numpy as np
import numpy.typing as npt
from numba import njit, prange


def interpolate_linearly(padded: npt.NDArray[np.float32], red_row: int, red_column: int) -> npt.NDArray[np.float32]:
    """Return the image (H, W, 3) of a mosaic with two reflected samples around it; see `demosaic`.

    Linear ramps come out exact away from the border. Where only the Laplacian's samples are lost, the value is the
    bilinear one.
    """
    height, width = padded.shape
    image = np.empty((height - 4, width - 4, 3), np.float32)
    _interpolate(padded, red_row, red_column, image)
    return image


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
