"""Finding the ColorChecker in a picture or in a lat-long map.

Both are searched at a few sizes, coarse to fine; a map in three sheets that cover it (`sheets`), and what is found there
is looked at in the middle of a perspective view of its own. The best fit counts; an excellent one ends the search.
"""

from collections.abc import Iterator
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.chart.geometry import ChartFound, box_outline, image_from_chart, patch_quads, project
from calibrate.chart.judge import LARGEST_SCORE, best_orders, glances
from calibrate.chart.lattice import grids
from calibrate.chart.reference import ChartReference, chart_reference
from calibrate.chart.search import (
    WORTH_ALIGNING,
    Candidate,
    Found,
    aligned_and_judged,
    better,
    candidates,
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
    logarithm = relative_logarithm(image)
    for scale in scales(image.shape[:2]):
        for candidate in candidates(logarithm, image, reference, scale):
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
    parts = sheets(relative_logarithm(reduced))
    around = np.concatenate([reduced, reduced[:, :1]], axis=1)
    best: Candidate | None = None
    best_view: View | None = None
    for scale in scales(reduced.shape[:2]):
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


def _found_on(
    sheet: Sheet, around: npt.NDArray[np.float32], reference: ChartReference, scale: float
) -> Iterator[Found]:
    """Yield the boxes on a sheet that is resized by `scale`, each in a view with itself in the middle.

    `around` [H, W + 1, 3] is the map with its first column once more at the end.
    """
    size = (around.shape[0], around.shape[1] - 1)
    for zones in zones_at(resized(sheet.pixels, scale)):
        for places, indices in grids(zones):
            view, points = _view_of(sheet.directions((zones.centres[indices] + 0.5) / scale - 0.5), size)
            boxes = windows(places, points)
            boxes = boxes[[plausible(box, (view.side, view.side)) for box in boxes]]
            if not len(boxes):
                continue

            def on_map(points: npt.NDArray[np.float64], view: View = view) -> npt.NDArray[np.float64]:
                x, y = np.moveaxis(view.map_points(points), -1, 0)
                return np.stack([x % size[1], np.clip(y, 0, size[0] - 1)], axis=-1)

            judged = best_orders(glances(around, boxes, through=on_map), reference)
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
