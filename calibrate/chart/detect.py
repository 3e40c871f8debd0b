"""Finding the ColorChecker in a picture or in a lat-long map.

A picture is searched at a few sizes, coarse to fine; a map first as it is, then in perspective views all round, poles
included, and whatever is found once more in the middle of a view of its own. The best fit counts; an excellent one
ends the search.
"""

from collections.abc import Iterator
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.chart.geometry import ChartFound, box_outline, image_from_chart, patch_quads, project
from calibrate.chart.judge import LARGEST_SCORE
from calibrate.chart.reference import ChartReference, chart_reference
from calibrate.chart.search import (
    SMALL_LOSS,
    WORTH_ALIGNING,
    Candidate,
    aligned_and_judged,
    better,
    candidates,
    scales,
)
from calibrate.chart.views import View, angular_extent, view_at, yaw_pitch

_VIEW_SIDES: Final = (640, 1280)
_VIEW_FIELD: Final = np.radians(90.0)
# Rows of views (pitch in degrees, views): the horizon first, then downwards (charts stand on tables and floors), then
# upwards, and the poles. Neighbours overlap by 30° or so.
_VIEW_ROWS: Final = ((0.0, 6), (-45.0, 5), (45.0, 5), (-90.0, 1), (90.0, 1))
# How many candidates that fit, but not excellently, are worth the time of a closer look.
_CLOSER_LOOKS: Final = 6
# A view of a map is searched as it is and enlarged: a chart 10° wide in a map of 1280 has patches of 5 pixels.
_VIEW_SCALES: Final = (1.0, 2.0)
# A map is reduced to this width for the views; a chart that is lost by that is too small to be measured anyway.
_WIDEST_MAP: Final = 4096


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
            "correct.chart: no ColorChecker found at any size; expected one with 24 patches in full view. "
            "Photograph it larger, sharper and evenly lit, or give the four corners of its patches in `correct.chart`."
        )
    place = candidate.corners if view is None else view.map_points(candidate.corners)
    where = place.round().astype(int).tolist()
    if not candidate.score <= largest_score:
        raise CalibrateError(
            f"correct.chart: the best candidate, at {where}, differs from the "
            f"published colours by a mean ΔE2000 of {candidate.score:.1f} after a 3×3 fit; a chart fits within "
            f"{largest_score:g}. Name the right edition in `correct.reference`, or give the four corners of the patches in "
            "`correct.chart`."
        )
    if view is None and not _inside(project(image_from_chart(candidate.corners), patch_quads()), pixels.shape[:2]):
        raise CalibrateError(
            f"correct.chart: the chart at {where} reaches beyond the image of {pixels.shape[1]}×{pixels.shape[0]} pixels; all 24 "
            "patches must be in view. Photograph it again with all of it in the picture."
        )
    if candidate.mirrored:
        raise CalibrateError(
            f"correct.chart: the chart at {where} is mirrored: its patches run "
            "anticlockwise from 'dark skin'. Flip the image back (a mirror ball or a mirrored export shows the scene mirrored)."
        )
    return _record(candidate, view)


def _inside(points: npt.NDArray[np.float64], size: tuple[int, int]) -> bool:
    """Whether points [..., 2] lie within an image of `size` (H, W)."""
    return bool((points >= -0.5).all() and (points <= np.array([size[1], size[0]]) - 0.5).all())


def _record(candidate: Candidate, view: View | None) -> ChartFound:
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
        score=candidate.score,
        warnings=warnings,
    )


def _search_picture(image: npt.NDArray[np.float32], reference: ChartReference) -> tuple[Candidate | None, View | None]:
    best: Candidate | None = None
    for scale in scales(image.shape[:2]):
        for candidate in candidates(image, reference, scale):
            best = better(best, candidate)
            if best.excellent:
                return best, None
        if best is not None and best.acceptable and not best.mirrored:
            return best, None
    return best, None


def _search_map(
    environment: npt.NDArray[np.float32], reference: ChartReference
) -> tuple[Candidate | None, View | None]:
    full = environment.shape[:2]
    reduced = environment
    if full[1] > _WIDEST_MAP:
        size = (_WIDEST_MAP, round(full[0] * _WIDEST_MAP / full[1]))
        reduced = np.asarray(cv2.resize(environment, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
    best: Candidate | None = None
    best_view: View | None = None
    closer_looks = 0
    for view, candidate in _map_candidates(reduced, reference):
        if best is not None and candidate.rank >= best.rank:
            continue
        found, at = candidate, View(view.axes, view.side, view.focal_px, full)
        if candidate.score <= WORTH_ALIGNING and closer_looks < _CLOSER_LOOKS:
            closer_looks += 1
            found, at = _closer(environment, candidate, at, reference)
        if better(best, found) is found:
            best, best_view = found, at
        if best is not None and best.excellent:
            break
    return best, best_view


def _map_candidates(
    environment: npt.NDArray[np.float32], reference: ChartReference
) -> Iterator[tuple[View, Candidate]]:
    """Yield candidates with the view they were seen in: what the flat map shows, then views all round."""
    size = environment.shape[:2]
    for scale in scales(size):
        for candidate in candidates(environment, reference, scale):
            if candidate.score <= WORTH_ALIGNING:
                view = _view_around(candidate.corners, size)
                local = _view_points(view, candidate.corners)
                yield view, aligned_and_judged(view.render(environment), local, reference)
    side = int(np.clip(size[1] // 2, *_VIEW_SIDES))
    for pitch, count in _VIEW_ROWS:
        for step in range(count):
            # From the middle of the map outwards to both sides.
            yaw = 2 * np.pi / count * ((step + 1) // 2) * (1 if step % 2 else -1)
            view = view_at(yaw, np.radians(pitch), field_of_view=_VIEW_FIELD, side=side, map_size=size)
            shown = view.render(environment)
            for scale in _VIEW_SCALES:
                for candidate in candidates(shown, reference, scale):
                    yield view, candidate


def _closer(
    environment: npt.NDArray[np.float32], found: Candidate, view: View, reference: ChartReference
) -> tuple[Candidate, View]:
    """Look once more with the chart in the middle: less stretched, as large as useful, in the full map."""
    on_map = view.map_points(found.corners)
    close = _view_around(on_map, view.map_size)
    shown = close.render(environment)
    closest = aligned_and_judged(shown, _view_points(close, on_map), reference)
    for scale in () if closest.excellent else _VIEW_SCALES:
        for candidate in candidates(shown, reference, scale):
            closest = better(closest, candidate)
        if closest.acceptable:
            break
    return (closest, close) if closest.rank <= found.rank + SMALL_LOSS else (found, view)


def _view_around(corners: npt.NDArray[np.float64], size: tuple[int, int]) -> View:
    yaw, pitch = yaw_pitch(corners.mean(axis=0), size)
    field = min(max(3.0 * angular_extent(corners, size), np.radians(10.0)), np.radians(110.0))
    return view_at(yaw, pitch, field_of_view=field, side=_VIEW_SIDES[0], map_size=size)


def _view_points(view: View, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the view pixels of map pixels [N, 2], the inverse of `View.map_points`."""
    angles = [yaw_pitch(point, view.map_size) for point in points]
    directions = np.array([[np.cos(p) * np.sin(y), np.sin(p), -np.cos(p) * np.cos(y)] for y, p in angles])
    local = directions @ view.axes.T
    return np.asarray(local[:, :2] / local[:, 2:] * view.focal_px + (view.side - 1) / 2)
