"""Where the patches of a chart lie, and the record that says where one stands in an image.

Lengths are in chart units, of which a patch and a gap together have 2.75 on every chart. Of a Classic a unit is 16 mm: its
patches are 40 mm wide (2.5), the dark gaps 4 mm (0.25). The chart's *box* is the grid of patches with one gap around it: of a
Classic 16.75 × 11.25 units. The frame of the chart beyond it is not counted, as it differs between editions.

A Passport has the grid of a Classic with wider gaps (12.4 mm patches every 15 mm), other editions and sizes have others in
between. Where the middles of the patches are is the same for all of them, and that is what is sought; of a patch
only the central half is sampled.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError

# A patch and a gap.
PITCH: Final = 2.75

# Corners from a detector are off by a tenth of a patch or two; the central half of a patch stays inside it then.
SAMPLED_PART: Final = 0.5

Points = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Layout:
    """The grid of a chart: `columns` × `rows` patches, listed row by row, with gaps of `gap_width` (chart units) between them.

    `first`, `white` and `last` are what the patches at the top left, the white patch and the one at the bottom right are called;
    `white_patch` and `neutrals` are the indices of the white and of a scale of greys.
    """

    name: str
    columns: int
    rows: int
    gap_width: float
    white_patch: int
    neutrals: tuple[int, ...]
    first: str
    white: str
    last: str

    @property
    def count(self) -> int:
        """How many patches there are."""
        return self.columns * self.rows

    @property
    def patch_width(self) -> float:
        return PITCH - self.gap_width

    @property
    def box(self) -> tuple[float, float]:
        """Width and height of the box."""
        return self.columns * PITCH + self.gap_width, self.rows * PITCH + self.gap_width

    @property
    def places(self) -> Points:
        """Where the patches are [N, 2]: columns and rows from −½ to ½."""
        rows, columns = np.divmod(np.arange(self.count), self.columns)
        return np.stack([columns / (self.columns - 1) - 0.5, rows / (self.rows - 1) - 0.5], axis=-1)


CLASSIC: Final = Layout(
    name="ColorChecker",
    columns=6,
    rows=4,
    gap_width=0.25,
    white_patch=18,
    neutrals=tuple(range(18, 24)),
    first="dark skin",
    white="white",
    last="black",
)
# Patches of 12.7 mm every 15.2 mm (ArgyllCMS, ref/ColorCheckerSG.cht). A scale of greys is E5 to J5, as of a Classic, whose
# patches E2 to J5 repeat.
SG: Final = Layout(
    name="ColorChecker Digital SG",
    columns=14,
    rows=10,
    gap_width=0.453,
    white_patch=4 * 14 + 4,
    neutrals=tuple(range(4 * 14 + 4, 4 * 14 + 10)),
    first="A1",
    white="E5",
    last="N10",
)
# Where the patches of a Classic stand on an SG.
CLASSIC_ON_SG: Final = tuple(14 * row + column for row in range(1, 5) for column in range(4, 10))


@dataclass(frozen=True, slots=True)
class ChartFound:
    """A chart in an image.

    `corners` [4, 2] of the box (TL, TR, BR, BL as printed on the chart: of a Classic dark skin is at TL, black at BR) and `quads`
    [N, 4, 2], the part of each patch that is to be sampled, in pixels (x, y), integer = pixel centre. In a lat-long map x
    may leave [0, W): it is continuous across the seam. `score` is the mean CIEDE2000 of a 3×3 fit against the
    reference, without the worst patches (a twelfth; NaN for corners from the settings). `outline` [N, 2] is the border of the box
    as it runs through the image (curved in a lat-long map).
    """

    corners: Points
    quads: Points
    outline: Points
    score: float
    warnings: tuple[str, ...] = ()


def box_corners(layout: Layout = CLASSIC) -> Points:
    """Return the corners [4, 2] of the box in chart units: TL, TR, BR, BL."""
    width, height = layout.box
    return np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float64)


def patch_quads(part: float = SAMPLED_PART, layout: Layout = CLASSIC) -> Points:
    """Return the central `part` (of the width) of each patch [N, 4, 2] in chart units, row by row."""
    half = part * layout.patch_width / 2
    rows, columns = np.divmod(np.arange(layout.count), layout.columns)
    centres = layout.gap_width + layout.patch_width / 2 + PITCH * np.stack([columns, rows], axis=-1)
    square = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.asarray(centres[:, None, :] + square)


def box_outline(layout: Layout = CLASSIC, points_per_side: int = 12) -> Points:
    """Return points [4 × points_per_side, 2] along the border of the box in chart units, clockwise from TL."""
    corners = box_corners(layout)
    steps = np.arange(points_per_side)[:, None] / points_per_side
    return np.concatenate([a + (b - a) * steps for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)])


def image_from_chart(corners: Points, layout: Layout = CLASSIC) -> Points:
    """Return the homography [3, 3] from chart units to pixels for a box with these corners [4, 2]."""
    return np.asarray(
        cv2.getPerspectiveTransform(box_corners(layout).astype(np.float32), np.asarray(corners).astype(np.float32)),
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


def chart_from_corners(corners: Points, layout: Layout = CLASSIC) -> ChartFound:
    """Return the chart whose box has the given corners [4, 2] in pixels: TL, TR, BR, BL (the first patch at TL).

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
            f"{where}: they run anticlockwise, which shows a mirrored chart; expected clockwise from the corner of "
            f"'{layout.first}'. Give them as TL, TR, BR, BL, or flip the image back."
        )
    if not (turns > 0).all():
        raise CalibrateError(
            f"{where}: they form no convex quadrilateral; expected TL, TR, BR, BL of the patches' box in that order."
        )
    homography = image_from_chart(box, layout)
    return ChartFound(
        corners=box,
        quads=project(homography, patch_quads(layout=layout)),
        outline=project(homography, box_outline(layout)),
        score=float("nan"),
    )
