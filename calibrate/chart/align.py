"""Drawing a chart's box to its patches: by the gaps between them (`gaps`), or by the middles of their flat zones."""

from collections.abc import Iterator
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate.chart.gaps import between_gaps
from calibrate.chart.geometry import CLASSIC, Layout, signed_area
from calibrate.chart.judge import unevenness
from calibrate.chart.lattice import refined
from calibrate.chart.zones import flat_zones, relative_logarithm

# Where the given box was good already, both scatter by noise alone.
_SCATTER_ALLOWED: Final = 1.05
# Where neither the box nor the first ones by zones lead to the gaps, they are not seen.
_TRIED: Final = 2
# By so much must a later way make the patches scatter less than an earlier one.
_GAIN: Final = 0.95
# Size of a patch in the picture whose zones are looked at, and how far it is enlarged for that.
_SNAPPED_PATCH_PX: Final = 36.0
_LARGEST_ZOOM: Final = 4.0


def align(
    image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64], layout: Layout = CLASSIC
) -> npt.NDArray[np.float64] | None:
    """Return the corners [4, 2] for which the patches are where the box says.

    On the gaps, from the box as given or as the flat zones correct it; where too few gaps are seen, on the zones alone, if
    the patches scatter less then. None if neither finds the patches.
    """
    own = signed_area(corners) < 0
    box = corners[::-1] if own else corners
    drawn = between_gaps(image, box, layout)
    if drawn is None:
        best, scatter, found = box, unevenness(image, box, layout), False
        # In the order of trust: what comes later must be clearly better. Noise makes the scatter a poor judge of small
        # differences.
        for position, moved in enumerate(_snapped(image, box, layout)):
            drawn = between_gaps(image, moved, layout) if position < _TRIED else None
            if drawn is not None:
                break
            spread = unevenness(image, moved, layout)
            if spread < (_GAIN if found else _SCATTER_ALLOWED) * scatter:
                best, scatter, found = moved, spread, True
        else:
            drawn = best if found else None
    if drawn is None:
        return None
    return drawn[::-1] if own else drawn


def _snapped(
    image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64], layout: Layout
) -> Iterator[npt.NDArray[np.float64]]:
    """Yield boxes through the middles of the flat zones: of all thresholds, then of each."""
    part, local, offset = _cropped(image, corners)
    patch_px = np.sqrt(abs(signed_area(corners)) / np.prod(layout.box)) * layout.patch_width
    zoom = min(_LARGEST_ZOOM, _SNAPPED_PATCH_PX / patch_px)
    seen = relative_logarithm(part)
    method = cv2.INTER_AREA if zoom < 1 else cv2.INTER_CUBIC
    seen = np.asarray(cv2.resize(seen, None, fx=zoom, fy=zoom, interpolation=method), dtype=np.float32)
    area = (patch_px * zoom) ** 2
    zones = flat_zones(seen, smallest=0.02 * area, largest=4 * area)
    zoomed = (local + 0.5) * zoom - 0.5
    for several in (zones, *([one] for one in zones)):
        moved = refined(zoomed, several, layout)
        if moved is not zoomed:
            yield (moved + 0.5) / zoom - 0.5 + offset


def _cropped(
    image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """The part of the image around the box, the corners in it, and where it was cut out (x, y)."""
    height, width = image.shape[:2]
    low, high = corners.min(axis=0), corners.max(axis=0)
    border = 0.2 * (high - low) + 4
    x0, y0 = np.clip((low - border).astype(int), 0, [width - 1, height - 1])
    x1, y1 = np.clip((high + border).astype(int) + 1, [x0 + 1, y0 + 1], [width, height])
    offset = np.array([x0, y0], dtype=np.float64)
    return np.ascontiguousarray(image[y0:y1, x0:x1]), corners - offset, offset
