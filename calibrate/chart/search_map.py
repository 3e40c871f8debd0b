"""The search for a chart in a lat-long map: in three sheets that cover it (`sheets`), then in views of what is found there."""

from collections.abc import Iterator
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate.chart.judge import Through, best_orders, glances
from calibrate.chart.lattice import grids
from calibrate.chart.reference import ChartReference
from calibrate.chart.search import (
    WORTH_ALIGNING,
    Candidate,
    Found,
    Known,
    aligned_and_judged,
    better,
    candidates,
    further_scales,
    likeliest,
    plausible,
    resized,
    scales,
    zones_at,
)
from calibrate.chart.sheets import Sheet, sheets
from calibrate.chart.views import View, view_at
from calibrate.chart.windows import windows
from calibrate.chart.zones import relative_logarithm

# Pixels of the view in which a chart of a map is looked at, and how wide it is: so many times the lattice's greatest angle from
# its middle, within limits.
_VIEW_SIDE: Final = 640
_FIELD: Final = 3.2
_NARROWEST, _WIDEST = np.radians(10.0), np.radians(120.0)
_VIEW_SCALES: Final = (1.0, 2.0)
# So many candidates of each size that fit, but not excellently, are worth the time of a search around them.
_THOROUGH_LOOKS: Final = 1
# A map is reduced to this width for the views; a chart that is lost by that is too small to be measured anyway.
_WIDEST_MAP: Final = 4096


def search_map(environment: npt.NDArray[np.float32], reference: ChartReference) -> tuple[Candidate | None, View | None]:
    """Return the likeliest chart of a map [H, W, 3], its corners in the view that is returned with it; None if there is nothing."""
    parts, around, full = _parts(environment)
    best: Candidate | None = None
    best_view: View | None = None
    for scale in scales(_size(around)):
        found = [each for sheet in parts for each in _found_on(sheet, around, reference, scale)]
        for position, likely in enumerate(likeliest(found)):
            if likely.view is None:
                continue
            view = View(likely.view.axes, likely.view.side, likely.view.focal_px, full)
            candidate = _looked_at(environment, view, likely, reference, thoroughly=position < _THOROUGH_LOOKS)
            if better(best, candidate) is candidate:
                best, best_view = candidate, view
            if best is not None and best.excellent:
                return best, best_view
        if best is not None and best.acceptable and not best.mirrored:
            return best, best_view
    return best, best_view


def further_in_map(
    environment: npt.NDArray[np.float32], reference: ChartReference, known: Known
) -> list[tuple[Candidate, View]]:
    """Return what may be charts beside the one that is known, each in the view that comes with it."""
    parts, around, full = _parts(environment)
    apart, further = [known], []
    for scale in further_scales(_size(around)):
        found = [each for sheet in parts for each in _found_on(sheet, around, reference, scale)]
        found = [each for each in found if not any(chart.covers(each) for chart in apart)]
        for likely in likeliest(found):
            if likely.view is None or any(chart.covers(likely) for chart in apart):
                continue
            view = View(likely.view.axes, likely.view.side, likely.view.focal_px, full)
            candidate = _looked_at(environment, view, likely, reference, thoroughly=False)
            if candidate.acceptable:
                further.append((candidate, view))
                apart.append(Known(view.directions(candidate.corners)))
    return further


def through(view: View, size: tuple[int, int]) -> Through:
    """Return the function that takes points of a view to the pixels of its map of `size` (H, W), with a column more at its end."""

    def on_map(points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        x, y = np.moveaxis(view.map_points(points), -1, 0)
        return np.stack([x % size[1], np.clip(y, 0, size[0] - 1)], axis=-1)

    return on_map


def _parts(
    environment: npt.NDArray[np.float32],
) -> tuple[tuple[Sheet, ...], npt.NDArray[np.float32], tuple[int, int]]:
    """Return the sheets of a map [H, W, 3], the map with its first column once more at its end, both reduced, and (H, W)."""
    full = environment.shape[:2]
    reduced = environment
    if full[1] > _WIDEST_MAP:
        size = (_WIDEST_MAP, round(full[0] * _WIDEST_MAP / full[1]))
        reduced = np.asarray(cv2.resize(environment, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
    around = np.concatenate([reduced, reduced[:, :1]], axis=1)
    return sheets(relative_logarithm(reduced)), around, (full[0], full[1])


def _size(around: npt.NDArray[np.float32]) -> tuple[int, int]:
    return around.shape[0], around.shape[1] - 1


def _found_on(
    sheet: Sheet, around: npt.NDArray[np.float32], reference: ChartReference, scale: float
) -> Iterator[Found]:
    """Yield the boxes on a sheet that is resized by `scale`, each in a view with itself in the middle.

    `around` [H, W + 1, 3] is the map with its first column once more at the end.
    """
    size = _size(around)
    for zones in zones_at(resized(sheet.pixels, scale)):
        for places, indices in grids(zones, reference.layout):
            view, points = _view_of(sheet.directions((zones.centres[indices] + 0.5) / scale - 0.5), size)
            boxes = windows(places, points, reference.layout)
            boxes = boxes[[plausible(box, (view.side, view.side)) for box in boxes]]
            if not len(boxes):
                continue

            judged = best_orders(glances(around, boxes, reference.layout, through=through(view, size)), reference)
            for box, (score, order) in zip(boxes, judged, strict=True):
                yield Found(box, score, order, view)


def _looked_at(
    environment: npt.NDArray[np.float32], view: View, found: Found, reference: ChartReference, *, thoroughly: bool
) -> Candidate:
    """Draw a box to its patches in the view, as large as useful, of the full map; `thoroughly`: search there as well."""
    shown = view.render(environment)
    best = aligned_and_judged(shown, found.in_order, reference)
    if best.excellent or not thoroughly or not found.score <= WORTH_ALIGNING:
        return best
    logarithm = relative_logarithm(shown)
    for scale in _VIEW_SCALES:
        for candidate in candidates(logarithm, shown, reference, scale):
            best = better(best, candidate)
            if best.excellent:
                return best
        if best.acceptable:
            break
    return best


def _view_of(directions: npt.NDArray[np.float64], map_size: tuple[int, int]) -> tuple[View, npt.NDArray[np.float64]]:
    """Return a view with directions [N, 3] of a lattice well inside, and their pixels [N, 2] in it."""
    mean = directions.mean(axis=0)
    mean /= np.linalg.norm(mean)
    extent = float(np.arccos(np.clip((directions @ mean).min(), -1, 1)))
    field = min(max(_FIELD * extent, _NARROWEST), _WIDEST)
    yaw, pitch = float(np.arctan2(mean[0], -mean[2])), float(np.arcsin(np.clip(mean[1], -1, 1)))
    view = view_at(yaw, pitch, field_of_view=field, side=_VIEW_SIDE, map_size=map_size)
    return view, view.points(directions)
