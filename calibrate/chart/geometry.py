"""Where the 24 patches of a ColorChecker lie, and the two records that say where one stands in an image.

Lengths are in units of 16 mm: a patch is 40 mm wide (2.5), the dark gap between two is 4 mm (0.25). The chart's *box* is the
grid of 6 × 4 patches with one gap around it: 16.75 × 11.25 units. The frame of the chart beyond it is not counted, as it
differs between editions.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError

PATCH_WIDTH: Final = 2.5
GAP_WIDTH: Final = 0.25
COLUMNS: Final = 6
ROWS: Final = 4
BOX_WIDTH: Final = COLUMNS * PATCH_WIDTH + (COLUMNS + 1) * GAP_WIDTH
BOX_HEIGHT: Final = ROWS * PATCH_WIDTH + (ROWS + 1) * GAP_WIDTH

# Corners from a detector are off by a tenth of a patch or two; the central half of a patch stays inside it then.
SAMPLED_PART: Final = 0.5

Points = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ChartFound:
    """A chart in an image.

    `corners` [4, 2] of the box (TL, TR, BR, BL as printed on the chart: dark skin is at TL, black at BR) and `quads`
    [24, 4, 2], the part of each patch that is to be sampled, in pixels (x, y), integer = pixel centre. In a lat-long map x
    may leave [0, W): it is continuous across the seam. `score` is the mean CIEDE2000 of a 3×3 fit against the
    reference, without the two worst patches (NaN for corners from the settings). `outline` [N, 2] is the border of the box
    as it runs through the image (curved in a lat-long map).
    """

    corners: Points
    quads: Points
    outline: Points
    score: float
    warnings: tuple[str, ...] = ()


def box_corners() -> Points:
    """Return the corners [4, 2] of the box in chart units: TL, TR, BR, BL."""
    return np.array([[0, 0], [BOX_WIDTH, 0], [BOX_WIDTH, BOX_HEIGHT], [0, BOX_HEIGHT]], dtype=np.float64)


def patch_quads(part: float = SAMPLED_PART) -> Points:
    """Return the central `part` (of the width) of each patch [24, 4, 2] in chart units, row by row from dark skin."""
    pitch, half = PATCH_WIDTH + GAP_WIDTH, part * PATCH_WIDTH / 2
    rows, columns = np.divmod(np.arange(ROWS * COLUMNS), COLUMNS)
    centres = GAP_WIDTH + PATCH_WIDTH / 2 + pitch * np.stack([columns, rows], axis=-1)
    square = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.asarray(centres[:, None, :] + square)


def box_outline(points_per_side: int = 12) -> Points:
    """Return points [4 × points_per_side, 2] along the border of the box in chart units, clockwise from TL."""
    corners = box_corners()
    steps = np.arange(points_per_side)[:, None] / points_per_side
    return np.concatenate([a + (b - a) * steps for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)])


def image_from_chart(corners: Points) -> Points:
    """Return the homography [3, 3] from chart units to pixels for a box with these corners [4, 2]."""
    return np.asarray(
        cv2.getPerspectiveTransform(box_corners().astype(np.float32), np.asarray(corners).astype(np.float32)),
        dtype=np.float64,
    )


def project(homography: Points, points: Points) -> Points:
    """Return `points` [..., 2] mapped by a homography [3, 3]."""
    flat = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    lifted = np.column_stack([flat, np.ones(len(flat))]) @ homography.T
    return np.asarray((lifted[:, :2] / lifted[:, 2:]).reshape(np.shape(points)))


def signed_area(corners: Points) -> float:
    """Return the area of a polygon [N, 2] in px²; positive when it runs clockwise as seen (y points down)."""
    x, y = np.asarray(corners, dtype=np.float64).T
    return float(0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def chart_from_corners(corners: Points) -> ChartFound:
    """Return the chart whose box has the given corners [4, 2] in pixels: TL, TR, BR, BL (dark skin at TL).

    Raises
    ------
    CalibrateError
        If the four points are no convex quadrilateral run through clockwise (a mirrored chart runs anticlockwise).
    """
    box = np.asarray(corners, dtype=np.float64)
    where = f"correct.chart: corners {box.round(1).tolist()}"
    if box.shape != (4, 2) or not np.isfinite(box).all():
        raise CalibrateError(f"{where}: expected four points [x, y] in pixels: TL, TR, BR, BL of the patches' box.")
    edges = np.roll(box, -1, axis=0) - box
    after = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0]
    if signed_area(box) < 0 and (turns < 0).all():
        raise CalibrateError(
            f"{where}: they run anticlockwise, which shows a mirrored chart; expected clockwise from the corner of 'dark "
            "skin'. Give them as TL, TR, BR, BL, or flip the image back."
        )
    if not (turns > 0).all():
        raise CalibrateError(
            f"{where}: they form no convex quadrilateral; expected TL, TR, BR, BL of the patches' box in that order."
        )
    homography = image_from_chart(box)
    return ChartFound(
        corners=box,
        quads=project(homography, patch_quads()),
        outline=project(homography, box_outline()),
        score=float("nan"),
    )
