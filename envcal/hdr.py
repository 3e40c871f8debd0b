"""Radiance .hdr maps, decoded by OpenCV. The only module that reads them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from envcal.errors import EnvcalError
from envcal.exr import LONGEST_SIDE, MOST_PIXELS


def read_hdr(path: Path) -> tuple[npt.NDArray[np.float32], tuple[float, ...] | None]:
    """Return the image [height, width, 3] as linear RGB, and the primaries (8 numbers) if the header names them."""
    import cv2

    if not path.is_file():
        raise EnvcalError(f"{path}: there is no such file.")
    with path.open("rb") as handle:
        start = handle.read(1 << 14)
    if not start.startswith((b"#?RADIANCE", b"#?RGBE")):
        raise EnvcalError(f"{path}: is not a Radiance picture. Give an .hdr or .exr map.")
    if b"FORMAT=32-bit_rle_xyze" in start:
        raise EnvcalError(f"{path}: holds XYZ (32-bit_rle_xyze), not RGB. Convert it with `ra_xyze -r`.")
    size = re.search(rb"\n-Y (\d{1,9}) \+X (\d{1,9})\n", start)
    if size is None:
        raise EnvcalError(f"{path}: has no `-Y height +X width` line; rotated pictures are not taken. Save it upright.")
    height, width = int(size[1]), int(size[2])
    if not (0 < max(height, width) <= LONGEST_SIDE and 0 < height * width <= MOST_PIXELS):
        raise EnvcalError(f"{path}: {width}×{height} pixels; at most {LONGEST_SIDE} a side are taken. Scale it down.")
    image = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.shape != (height, width, 3):
        raise EnvcalError(f"{path}: is truncated or damaged. Copy or make the file again.")
    primaries = re.search(rb"\nPRIMARIES=\s*((?:[-+.\deE]+\s+){7}[-+.\deE]+)\s*\n", start)
    named = None if primaries is None else tuple(float(v) for v in primaries[1].split())
    if named is not None and min(named[1::2]) <= 0:
        named = None  # some editors write zeros where they know nothing
    return np.ascontiguousarray(image[..., ::-1], dtype=np.float32), named
