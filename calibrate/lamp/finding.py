"""The search for the module: the region with the best score, and the refusals where no region will do."""

from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.lamp.curve import uv_from_xyz
from calibrate.lamp.reading import (
    MOST_CLIPPED,
    MOST_REFLECTED,
    Image,
    Lamp,
    Mask,
    Points,
    Region,
    doubts_of_mixing,
    read_region,
)
from calibrate.lamp.regions import overlap, regions_of

_LEAST_SCORE: Final = 0.02
# A runner-up of this share of the best score is told of.
_CLOSE_RUNNER_UP: Final = 0.2
# A region that scores less is taken, but not without a word. In synthetic scenes without a lamp, things of D65's colour and a
# module's size (a screen, a 6500 K lamp, a piece of sky) score up to 0.59 about once in forty; most lamps score 0.3–0.8.
_SURE: Final = 0.6
# Where the camera is not known, a window may look like a lamp in all but its place.
_SURE_OF_UNKNOWN_CAMERA: Final = 0.9
# Something clipped is no reason to refuse a lamp that scores this.
_GOOD: Final = 0.1


def find_lamp(
    image: Image,
    *,
    chart_corners: Points,
    xyz_from_rgb: npt.NDArray[np.float64],
    expected_rgb: npt.NDArray[np.float64] | None = None,
    clipped: Mask | None = None,
    latlong: bool = False,
) -> Lamp:
    """Return the D65 module in `image` [H, W, 3], corrected working RGB (1.0 = perfect white at the chart).

    Parameters
    ----------
    chart_corners
        Shape (4, 2), px. The chart itself is left out, and gives the scale of sizes and distances.
    xyz_from_rgb
        Shape (3, 3). The working space.
    expected_rgb
        Shape (3,). Working RGB, of any scale, that the lamp should have by what is known of the camera. Without it the
        lamp may have the colour of D65 seen from any light, as windows often do.
    clipped
        Shape (H, W). Pixels that are clipped; NaN counts as clipped as well.
    latlong
        x wraps at the image's width.

    Raises
    ------
    CalibrateError
        If nothing looks like the module, or it is clipped in more than 30 % of its pixels.
    """
    chart = np.asarray(chart_corners, dtype=np.float64)
    width = image.shape[1]
    # The chart in the middle of a map, so that the seam is far from what stands beside it.
    shift = round(width / 2 - float(chart[:, 0].mean())) if latlong else 0
    seen = np.roll(image, shift, axis=1) if shift else image
    lost: Mask = np.asarray(~np.isfinite(seen).all(axis=2))
    if clipped is not None:
        lost = lost | np.roll(clipped, shift, axis=1)
    offset = np.array([float(shift), 0.0])
    to_xyz = np.asarray(xyz_from_rgb, dtype=np.float64)
    expected_uv = None if expected_rgb is None else uv_from_xyz(to_xyz @ np.asarray(expected_rgb, dtype=np.float64))
    regions = regions_of(seen, lost, chart + offset, to_xyz, expected_uv)
    misplaced = expected_uv is not None and all(region.score < _LEAST_SCORE for region in regions)
    if misplaced:
        # The camera may not be as published; then the lamp is looked for as with any camera, and never without a word.
        expected_uv = None
        regions = regions_of(seen, lost, chart + offset, to_xyz, None)
    usable = [region for region in regions if region.clipped <= MOST_CLIPPED and region.score >= _LEAST_SCORE]
    spoilt = [region for region in regions if region.clipped > MOST_CLIPPED and region.score >= _LEAST_SCORE]
    best = max(usable, key=lambda region: region.score, default=None)
    worst = max(spoilt, key=lambda region: region.score, default=None)
    if worst is not None and (best is None or (worst.score > best.score and best.score < _GOOD)):
        x, y = worst.polygon.mean(axis=0) - offset
        raise CalibrateError(
            f"balance.lamp: what looks like the lamp, at ({x:.0f}, {y:.0f}), is clipped in {worst.clipped:.0%} of its pixels; "
            f"at most {MOST_CLIPPED:.0%} may be. Add a shorter exposure to the bracket, or set "
            "`balance.lamp: {rectangle: [x, y, width, height]}` on another lamp of known colour."
        )
    if best is None:
        score = max((region.score for region in regions), default=0.0)
        raise CalibrateError(
            "balance.lamp: no region looks like a D65 module (compact, of one colour, on the curve of D65 seen from "
            f"another light, brighter than its surround; best score {score:.3f}, least {_LEAST_SCORE}). Set "
            "`balance.lamp: {rectangle: [x, y, width, height]}` to pixels inside the module."
        )
    runner_up = max((r.score for r in usable if not overlap(r, best)), default=0.0)
    lamp = read_region(seen, best, xyz_from_rgb=xyz_from_rgb, clipped=lost, latlong=False)
    luminance = float(to_xyz[1] @ lamp.rgb)
    x, y = best.polygon.mean(axis=0) - offset
    if luminance < MOST_REFLECTED:
        raise CalibrateError(
            f"balance.lamp: what looks most like the lamp, at ({x:.0f}, {y:.0f}), is {luminance:.2g} times as bright as the chart's white; "
            f"expected at least {MOST_REFLECTED}, since an unlit surface may be as bright. Make the lamp brighter, or photograph the "
            "view with the lamp off too (`capture.lamp_off`)."
        )
    sure = 1.0 if misplaced else _SURE_OF_UNKNOWN_CAMERA if expected_uv is None else _SURE
    warnings = lamp.warnings + _doubts(best, worst, usable, sure=sure, offset=offset)
    warnings += doubts_of_mixing(lamp, to_xyz)
    return replace(lamp, polygon=lamp.polygon - offset, score=best.score, runner_up=runner_up, warnings=warnings)


def _doubts(
    best: Region, worst: Region | None, usable: list[Region], *, sure: float, offset: Points
) -> tuple[str, ...]:
    """Return what speaks against the region taken: its score, a clipped one, or another that is nearly as good."""
    warnings: tuple[str, ...] = ()
    if best.score < sure:
        x, y = best.polygon.mean(axis=0) - offset
        needed = f"{sure} is sure" if sure < 1 else "its colour is not where the camera's own matrix puts D65"
        warnings += (
            f"balance.lamp: what was taken, at ({x:.0f}, {y:.0f}), may not be the lamp: it scores {best.score:.2f} of 1, and {needed}. Look "
            "at the report; if it is something else, set `balance.lamp` to a rectangle inside the module.",
        )
    if worst is not None and worst.score > _CLOSE_RUNNER_UP * best.score and not overlap(worst, best):
        x, y = worst.polygon.mean(axis=0) - offset
        warnings += (
            f"balance.lamp: another region, at ({x:.0f}, {y:.0f}), is clipped in {worst.clipped:.0%} of its pixels and may be the "
            "lamp. Look at the report; if it is, add a shorter exposure to the bracket.",
        )
    other = max((r for r in usable if not overlap(r, best)), key=lambda region: region.score, default=None)
    if other is not None and other.score > _CLOSE_RUNNER_UP * best.score:
        x, y = other.polygon.mean(axis=0) - offset
        warnings += (
            f"balance.lamp: another region, at ({x:.0f}, {y:.0f}), scores {other.score:.2f} against {best.score:.2f} of the one "
            "taken. Look at the report; if it is the wrong one, set `balance.lamp` to a rectangle inside the module.",
        )
    return warnings
