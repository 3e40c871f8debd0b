"""Finding the ColorChecker: OpenCV's detector, tried at several exposures, curves and sizes, and not believed unseen.

The detector (`cv2.mcc`) is brittle against exposure and scale and content with mirrored or false charts. So each
attempt's box is drawn to the patches by `align`, then judged by a fit against the published colours; the best fit of all attempts counts, and an excellent one ends the
search. In a lat-long map the attempts are made in perspective views.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.chart.align import align
from calibrate.chart.geometry import (
    ChartFound,
    box_outline,
    image_from_chart,
    patch_quads,
    project,
    signed_area,
)
from calibrate.chart.judge import LARGEST_SCORE, best_order, glance
from calibrate.chart.reference import ChartReference, chart_reference
from calibrate.chart.views import View, angular_extent, view_at, yaw_pitch

# A chart lit by one light fits within 1–4; below this, other attempts can hardly do better.
_EXCELLENT_SCORE: Final = 4.5
# A chart that is found, but fits less well (a developed photograph, uneven light), is looked at so many times.
_ENOUGH_ATTEMPTS: Final = 4
# Up to this score a box may be a chart's that is off by half a patch, and is worth aligning; a place without a chart
# scores 25 and more.
_WORTH_ALIGNING: Final = 22.0
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
_TURNS: Final = (0, 2, 1, 3)
_LONG_SIDES: Final = (1800, 1000)
_VIEW_SIDE: Final = 640
_VIEW_FIELD: Final = np.radians(90.0)
# Rows of views (pitch in degrees, views): the horizon first, then downwards (charts stand on tables and floors), then
# upwards. Neighbours overlap by 30° or so: a chart that is larger is found in the flat map.
_VIEW_ROWS: Final = ((0.0, 6), (-45.0, 5), (45.0, 5))
# How many candidates that fit, but not excellently, are worth the time of a closer look.
_CLOSER_LOOKS: Final = 4
# A map is reduced to this width for the views; a chart that is lost by that is too small to be measured anyway.
_WIDEST_MAP: Final = 4096
# A fit to the middles of the patches hardly notices a box that is off a little: so small a loss (ΔE) is no objection.
_SMALL_LOSS: Final = 0.5


@dataclass(frozen=True, slots=True)
class _Candidate:
    corners: npt.NDArray[np.float64]
    cost: float
    score: float
    aligned: bool

    @property
    def mirrored(self) -> bool:
        return signed_area(self.corners) < 0

    @property
    def excellent(self) -> bool:
        return self.aligned and self.score <= _EXCELLENT_SCORE

    @property
    def acceptable(self) -> bool:
        return self.aligned and self.score <= LARGEST_SCORE

    @property
    def rank(self) -> float:
        return self.score + (0 if self.aligned else _NOT_ALIGNED)


def find_chart(
    image: npt.NDArray[np.float32],
    reference: ChartReference | None = None,
    *,
    latlong: bool = False,
    largest_score: float = LARGEST_SCORE,
) -> ChartFound:
    """Return where the ColorChecker Classic 24 stands in `image` [H, W, 3] (linear camera or working RGB, any scale).

    NaN and negative pixels are allowed. With `latlong`, the image is a lat-long map, and the corners and
    patches follow its distortion. `reference` (default: after November 2014) and `largest_score` decide what is believed.

    Raises
    ------
    CalibrateError
        If there is no chart, only something that does not fit its published colours, or a mirrored one.
    """
    if image.ndim != 3 or image.shape[2] != 3 or min(image.shape[:2]) < 32:
        raise CalibrateError(
            f"correct.chart: an image of shape {image.shape}; expected (height, width, 3) of at least 32 pixels a side. "
            "Pass linear RGB."
        )
    pixels = np.ascontiguousarray(image, dtype=np.float32)
    known = reference or chart_reference()
    found = _search_map(pixels, known) if latlong else _search_picture(pixels, known)
    candidate, view = found
    if candidate is None:
        raise CalibrateError(
            "correct.chart: no ColorChecker found at any exposure and size; expected one with 24 patches in full view. "
            "Photograph it larger, sharper and evenly lit, or give the four corners of its patches in `correct.chart`."
        )
    if not candidate.score <= largest_score:
        raise CalibrateError(
            f"correct.chart: the best candidate, at {candidate.corners.round().astype(int).tolist()}, differs from the "
            f"published colours by a mean ΔE2000 of {candidate.score:.1f} after a 3×3 fit; a chart fits within "
            f"{largest_score:g}. Name the right edition in `correct.reference`, or give the four corners of the patches in "
            "`correct.chart`."
        )
    if candidate.mirrored:
        raise CalibrateError(
            f"correct.chart: the chart at {candidate.corners.round().astype(int).tolist()} is mirrored: its patches run "
            "anticlockwise from 'dark skin'. Flip the image back (a mirror ball or a mirrored export shows the scene mirrored)."
        )
    return _record(candidate, view)


def _record(candidate: _Candidate, view: View | None) -> ChartFound:
    homography = image_from_chart(candidate.corners)
    corners, quads = candidate.corners, project(homography, patch_quads())
    outline = project(homography, box_outline())
    if view is not None:
        corners, quads, outline = view.map_points(corners), view.map_points(quads), view.map_points(outline)
    warnings: tuple[str, ...] = ()
    if not candidate.aligned:
        warnings = (
            "correct.chart: the chart was found, but its box could not be drawn to the patches' edges and may be off by a "
            "fifth of a patch. Look at the outline in the report, or give the four corners in `correct.chart`.",
        )
    return ChartFound(
        corners=corners,
        quads=quads,
        outline=outline,
        cost=candidate.cost,
        score=candidate.score,
        warnings=warnings,
    )


def _search_picture(image: npt.NDArray[np.float32], reference: ChartReference) -> tuple[_Candidate | None, View | None]:
    long_side = max(image.shape[:2])
    sides = [side for side in _LONG_SIDES if side < long_side] + [long_side]
    best: _Candidate | None = None
    for side in sides:
        # Large pictures are slow; what two smaller sizes at every turn did not show gets one round.
        rounds = len(_TURNS) if side <= _LONG_SIDES[0] else 1
        since = 0
        for candidate in _attempts(image, reference, side / long_side, rounds=rounds):
            best = _better(best, candidate)
            since += best.acceptable
            if best.excellent or since >= _ENOUGH_ATTEMPTS:
                return best, None
    return best, None


def _search_map(
    environment: npt.NDArray[np.float32], reference: ChartReference
) -> tuple[_Candidate | None, View | None]:
    full = environment.shape[:2]
    reduced = environment
    if full[1] > _WIDEST_MAP:
        size = (_WIDEST_MAP, round(full[0] * _WIDEST_MAP / full[1]))
        reduced = np.asarray(cv2.resize(environment, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
    best: _Candidate | None = None
    best_view: View | None = None
    closer_looks = 0
    for view in _views(reduced, reference):
        for candidate in _attempts(view.render(reduced), reference, 1.0, exposures=3, rounds=1):
            if best is not None and candidate.rank >= best.rank:
                continue
            best, best_view = candidate, View(view.axes, view.side, view.focal_px, full)
            if best.score <= LARGEST_SCORE and closer_looks < _CLOSER_LOOKS:
                closer_looks += 1
                best, best_view = _closer(environment, best, best_view, reference)
            if best.excellent:
                return best, best_view
    return best, best_view


def _closer(
    environment: npt.NDArray[np.float32], best: _Candidate, best_view: View, reference: ChartReference
) -> tuple[_Candidate, View]:
    """Look once more with the chart in the middle: less stretched, as large as useful, in the full map."""
    on_map = best_view.map_points(best.corners)
    view = _view_around(on_map, best_view.map_size)
    shown = view.render(environment)
    closest = _aligned_and_judged(shown, _view_points(view, on_map), best.cost, reference)
    attempts = () if closest.excellent else _attempts(shown, reference, 1.0, rounds=2)
    since = 0
    for candidate in attempts:
        closest = _better(closest, candidate)
        since += closest.acceptable
        if closest.excellent or since >= _ENOUGH_ATTEMPTS:
            break
    return (closest, view) if closest.rank <= best.rank + _SMALL_LOSS else (best, best_view)


def _views(environment: npt.NDArray[np.float32], reference: ChartReference) -> Iterator[View]:
    """Yield the views to search: around what looks like a chart in the flat map, then all round."""
    size = environment.shape[:2]
    long_side = max(size)
    for candidate in _attempts(environment, reference, min(1.0, _LONG_SIDES[0] / long_side), exposures=3, rounds=2):
        if candidate.score <= _WORTH_ALIGNING:
            yield _view_around(candidate.corners, size)
    for pitch, count in _VIEW_ROWS:
        for step in range(count):
            # From the middle of the map outwards to both sides.
            yaw = 2 * np.pi / count * ((step + 1) // 2) * (1 if step % 2 else -1)
            yield view_at(yaw, np.radians(pitch), field_of_view=_VIEW_FIELD, side=_VIEW_SIDE, map_size=size)


def _view_around(corners: npt.NDArray[np.float64], size: tuple[int, int]) -> View:
    yaw, pitch = yaw_pitch(corners.mean(axis=0), size)
    field = min(max(3.0 * angular_extent(corners, size), np.radians(10.0)), np.radians(110.0))
    return view_at(yaw, pitch, field_of_view=field, side=_VIEW_SIDE, map_size=size)


def _view_points(view: View, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the view pixels of map pixels [N, 2], the inverse of `View.map_points`."""
    angles = [yaw_pitch(point, view.map_size) for point in points]
    directions = np.array([[np.cos(p) * np.sin(y), np.sin(p), -np.cos(p) * np.cos(y)] for y, p in angles])
    local = directions @ view.axes.T
    return np.asarray(local[:, :2] / local[:, 2:] * view.focal_px + (view.side - 1) / 2)


