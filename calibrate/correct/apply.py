"""A fitted matrix, applied to pictures."""

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.correct.model import root_terms

# Rows of a picture whose terms are in memory at the same time.
_ROWS_AT_A_TIME: Final = 256


def apply_matrix(image: npt.NDArray[np.float32], matrix: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """Return `matrix` [3, 3], or [3, 6] of a root-polynomial, applied to every pixel of `image` [H, W, 3]; a new array.

    A pixel's result depends on that pixel alone, so it is the same for any number of threads. NaN stays NaN (and spreads
    to the channels that depend on it).
    """
    pixels = np.ascontiguousarray(image, dtype=np.float32)
    if pixels.ndim != 3 or pixels.shape[2] != 3 or np.shape(matrix) not in {(3, 3), (3, 6)}:
        raise CalibrateError(
            f"apply_matrix: image of shape {np.shape(image)} and matrix of shape {np.shape(matrix)}; expected "
            "(height, width, 3) and (3, 3), or (3, 6) for a root-polynomial. Pass a colour image and such a matrix."
        )
    if np.shape(matrix) == (3, 3):
        return np.asarray(cv2.transform(pixels, np.asarray(matrix, dtype=np.float64)), dtype=np.float32)
    out = np.empty_like(pixels)
    for row in range(0, len(pixels), _ROWS_AT_A_TIME):
        part = root_terms(pixels[row : row + _ROWS_AT_A_TIME])
        out[row : row + _ROWS_AT_A_TIME] = part @ np.asarray(matrix, dtype=np.float32).T
    return out
