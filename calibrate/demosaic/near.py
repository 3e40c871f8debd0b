"""The mean of the nearest samples of each colour, for patterns that no special method is made for."""

import cv2
import numpy as np
import numpy.typing as npt

from calibrate.exposure import LINEAR, MONOCHROME

Plane = npt.NDArray[np.float32]

# Weights fall with the distance as a Gaussian of this many photosites; every colour of a 6×6 pattern has samples within
# two photosites of any place.
_SIGMA, _REACH = 0.8, 2


def interpolate_near(samples: Plane, cfa: str) -> npt.NDArray[np.float32]:
    """Return the image (H, W, 3) of a mosaic whose pattern is square; see `demosaic`.

    Each missing colour is the mean of its samples within two photosites, by their distance: a convex mean, so it neither
    rings nor leaves their range. A channel is NaN where its own sample is lost, or one that lies beside it.
    """
    height, width = samples.shape
    side = round(len(cfa) ** 0.5)
    pattern = np.array(list(cfa)).reshape(side, side)
    offsets = np.arange(-_REACH, _REACH + 1)
    kernel = np.exp(-(offsets[:, None] ** 2 + offsets**2) / (2 * _SIGMA**2)).astype(np.float32)
    finite = np.isfinite(samples)
    image = np.empty((height, width, 3), np.float32)
    for k, colour in enumerate("RGB"):
        of = np.tile(pattern == colour, (height // side + 1, width // side + 1))[:height, :width]
        known = of & finite
        values = np.where(known, samples, np.float32(0))
        above = cv2.filter2D(values, cv2.CV_32F, kernel, borderType=cv2.BORDER_REFLECT_101)
        below = cv2.filter2D(known.astype(np.float32), cv2.CV_32F, kernel, borderType=cv2.BORDER_REFLECT_101)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = above / below
        # Sums in float32 leave the range by a rounding.
        cube = np.ones((2 * _REACH + 1,) * 2, np.uint8)
        largest = cv2.dilate(np.where(known, samples, -np.inf).astype(np.float32), cube)
        smallest = cv2.erode(np.where(known, samples, np.inf).astype(np.float32), cube)
        mean = np.clip(mean, smallest, largest)
        beside = cv2.dilate((of & ~finite).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        mean[beside] = np.nan
        image[..., k] = np.where(of, np.where(finite, samples, np.nan), mean)
    return image


def spread(deviation: Plane, cfa: str) -> npt.NDArray[np.float32]:
    """Return the standard deviation of a measured sample of each colour at every place, shape (H, W, 3).

    That of the nearest samples, averaged; the interpolated value itself is quieter, being a mean of several.
    """
    if cfa == MONOCHROME:
        return np.repeat(deviation[..., None], 3, axis=2)
    if cfa == LINEAR:
        return deviation.reshape(deviation.shape[0], -1, 3)
    return interpolate_near(deviation, cfa)
