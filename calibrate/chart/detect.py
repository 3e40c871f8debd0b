"""Finding the ColorChecker: OpenCV's detector, tried at several exposures, curves and sizes, and not believed unseen.

The detector (`cv2.mcc`) is brittle against exposure and scale and content with mirrored or false charts. So each
attempt's box is drawn to the patches by an alignment of the whole chart (G. D. Evangelidis and E. Z. Psarakis, ECC, 2008),
then judged by a fit against the published colours; the best fit of all attempts counts, and an excellent one ends the
search. In a lat-long map the attempts are made in perspective views.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.chart.geometry import (
    BOX_HEIGHT,
    BOX_WIDTH,
    ChartFound,
    box_corners,
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
# (percentile of the brightest channel that becomes white, sRGB curve?), the likeliest first.
_EXPOSURES: Final = ((97.0, True), (90.0, True), (99.5, True), (97.0, False), (75.0, True), (90.0, False), (99.5, False))
_LONG_SIDES: Final = (1800, 1000)
_VIEW_SIDE: Final = 900
_VIEW_FIELD: Final = np.radians(75.0)
# Rows of views: the horizon first, then downwards (charts stand on tables and floors), then upwards.
_VIEW_PITCHES: Final = (0.0, -35.0, 35.0, -65.0)
# A map is reduced to this width for the views; a chart that is lost by that is too small to be measured anyway.
_WIDEST_MAP: Final = 4096
_ALIGNED_PX_PER_UNIT: Final = 16
_ALIGNED_MARGIN: Final = 0.75


@dataclass(frozen=True, slots=True)
class _Candidate:
    corners: npt.NDArray[np.float64]
    cost: float
    score: float

    @property
    def mirrored(self) -> bool:
        return signed_area(self.corners) < 0


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
    return ChartFound(corners=corners, quads=quads, outline=outline, cost=candidate.cost, score=candidate.score)


def _search_picture(
    image: npt.NDArray[np.float32], reference: ChartReference
) -> tuple[_Candidate | None, View | None]:
    long_side = max(image.shape[:2])
    sides = [side for side in _LONG_SIDES if side < long_side] + [long_side]
    best: _Candidate | None = None
    for side in sides:
        for candidate in _attempts(image, reference, side / long_side):
            best = _better(best, candidate)
            if best is not None and best.score <= _EXCELLENT_SCORE:
                return best, None
    return best, None


def _search_map(environment: npt.NDArray[np.float32], reference: ChartReference) -> tuple[_Candidate | None, View | None]:
    full = environment.shape[:2]
    reduced = environment
    if full[1] > _WIDEST_MAP:
        size = (_WIDEST_MAP, round(full[0] * _WIDEST_MAP / full[1]))
        reduced = np.asarray(cv2.resize(environment, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
    best: _Candidate | None = None
    best_view: View | None = None
    for view in _views(reduced, reference):
        for candidate in _attempts(view.render(reduced), reference, 1.0, exposures=4):
            if _better(best, candidate) is candidate:
                best, best_view = candidate, view
            if best is not None and best.score <= _EXCELLENT_SCORE:
                break
        if best is not None and best.score <= _EXCELLENT_SCORE:
            break
    if best is None or best_view is None:
        return None, None
    # Once more with the chart in the middle: less stretched, as large as useful, in the full map.
    on_map = View(best_view.axes, best_view.side, best_view.focal_px, full).map_points(best.corners)
    view = _view_around(on_map, full)
    closer = _aligned_and_judged(view.render(environment), _view_points(view, on_map), best.cost, reference)
    if closer.score <= best.score + 0.5:
        return closer, view
    return best, View(best_view.axes, best_view.side, best_view.focal_px, full)


def _views(environment: npt.NDArray[np.float32], reference: ChartReference) -> Iterator[View]:
    """Yield the views to search: around what looks like a chart in the flat map, then all round."""
    size = environment.shape[:2]
    long_side = max(size)
    for candidate in _attempts(environment, reference, min(1.0, _LONG_SIDES[0] / long_side), exposures=3):
        if candidate.score <= 2 * LARGEST_SCORE:
            yield _view_around(candidate.corners, size)
    for pitch in _VIEW_PITCHES:
        count = max(4, round(8 * np.cos(np.radians(pitch))))
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
    return candidate if best is None or candidate.score < best.score else best


def _attempts(
    image: npt.NDArray[np.float32], reference: ChartReference, scale: float, exposures: int = len(_EXPOSURES)
) -> Iterator[_Candidate]:
    """Yield what the detector takes for the chart in `image`, one attempt after the other, aligned and judged."""
    small = image
    if scale < 1:
        small = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.float32)
    brightest = small.max(axis=2)
    brightest = brightest[np.isfinite(brightest) & (brightest > 0)]
    if brightest.size == 0:
        return
    for percentile, curve in _EXPOSURES[:exposures]:
        box_and_cost = _detect(_eight_bit(small, float(np.percentile(brightest, percentile)), srgb_curve=curve))
        if box_and_cost is None:
            continue
        box, cost = box_and_cost
        # Pixel centres are integers, so a reduced image's coordinates shift by half a pixel as well.
        corners = (box + 0.5) / scale - 0.5
        if np.isfinite(corners).all() and abs(signed_area(corners)) > 100:
            yield _aligned_and_judged(image, corners, cost, reference)


def _eight_bit(image: npt.NDArray[np.float32], white: float, *, srgb_curve: bool) -> npt.NDArray[np.uint8]:
    """Return BGR bytes with `white` at 255; lost pixels are white, as most are clipped."""
    value = np.clip(np.nan_to_num(image / np.float32(white), nan=1.0, posinf=1.0), 0, 1)
    if srgb_curve:
        value = np.where(value <= 0.0031308, 12.92 * value, 1.055 * np.maximum(value, 0.0031308) ** (1 / 2.4) - 0.055)
    return np.ascontiguousarray((value[..., ::-1] * 255 + 0.5).astype(np.uint8))


def _detect(bgr: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.float64], float] | None:
    detector = cv2.mcc.CCheckerDetector.create()
    # A fresh detector's type is uninitialised memory, and the best chart after a failed search a null pointer.
    detector.setColorChartType(cv2.mcc.MCC24)
    detector.setUseDnnModel(False)
    # One chart only: asked for more, it invents some.
    if not detector.process(bgr, 1):
        return None
    chart = detector.getBestColorChecker()
    return np.asarray(chart.getBox(), dtype=np.float64).reshape(4, 2), float(chart.getCost())


def _aligned_and_judged(
    image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64], cost: float, reference: ChartReference
) -> _Candidate:
    """Return the better of the box as given and the box drawn to the patches."""
    score, order = best_order(glance(image, corners), reference)
    given = _Candidate(corners[list(order)], cost, score)
    if not score <= 2 * LARGEST_SCORE:
        return given
    aligned = _align(image, given.corners)
    if aligned is None:
        return given
    score, order = best_order(glance(image, aligned), reference)
    # A fit to the patches' middles hardly notices a box that is off by a little, so a small loss is no objection.
    return _Candidate(aligned[list(order)], cost, score) if score <= given.score + 0.5 else given


def _align(image: npt.NDArray[np.float32], corners: npt.NDArray[np.float64]) -> npt.NDArray[np.float64] | None:
    """Return the corners [4, 2] for which a drawing of the chart covers the chart best; None if that cannot be said."""
    seen = glance(image, corners)
    if not np.isfinite(seen).all():
        return None
    unit, margin = _ALIGNED_PX_PER_UNIT, _ALIGNED_MARGIN
    size = (round((BOX_WIDTH + 2 * margin) * unit), round((BOX_HEIGHT + 2 * margin) * unit))
    chart_from_flat = np.array([[1 / unit, 0, -margin], [0, 1 / unit, -margin], [0, 0, 1]])
    image_from_flat = image_from_chart(corners) @ chart_from_flat
    flat = cv2.warpPerspective(
        image,
        image_from_flat,
        size,
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(np.nan, np.nan, np.nan, np.nan),
    )
    valid = np.isfinite(flat).all(axis=2)
    white = max(float(seen.sum(axis=1).max()), 1e-12)
    grey = np.cbrt(np.clip(np.nan_to_num(flat.sum(axis=2)) / white, 0, 1.5)).astype(np.float32)
    levels = np.cbrt(np.clip(seen.sum(axis=1) / white, 0, 1.5))
    drawing = np.full(size[::-1], 0.8 * float(levels.min()), dtype=np.float32)
    for quad, level in zip(patch_quads(1.0), levels, strict=True):
        (left, top), (right, bottom) = ((quad[[0, 2]] + margin) * unit).round().astype(int)
        drawing[top:bottom, left:right] = level
    # As blurred as the photograph, whose pixel may be many of these.
    spread = unit * np.sqrt((BOX_WIDTH * BOX_HEIGHT) / max(abs(signed_area(corners)), 1.0))
    drawing = np.asarray(cv2.GaussianBlur(drawing, (0, 0), max(0.6 * spread, 0.8)), dtype=np.float32)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-6)
    try:
        _, warp = cv2.findTransformECC(
            drawing, grey, np.eye(3, dtype=np.float32), cv2.MOTION_HOMOGRAPHY, criteria, valid.astype(np.uint8), 3
        )
    except cv2.error:  # it did not converge
        return None
    flat_corners = (box_corners() + margin) * unit - 0.5
    moved = project(image_from_flat, project(warp.astype(np.float64), flat_corners))
    # Half a patch is farther than the detector errs; a warp that far has slipped to a neighbour.
    limit = 1.25 * np.sqrt(abs(signed_area(corners)) / (BOX_WIDTH * BOX_HEIGHT))
    return moved if np.isfinite(moved).all() and np.abs(moved - corners).max() < limit else None
