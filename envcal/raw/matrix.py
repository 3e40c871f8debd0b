"""What is published of a camera's colours: its matrix under D65."""

from pathlib import Path

import numpy as np

from envcal.raw.exif import numbers, read_tags
from envcal.raw.opening import opened

Matrix = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

# DNG: ColorMatrix2 and its CalibrationIlluminant2, the same of 1; 21 is EXIF's D65.
_DNG_MATRICES = (("0xC622", "0xC65B"), ("0xC621", "0xC65A"))
_DNG_D65 = 21

# LibRaw gives zeros for a camera it does not know; matrices of real ones have determinants from 0.05 on.
_LEAST_DETERMINANT = 1e-3


def camera_from_xyz(path: Path | str) -> Matrix | None:
    """Return the matrix [3][3] from XYZ to camera RGB under D65 that LibRaw or the file itself knows, None without one."""
    path = Path(path)
    exif = read_tags(path)
    known = np.zeros((3, 3))
    for matrix, illuminant in _DNG_MATRICES:
        values = numbers(exif, matrix)
        if numbers(exif, illuminant)[:1] == [_DNG_D65] and len(values) == 9:
            known = np.array([float(v) for v in values]).reshape(3, 3)
    if not known.any():
        with opened(path, exif) as raw:
            known = np.asarray(raw.rgb_xyz_matrix, np.float64)[:3]
    if known.shape != (3, 3) or not np.isfinite(known).all() or abs(np.linalg.det(known)) < _LEAST_DETERMINANT:
        return None
    a, b, c = ((float(x), float(y), float(z)) for x, y, z in known)
    return a, b, c
