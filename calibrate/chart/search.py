"""Candidates for the chart in a picture, at every size and threshold, aligned and judged.

Nothing that looks like a grid is believed unseen: the box of each is judged by a fit against the published colours,
drawn to the patches by `align`, and judged once more.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate.chart.align import align
from calibrate.chart.geometry import Layout, signed_area
from calibrate.chart.judge import LARGEST_SCORE, best_order, best_orders, glance, glances
from calibrate.chart.lattice import grids
from calibrate.chart.reference import ChartReference
from calibrate.chart.views import View
from calibrate.chart.windows import windows
from calibrate.chart.zones import Zones, flat_zones

# A chart lit by one light fits within 1–4; below this, other attempts can hardly do better.
_EXCELLENT_SCORE: Final = 4.5
# Up to this score a box may be a chart's that is off by half a patch, and is worth aligning; a place without a chart
# scores 22 and more.
WORTH_ALIGNING: Final = 22.0
# What a box that could not be drawn to the patches counts for in the choice, in ΔE.
_NOT_ALIGNED: Final = 4.0
# The gaps say better where the box is than the fit does: off by a little, it may see less of a patch's glare. So much more (ΔE)
# is no objection.
_LOSS_ALLOWED: Final = 4.0
# Long sides of the picture at which it is searched, then its own size, and twice that where it is small: the gaps of a
# chart of 100 pixels are hardly a pixel wide.
_LONG_SIDES: Final = (700, 1500, 3200)
_ENLARGED: Final = 2.0
_COARSEST_SIDE: Final = 400
_MOST_ENLARGED_PIXELS: Final = 12_000_000
# Patches between these sizes are looked for at each size of the picture, in its pixels.
_SMALLEST_PATCH: Final = 14.0
_LARGEST_PATCH: Final = 130.0**2
_SMALLEST_BOX: Final = 400.0
_MOST_BOXES: Final = 4
# Further charts are looked for in a picture that is no longer than this.
_FURTHER_SIDE: Final = 1500.0
# Middles that are nearer than this part of the way to the nearest corner belong to the same chart or to a part of it; two charts
# that touch at their long sides are 1.1 apart.
_ON_EACH_OTHER: Final = 0.8
# Boxes whose corners differ by less, in parts of half the box, are aligned to the same place.
_SAME: Final = 0.03


@dataclass(frozen=True, slots=True)
class Found:
    """A box before it is drawn to its patches: its corners as they were found, its score, and their order by the colours.

    Of a map, the corners are pixels of the `view`.
    """

    corners: npt.NDArray[np.float64]
    score: float
    order: tuple[int, int, int, int]
    view: View | None = None

    @property
    def place(self) -> npt.NDArray[np.float64]:
        """What can be compared between views: pixels [4, 2], or directions [4, 3]."""
        return self.corners if self.view is None else self.view.directions(self.corners)

    @property
    def in_order(self) -> npt.NDArray[np.float64]:
        return self.corners[list(self.order)]


@dataclass(frozen=True, slots=True)
class Candidate:
    """A box in an image, in the order of its colours, with the fit's mean ΔE as its score."""

    corners: npt.NDArray[np.float64]
    score: float
    aligned: bool

    @property
    def mirrored(self) -> bool:
        return signed_area(self.corners) < 0

    @property
    def excellent(self) -> bool:
        return self.aligned and self.score <= _EXCELLENT_SCORE and not self.mirrored

    @property
    def acceptable(self) -> bool:
        return self.aligned and self.score <= LARGEST_SCORE

    @property
    def rank(self) -> float:
        # A mirror in the room may show the chart too: the chart itself comes first, then its image, then anything else.
        none = 0.0 if self.score <= LARGEST_SCORE else 2 * LARGEST_SCORE
        return self.score + (0 if self.aligned else _NOT_ALIGNED) + (LARGEST_SCORE if self.mirrored else 0) + none


@dataclass(frozen=True, slots=True)
class Known:
    """A chart that was found, by its `place` as of `Found`: what covers it is no other one."""

    place: npt.NDArray[np.float64]

    def covers(self, found: Found) -> bool:
        """Whether a box and this chart have their middles on each other."""
        middles = [place.mean(axis=0) for place in (self.place, found.place)]
        reach = max(
            np.linalg.norm(place - middle, axis=1).min()
            for place, middle in zip((self.place, found.place), middles, strict=True)
        )
        return bool(np.linalg.norm(middles[0] - middles[1]) < _ON_EACH_OTHER * reach)


def better(best: Candidate | None, candidate: Candidate) -> Candidate:
    """Return the likelier of two candidates."""
    return candidate if best is None or candidate.rank < best.rank else best


def scales(size: tuple[int, int]) -> list[float]:
    """Return the factors by which a picture of `size` (H, W) is resized for the search."""
    long_side = max(size)
    factors = [side / long_side for side in _LONG_SIDES if side < 0.85 * long_side] + [1.0]
    if size[0] * size[1] * _ENLARGED**2 <= _MOST_ENLARGED_PIXELS:
        factors.append(_ENLARGED)
    # Last, for a large chart whose gaps are blurred and noisy.
    if long_side > 1.15 * _COARSEST_SIDE:
        factors.append(_COARSEST_SIDE / long_side)
    return factors


