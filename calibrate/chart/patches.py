"""The colour of each patch, measured in the float image with its standard error.

A patch's value is the mean of its samples without outliers (farther than three robust standard deviations from the
median: dust, glare, hot pixels). Samples that are NaN or marked as lost never count.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError

# Median absolute deviation to standard deviation, for a normal distribution.
_SIGMA_PER_MAD: Final = 1.4826
_OUTLIER_SIGMAS: Final = 3.0


@dataclass(frozen=True, slots=True)
class Patches:
    """Measured patches in order: `rgb` [N, 3], `noise` [N, 3] the standard error of each mean, `pixels` [N] the samples
    used (the fewest of the three channels), `lost` [N] the fraction of samples that were NaN or marked, 0…1.
    """

    rgb: npt.NDArray[np.float64]
    noise: npt.NDArray[np.float64]
    pixels: npt.NDArray[np.int64]
    lost: npt.NDArray[np.float64]


def measure_patches(
    image: npt.NDArray[np.float32],
    quads: npt.NDArray[np.float64],
    *,
    names: Sequence[str] = (),
    lost: npt.NDArray[np.bool_] | None = None,
    latlong: bool = False,
    fewest_pixels: int = 6,
    independent: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Patches:
    """Return mean colour, standard error and sample counts of the quadrilaterals `quads` [N, 4, 2] in `image`.

    Parameters
    ----------
    image
        Shape (H, W, 3), linear. NaN samples are left out.
    quads
        Pixel coordinates (x, y), integer = centre; a pixel counts if its centre lies inside.
    names
        Of the patches, for messages.
    lost
        Shape (H, W). Pixels to leave out besides NaN.
    latlong
        x wraps at the image's width.
    fewest_pixels
        A patch with fewer samples in any channel is refused.
    independent
        Independent samples a pixel in R, G, B: (1, 1, 1) for what was measured, (¼, ½, ¼) for a demosaiced Bayer mosaic.
        It enters the standard errors only.

    Raises
    ------
    CalibrateError
        Naming each patch that lies outside the image or has too few samples.
    """
    labels = [names[i] if i < len(names) else f"patch {i + 1}" for i in range(len(quads))]
    rgb, noise = np.full((len(quads), 3), np.nan), np.full((len(quads), 3), np.nan)
    pixels, lost_part = np.zeros(len(quads), dtype=np.int64), np.ones(len(quads))
    mistakes: list[str] = []
    for index, quad in enumerate(quads):
        samples = samples_in_polygon(image, quad, lost=lost, latlong=latlong)
        if samples is None:
            mistakes.append(f"{labels[index]} reaches beyond the image")
            continue
        valid = np.isfinite(samples)
        pixels[index] = valid.sum(axis=0).min(initial=len(samples))
        lost_part[index] = 1 - valid.all(axis=1).mean() if len(samples) else 1.0
        if pixels[index] < fewest_pixels:
            mistakes.append(f"{labels[index]} has {pixels[index]} valid of {len(samples)} pixels")
            continue
        for channel in range(3):
            mean, deviation, count = trimmed_mean(samples[valid[:, channel], channel])
            rgb[index, channel] = mean
            noise[index, channel] = deviation / np.sqrt(max(count * independent[channel], 1.0))
    if mistakes:
        raise CalibrateError(
            f"correct.chart: {'; '.join(mistakes)}; every patch needs at least {fewest_pixels} pixels inside the image "
            "that are neither clipped nor lost. Photograph the chart larger, add a shorter (clipped) or longer (too dark) "
            "exposure, or give the four corners in `correct.chart`."
        )
    return Patches(rgb=rgb, noise=noise, pixels=pixels, lost=lost_part)


def samples_in_polygon(
    image: npt.NDArray[np.float32],
    polygon: npt.NDArray[np.float64],
    *,
    lost: npt.NDArray[np.bool_] | None = None,
    latlong: bool = False,
) -> npt.NDArray[np.float64] | None:
    """Return the samples [N, 3] whose pixel centres lie in a convex polygon [M, 2] (either sense of rotation).

    Marked samples are NaN. None if the polygon reaches beyond the image (beyond its sides is fine in a lat-long map).
    """
    height, width = image.shape[:2]
    low, high = np.ceil(polygon.min(axis=0)).astype(int), np.floor(polygon.max(axis=0)).astype(int)
    if low[1] < 0 or high[1] >= height or (not latlong and (low[0] < 0 or high[0] >= width)):
        return None
    y, x = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    sides = np.roll(polygon, -1, axis=0) - polygon
    crosses = [dx * (y - y0) - dy * (x - x0) for (x0, y0), (dx, dy) in zip(polygon, sides, strict=True)]
    inside = np.all([cross >= 0 for cross in crosses], axis=0) | np.all([cross <= 0 for cross in crosses], axis=0)
    rows, columns = y[inside], x[inside] % width
    samples: npt.NDArray[np.float64] = image[rows, columns].astype(np.float64)
    if lost is not None:
        samples[lost[rows, columns]] = np.nan
    return samples


def trimmed_mean(values: npt.NDArray[np.float64]) -> tuple[float, float, int]:
    """Return mean, standard deviation and number of `values` [N] without outliers (N ≥ 1)."""
    median = np.median(values)
    reach = _OUTLIER_SIGMAS * _SIGMA_PER_MAD * float(np.median(np.abs(values - median)))
    # With more than half of the values equal, the reach is zero; then only those equal ones are no outliers.
    kept = values[np.abs(values - median) <= reach + 1e-12 * abs(median)]
    return float(kept.mean()), float(kept.std(ddof=1)) if len(kept) > 1 else 0.0, len(kept)
