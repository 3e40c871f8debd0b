"""Attempts of OpenCV's chart detector, at several exposures, curves and turns, aligned and judged.

`cv2.mcc` is brittle against exposure and scale, and content with mirrored or false charts. So nothing it says is believed
unseen: the box of each attempt is drawn to the patches by `align`, then judged by a fit against the published colours.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate.chart.align import align
from calibrate.chart.geometry import signed_area
from calibrate.chart.judge import LARGEST_SCORE, best_order, glance
from calibrate.chart.reference import ChartReference

# A chart lit by one light fits within 1–4; below this, other attempts can hardly do better.
_EXCELLENT_SCORE: Final = 4.5
# Up to this score a box may be a chart's that is off by half a patch, and is worth aligning; a place without a chart
# scores 25 and more.
WORTH_ALIGNING: Final = 22.0
# What a box that could not be drawn to the patches counts for in the choice, in ΔE.
_NOT_ALIGNED: Final = 4.0
# (percentile of the brightest channel that becomes white, sRGB curve?), the likeliest first.
_EXPOSURES: Final = (
    (97.0, True),
    (90.0, True),
    (99.5, True),
    (97.0, False),
    (75.0, True),
    (90.0, False),
    (99.5, False),
)
_PERCENTILES: Final = tuple(sorted({percentile for percentile, _ in _EXPOSURES}))
# Quarter turns of the picture: the detector finds charts of any rotation, but now and then one clutter of background
# hides a chart from it at all exposures, and a quarter turn brings it back.
TURNS: Final = (0, 2, 1, 3)
# A fit to the middles of the patches hardly notices a box that is off a little: so small a loss (ΔE) is no objection.
SMALL_LOSS: Final = 0.5


@dataclass(frozen=True, slots=True)
class Candidate:
    """A box in an image, in the order of its colours, with the detector's cost and the fit's mean ΔE as its score."""

    corners: npt.NDArray[np.float64]
    cost: float
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
        return self.score + (0 if self.aligned else _NOT_ALIGNED) + (LARGEST_SCORE if self.mirrored else 0)


def better(best: Candidate | None, candidate: Candidate) -> Candidate:
    """Return the likelier of two candidates."""
    return candidate if best is None or candidate.rank < best.rank else best


def attempts_on(
    image: npt.NDArray[np.float32],
    reference: ChartReference,
    scale: float,
    *,
    exposures: int = len(_EXPOSURES),
    rounds: int = len(TURNS),
) -> Iterator[Candidate]:
    """Yield what the detector takes for the chart in `image`, one attempt after the other, aligned and judged.

    Each round goes through the exposures, with the turns shifted by one against the round before.
    """
    small = image
    if scale < 1:
        small = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.float32)
    brightest = small.max(axis=2)
    brightest = brightest[np.isfinite(brightest) & (brightest > 0)]
    if brightest.size == 0:
        return
    whites = dict(zip(_PERCENTILES, np.percentile(brightest, _PERCENTILES), strict=True))
    for attempt in range(exposures * rounds):
        percentile, curve = _EXPOSURES[attempt % exposures]
        turns = TURNS[(attempt // exposures + attempt % exposures) % len(TURNS)]
        found = _detect(_eight_bit(small, float(whites[percentile]), srgb_curve=curve), turns)
        if found is None:
            continue
        box, cost = found
        # Pixel centres are integers, so a reduced image's coordinates shift by half a pixel as well.
        corners = (box + 0.5) / scale - 0.5
        if np.isfinite(corners).all() and abs(signed_area(corners)) > 100:
            yield aligned_and_judged(image, corners, cost, reference)


def _eight_bit(image: npt.NDArray[np.float32], white: float, *, srgb_curve: bool) -> npt.NDArray[np.uint8]:
    """Return BGR bytes with `white` at 255; lost pixels are white, as most are clipped."""
    levels = np.nan_to_num(image[..., ::-1] * np.float32(4095 / white), nan=4095.0, posinf=4095.0)
    return np.asarray(np.take(_curve(srgb_curve), np.clip(levels + 0.5, 0, 4095).astype(np.uint16)), dtype=np.uint8)


@functools.cache
def _curve(srgb: bool) -> npt.NDArray[np.uint8]:
    """Bytes for 4096 linear levels."""
    value = np.linspace(0, 1, 4096)
    if srgb:
        value = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return (value * 255 + 0.5).astype(np.uint8)


def _detect(bgr: npt.NDArray[np.uint8], turns: int = 0) -> tuple[npt.NDArray[np.float64], float] | None:
    """Return box and cost of the best chart in a picture that is shown to the detector after some quarter turns."""
    detector = cv2.mcc.CCheckerDetector.create()
    # A fresh detector's type is uninitialised memory, and the best chart after a failed search a null pointer.
    detector.setColorChartType(cv2.mcc.MCC24)
    detector.setUseDnnModel(False)
    # One chart only: asked for more, it invents some.
    if not detector.process(np.ascontiguousarray(np.rot90(bgr, turns)), 1):
        return None
    chart = detector.getBestColorChecker()
    x, y = np.asarray(chart.getBox(), dtype=np.float64).reshape(4, 2).T
    height, width = bgr.shape[:2]
    # np.rot90 turns anticlockwise: pixel (x, y) comes to (y, width − 1 − x); undone here.
    if turns == 1:
        x, y = width - 1 - y, x
    elif turns == 2:
        x, y = width - 1 - x, height - 1 - y
    elif turns == 3:
        x, y = y, height - 1 - x
    return np.stack([x, y], axis=-1), float(chart.getCost())


def aligned_and_judged(
    image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64], cost: float, reference: ChartReference
) -> Candidate:
    """Return the box drawn to the patches, or as given if that fails or fits worse."""
    score, order = best_order(glance(image, corners), reference)
    given = Candidate(corners[list(order)], cost, score, aligned=False)
    if not score <= WORTH_ALIGNING:
        return given
    aligned = align(image, given.corners)
    if aligned is None:
        return given
    score, order = best_order(glance(image, aligned), reference)
    if score > given.score + SMALL_LOSS:
        return given
    return Candidate(aligned[list(order)], cost, score, aligned=True)
