"""Candidates for the chart in a picture, at every size and threshold, aligned and judged.

Nothing that looks like a grid is believed unseen: the box of each is judged by a fit against the published colours,
drawn to the patches by `align`, and judged once more.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate.chart.align import align
from calibrate.chart.geometry import signed_area
from calibrate.chart.judge import LARGEST_SCORE, best_order, best_orders, glance
from calibrate.chart.lattice import grids
from calibrate.chart.reference import ChartReference
from calibrate.chart.zones import flat_zones, relative_logarithm

# A chart lit by one light fits within 1–4; below this, other attempts can hardly do better.
_EXCELLENT_SCORE: Final = 4.5
# Up to this score a box may be a chart's that is off by half a patch, and is worth aligning; a place without a chart
# scores 22 and more.
WORTH_ALIGNING: Final = 22.0
# What a box that could not be drawn to the patches counts for in the choice, in ΔE.
_NOT_ALIGNED: Final = 4.0
# A fit to the middles of the patches hardly notices a box that is off a little: so small a loss (ΔE) is no objection.
SMALL_LOSS: Final = 0.5
# Long sides of the picture at which it is searched, then its own size, and twice that where it is small: the gaps of a
# chart of 100 pixels are hardly a pixel wide.
_LONG_SIDES: Final = (700, 1500, 3200)
_ENLARGED: Final = 2.0
_MOST_ENLARGED_PIXELS: Final = 12_000_000
# Patches between these sizes are looked for at each size of the picture, in its pixels.
_SMALLEST_PATCH: Final = 14.0
_LARGEST_PATCH: Final = 130.0**2
_MOST_BOXES: Final = 3


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


def better(best: Candidate | None, candidate: Candidate) -> Candidate:
    """Return the likelier of two candidates."""
    return candidate if best is None or candidate.rank < best.rank else best


def scales(size: tuple[int, int]) -> list[float]:
    """Return the factors by which a picture of `size` (H, W) is resized for the search, coarse to fine."""
    long_side = max(size)
    factors = [side / long_side for side in _LONG_SIDES if side < 0.85 * long_side] + [1.0]
    if size[0] * size[1] * _ENLARGED**2 <= _MOST_ENLARGED_PIXELS:
        factors.append(_ENLARGED)
    return factors


def candidates(image: npt.NDArray[np.float32], reference: ChartReference, scale: float) -> Iterator[Candidate]:
    """Yield what may be the chart in `image`, resized by `scale` for the search, one threshold after the other.

    Boxes that cannot be the chart's are left out, but for the best one of each threshold.
    """
    seen = relative_logarithm(image)
    if scale != 1:
        method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        seen = np.asarray(cv2.resize(seen, None, fx=scale, fy=scale, interpolation=method), dtype=np.float32)
    done: list[npt.NDArray[np.float64]] = []
    for zones in flat_zones(seen, smallest=_SMALLEST_PATCH, largest=_LARGEST_PATCH):
        boxes = [box for lattice in grids(zones) for box in lattice]
        # Pixel centres are integers, so a resized image's coordinates shift by half a pixel as well.
        corners = [(box + 0.5) / scale - 0.5 for box in boxes]
        corners = [box for box in corners if np.isfinite(box).all() and plausible(box, image.shape[:2])]
        if not corners:
            continue
        judged = best_orders(np.stack([glance(image, box) for box in corners]), reference)
        ranked = sorted(range(len(corners)), key=lambda k: judged[k][0])
        for position, k in enumerate(ranked[:_MOST_BOXES]):
            score, order = judged[k]
            box = corners[k][list(order)]
            if position and (score > WORTH_ALIGNING or any(_same(box, other) for other in done)):
                continue
            done.append(box)
            yield aligned_and_judged(image, box, reference)


def aligned_and_judged(
    image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64], reference: ChartReference
) -> Candidate:
    """Return the box drawn to the patches, or as given if that fails or fits worse."""
    score, order = best_order(glance(image, corners), reference)
    given = Candidate(corners[list(order)], score, aligned=False)
    if not score <= WORTH_ALIGNING:
        return given
    drawn = align(image, given.corners)
    if drawn is None or not plausible(drawn, image.shape[:2]):
        return given
    score, order = best_order(glance(image, drawn), reference)
    if score > given.score + SMALL_LOSS:
        return given
    return Candidate(drawn[list(order)], score, aligned=True)


def plausible(box: npt.NDArray[np.float64], size: tuple[int, int]) -> bool:
    """Whether a box is convex, large enough to have patches, and mostly inside the image."""
    edges = np.roll(box, -1, axis=0) - box
    after = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0]
    if not ((turns > 0).all() or (turns < 0).all()) or abs(signed_area(box)) < 400:
        return False
    reach = 0.05 * np.hypot(*edges.T).max()
    high = np.array([size[1] - 1, size[0] - 1]) + reach
    return bool((box >= -reach).all() and (box <= high).all())


def _same(one: npt.NDArray[np.float64], other: npt.NDArray[np.float64]) -> bool:
    return bool(np.abs(one - other).max() < 0.01 * np.abs(one - one.mean(axis=0)).max())
