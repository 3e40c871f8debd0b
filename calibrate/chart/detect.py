"""Finding charts in a picture or in a lat-long map.

Both are searched at a few sizes, coarse to fine (`search`, `search_map`). The best fit counts; an excellent one ends the
search. Where every chart is asked for, the picture is searched once more around the ones that are known.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.chart.geometry import (
    CLASSIC,
    PITCH,
    SG,
    ChartFound,
    box_corners,
    box_outline,
    image_from_chart,
    patch_quads,
    project,
    signed_area,
)
from calibrate.chart.judge import LARGEST_SCORE, best_orders, covered, glances
from calibrate.chart.reference import SG_AFTER_2014, ChartReference, chart_reference
from calibrate.chart.search import Candidate, Known, further_in_picture, search_picture
from calibrate.chart.search_map import further_in_map, search_map, through
from calibrate.chart.views import View, directions_on_map
from calibrate.chart.zones import relative_logarithm

# Where the 140 patches of an SG fit as well as this around what was taken for a Classic, it is one. Elsewhere they differ by 20.
_IS_SG: Final = 12.0
# A chart is covered if one patch in so many is.
_COVERED: Final = 6
# Of several charts the largest is the one meant, if it fits nearly as well as the best one (ΔE2000).
_FITS_AS_WELL: Final = 3.0
# A further chart must fit as well as this to be called one.
_SURELY: Final = 8.0


def find_chart(
    image: npt.NDArray[np.float32],
    reference: ChartReference | None = None,
    *,
    latlong: bool = False,
    largest_score: float = LARGEST_SCORE,
) -> ChartFound:
    """Return where the chart of `reference` stands in `image` [H, W, 3] (linear camera or working RGB, any scale).

    NaN and negative pixels are allowed. With `latlong`, the image is a lat-long map, and the corners and
    patches follow its distortion. `reference` (default: a ColorChecker Classic after November 2014) and `largest_score` decide
    what is believed.

    Raises
    ------
    CalibrateError
        If there is no chart, only something that does not fit its published colours, a mirrored one, or an SG where a Classic
        was expected.
    """
    pixels, known = _checked(image), reference or chart_reference()
    logarithm = None if latlong else relative_logarithm(pixels)
    return _record(*_main(pixels, known, logarithm, largest_score=largest_score), known)


def find_charts(
    image: npt.NDArray[np.float32], reference: ChartReference | None = None, *, latlong: bool = False
) -> tuple[ChartFound, ...]:
    """Return every chart of the kind of `reference` in `image`, as `find_chart` returns one: the largest of those that fit best first.

    See `other_charts` for what counts as a further one. Raises as `find_chart`.
    """
    pixels, known = _checked(image), reference or chart_reference()
    logarithm = None if latlong else relative_logarithm(pixels)
    main = _record(*_main(pixels, known, logarithm, largest_score=LARGEST_SCORE), known)
    charts = [main, *_others(pixels, main, known, logarithm)]
    best = min(chart.score for chart in charts)
    charts.sort(key=lambda chart: (chart.score > best + _FITS_AS_WELL, -abs(signed_area(chart.corners))))
    return tuple(charts)


def other_charts(
    image: npt.NDArray[np.float32],
    chart: ChartFound,
    reference: ChartReference | None = None,
    *,
    latlong: bool = False,
) -> tuple[ChartFound, ...]:
    """Return the charts of the kind of `reference` in `image` beside one that is known.

    They must fit the published colours beyond doubt. One that is small in the picture, less than 100 pixels across where the
    picture's long side is brought to 1500, is not looked for: it would cost more than the search for the first one.
    """
    pixels, known = _checked(image), reference or chart_reference()
    return _others(pixels, chart, known, None if latlong else relative_logarithm(pixels))


def _others(
    pixels: npt.NDArray[np.float32],
    chart: ChartFound,
    known: ChartReference,
    logarithm: npt.NDArray[np.float32] | None,
) -> tuple[ChartFound, ...]:
    """As `other_charts`; the relative `logarithm` is that of a picture, None of a map."""
    found: list[tuple[Candidate, View | None]] = []
    if logarithm is None:
        found += further_in_map(pixels, known, Known(directions_on_map(chart.corners, pixels.shape[:2])))
    else:
        further = further_in_picture(pixels, logarithm, known, Known(chart.corners))
        found += [(each, None) for each in further if _inside(each, known, pixels.shape[:2])]
    return tuple(
        _record(candidate, view, known)
        for candidate, view in found
        if candidate.aligned and candidate.score <= _SURELY and not candidate.mirrored
    )


def _checked(image: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    if image.ndim != 3 or image.shape[2] != 3 or min(image.shape[:2]) < 32:
        raise CalibrateError(
            f"correct.chart: an image of shape {image.shape}; expected (height, width, 3) of at least 32 pixels a side. "
            "Pass linear RGB."
        )
    return np.ascontiguousarray(image, dtype=np.float32)


def _main(
    pixels: npt.NDArray[np.float32],
    known: ChartReference,
    logarithm: npt.NDArray[np.float32] | None,
    *,
    largest_score: float,
) -> tuple[Candidate, View | None]:
    """Return the likeliest chart, or refuse what is none; the relative `logarithm` is that of a picture, None of a map."""
    layout = known.layout
    view: View | None = None
    if logarithm is None:
        candidate, view = search_map(pixels, known)
    else:
        candidate = search_picture(pixels, logarithm, known)
    if candidate is None:
        raise CalibrateError(
            f"correct.chart: no {layout.name} found at any size; expected one with {layout.count} patches in full view. "
            "Photograph it larger, sharper and evenly lit, name the right kind in `correct.reference`, or give the four corners "
            "of its patches in `correct.chart`."
        )
    place = candidate.corners if view is None else view.map_points(candidate.corners)
    where = place.round().astype(int).tolist()
    if not candidate.score <= largest_score:
        raise CalibrateError(
            f"correct.chart: the best candidate for a {layout.name}, at {where}, differs from the "
            f"published colours by a mean ΔE2000 of {candidate.score:.1f} after a 3×3 fit; a chart fits within "
            f"{largest_score:g}. Name the right kind and edition in `correct.reference`, or give the four corners of the patches "
            "in `correct.chart`."
        )
    if view is None and not _inside(candidate, known, pixels.shape[:2]):
        raise CalibrateError(
            f"correct.chart: the chart at {where} reaches beyond the image of {pixels.shape[1]}×{pixels.shape[0]} pixels; all "
            f"{layout.count} patches must be in view. Photograph it again with all of it in the picture."
        )
    on_map = None if view is None else through(view, (pixels.shape[0], pixels.shape[1]))
    alike = covered(glances(pixels, candidate.corners[None], layout, through=on_map)[0], known)
    if alike >= layout.count // _COVERED:
        raise CalibrateError(
            f"correct.chart: {alike} neighbouring patches of the chart at {where} read the same: something covers them, or it is "
            f"another chart; all {layout.count} must be in full view. Photograph it again, or name the right kind in "
            "`correct.reference`."
        )
    if candidate.mirrored:
        raise CalibrateError(
            f"correct.chart: the chart at {where} is mirrored: its patches run "
            f"anticlockwise from '{layout.first}'. Flip the image back (a mirror ball or a mirrored export shows the scene mirrored)."
        )
    if known.published and layout is CLASSIC:
        _refuse_middle_of_sg(pixels, candidate, view, where)
    return candidate, view


def _inside(candidate: Candidate, known: ChartReference, size: tuple[int, int]) -> bool:
    """Whether all patches lie within an image of `size` (H, W)."""
    points = project(image_from_chart(candidate.corners, known.layout), patch_quads(layout=known.layout))
    return bool((points >= -0.5).all() and (points <= np.array([size[1], size[0]]) - 0.5).all())


def _refuse_middle_of_sg(
    pixels: npt.NDArray[np.float32], candidate: Candidate, view: View | None, where: list[list[int]]
) -> None:
    """An SG holds 24 patches in the order of a Classic, but of other pigments: a fit to a Classic's colours would be wrong."""
    # Patch E2 of the SG is the first of the Classic.
    first = CLASSIC.gap_width + CLASSIC.patch_width / 2
    low = first - PITCH * np.array([4, 1]) - (SG.gap_width + SG.patch_width / 2)
    box = project(image_from_chart(candidate.corners), low + box_corners(SG))
    if view is not None and not view.before(box):
        return
    seen = glances(
        pixels, box[None], SG, through=None if view is None else through(view, (pixels.shape[0], pixels.shape[1]))
    )
    score, order = best_orders(seen, chart_reference(SG_AFTER_2014))[0]
    if score <= _IS_SG and order == (0, 1, 2, 3):
        raise CalibrateError(
            f"correct.chart: the 24 patches at {where} are the middle of a {SG.name}: those around fit its published colours, too "
            f"(mean ΔE2000 {score:.1f}). They have other pigments than a Classic's. Set `correct.reference: {SG_AFTER_2014}`, or "
            "Before, by the date on its back."
        )


def _record(candidate: Candidate, view: View | None, known: ChartReference) -> ChartFound:
    homography = image_from_chart(candidate.corners, known.layout)
    corners, quads = candidate.corners, project(homography, patch_quads(layout=known.layout))
    outline = project(homography, box_outline(known.layout))
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