def _better(best: _Candidate | None, candidate: _Candidate) -> _Candidate:
    return candidate if best is None or candidate.rank < best.rank else best


def _attempts(
    image: npt.NDArray[np.float32],
    reference: ChartReference,
    scale: float,
    *,
    exposures: int = len(_EXPOSURES),
    rounds: int = len(_TURNS),
) -> Iterator[_Candidate]:
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
        turns = _TURNS[(attempt // exposures + attempt % exposures) % len(_TURNS)]
        found = _detect(_eight_bit(small, float(whites[percentile]), srgb_curve=curve), turns)
        if found is None:
            continue
        box, cost = found
        # Pixel centres are integers, so a reduced image's coordinates shift by half a pixel as well.
        corners = (box + 0.5) / scale - 0.5
        if np.isfinite(corners).all() and abs(signed_area(corners)) > 100:
            yield _aligned_and_judged(image, corners, cost, reference)


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


def _aligned_and_judged(
    image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64], cost: float, reference: ChartReference
) -> _Candidate:
    """Return the box drawn to the patches, or as given if that fails or fits worse."""
    score, order = best_order(glance(image, corners), reference)
    given = _Candidate(corners[list(order)], cost, score, aligned=False)
    if not score <= _WORTH_ALIGNING:
        return given
    aligned = align(image, given.corners)
    if aligned is None:
        return given
    score, order = best_order(glance(image, aligned), reference)
    if score > given.score + _SMALL_LOSS:
        return given
    return _Candidate(aligned[list(order)], cost, score, aligned=True)