def search_picture(
    image: npt.NDArray[np.float32], logarithm: npt.NDArray[np.float32], reference: ChartReference
) -> Candidate | None:
    """Return the likeliest chart of a picture [H, W, 3] of the relative `logarithm`; None if there is nothing that might be one."""
    best: Candidate | None = None
    for scale in scales(image.shape[:2]):
        for candidate in candidates(logarithm, image, reference, scale):
            best = better(best, candidate)
            if best.excellent:
                return best
        if best is not None and best.acceptable and not best.mirrored:
            return best
    return best


def further_in_picture(
    image: npt.NDArray[np.float32], logarithm: npt.NDArray[np.float32], reference: ChartReference, known: Known
) -> list[Candidate]:
    """Return what may be charts beside the one that is known."""
    apart, further = [known], []
    for scale in further_scales(image.shape[:2]):
        for candidate in candidates(logarithm, image, reference, scale, apart=apart):
            if candidate.acceptable:
                further.append(candidate)
                apart.append(Known(candidate.corners))
    return further


def further_scales(size: tuple[int, int]) -> list[float]:
    """Return the factors by which a picture of `size` (H, W) is resized to look for more than one chart: none is expensive."""
    return [scale for scale in scales(size) if scale <= 1 and scale * max(size) <= _FURTHER_SIDE]


def candidates(
    logarithm: npt.NDArray[np.float32],
    image: npt.NDArray[np.float32],
    reference: ChartReference,
    scale: float,
    *,
    apart: Sequence[Known] = (),
) -> Iterator[Candidate]:
    """Yield what may be the chart in `image`, whose relative `logarithm` is resized by `scale` for the search; likeliest first.

    All that is found at any threshold is judged before the first is drawn to its patches. Boxes that cannot be the chart's
    are left out, but for the best one, and so is all that covers one of the charts `apart`.
    """
    found = [
        Found(box, *judged)
        for boxes in _boxes(resized(logarithm, scale), scale, image.shape[:2], reference.layout)
        for box, judged in zip(boxes, best_orders(glances(image, boxes, reference.layout), reference), strict=True)
    ]
    if apart:
        found = [each for each in found if not any(chart.covers(each) for chart in apart)]
    for best in likeliest(found):
        if any(chart.covers(best) for chart in apart):  # found since
            continue
        yield aligned_and_judged(image, best.in_order, reference)


def resized(logarithm: npt.NDArray[np.float32], scale: float) -> npt.NDArray[np.float32]:
    """Return a picture [H, W, 3] resized by a factor."""
    if scale == 1:
        return logarithm
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(logarithm, None, fx=scale, fy=scale, interpolation=method), dtype=np.float32)


def zones_at(logarithm: npt.NDArray[np.float32]) -> list[Zones]:
    """Return the zones of each threshold that may be patches in a relative logarithm, as it is resized."""
    return flat_zones(logarithm, smallest=_SMALLEST_PATCH, largest=_LARGEST_PATCH)


def _boxes(
    seen: npt.NDArray[np.float32], scale: float, size: tuple[int, int], layout: Layout
) -> Iterator[npt.NDArray[np.float64]]:
    """Yield for each lattice its boxes [K, 4, 2] in pixels of the image of `size` before it was resized."""
    for zones in zones_at(seen):
        for places, indices in grids(zones, layout):
            # Pixel centres are integers, so a resized image's coordinates shift by half a pixel as well.
            boxes = windows(places, (zones.centres[indices] + 0.5) / scale - 0.5, layout)
            boxes = boxes[[plausible(box, size) for box in boxes]]
            if len(boxes):
                yield boxes


def likeliest(found: list[Found]) -> Iterator[Found]:
    """Yield the few best boxes that differ from each other, the best first; after it, only those worth aligning."""
    taken: list[Found] = []
    for box in sorted(found, key=lambda each: each.score):
        if len(taken) == _MOST_BOXES or (taken and not box.score <= WORTH_ALIGNING):
            return
        if any(same(box.place, other.place) for other in taken):
            continue
        taken.append(box)
        yield box


def aligned_and_judged(
    image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64], reference: ChartReference
) -> Candidate:
    """Return the box drawn to the patches, or as given if that fails or fits worse."""
    score, order = best_order(glance(image, corners, reference.layout), reference)
    given = Candidate(corners[list(order)], score, aligned=False)
    if not score <= WORTH_ALIGNING:
        return given
    drawn = align(image, given.corners, reference.layout)
    if drawn is None or not plausible(drawn, image.shape[:2]):
        return given
    score, order = best_order(glance(image, drawn, reference.layout), reference)
    if score > given.score + _LOSS_ALLOWED:
        return given
    return Candidate(drawn[list(order)], score, aligned=True)


def plausible(box: npt.NDArray[np.float64], size: tuple[int, int]) -> bool:
    """Whether a box is convex, large enough to have patches, and mostly inside the image."""
    edges = np.roll(box, -1, axis=0) - box
    after = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0]
    if not ((turns > 0).all() or (turns < 0).all()) or abs(signed_area(box)) < _SMALLEST_BOX:
        return False
    reach = 0.05 * np.hypot(*edges.T).max()
    high = np.array([size[1] - 1, size[0] - 1]) + reach
    return bool((box >= -reach).all() and (box <= high).all())


def same(one: npt.NDArray[np.float64], other: npt.NDArray[np.float64]) -> bool:
    """Whether two boxes cover the same place, whichever corner comes first."""
    nearest = np.abs(one[:, None] - other[None]).max(axis=2).min(axis=1)
    return bool(nearest.max() < _SAME * np.abs(one - one.mean(axis=0)).max())
