"""The camera's half of the page: merged shots, chart, lamp, and what the correction and the balance did."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from envcal import exr, profile
from envcal.provenance import CAMERA_RGB
from envcal.report import previews
from envcal.report.run_record import StageRecord

#: Shots that are shown; a capture may have hundreds.
MOST_SHOTS = 12
#: A patch with a larger CIEDE2000 than this is pointed out.
NOTABLE_DELTA_E = 4.0
_CROP_PIXELS = 720


def shots(output: Path, stage: str) -> list[Path]:
    """The shots that a stage has left, the reference first."""
    found = sorted((output / stage).glob("*.exr"), key=lambda path: (path.stem != "reference", path.name))
    return [path for path in found if path.is_file()]


def shot_preview(path: Path, *, longest: int) -> dict[str, Any]:
    """A shot as a picture, with its exposure and how much of it is missing."""
    small = previews.reduced(path, dict.fromkeys("RGB", "mean"), longest=longest)
    space = str(small.header.attributes.get("envcalSpace", CAMERA_RGB))
    matrix = previews.srgb_matrix(space)
    gain = previews.exposure(small.rgb, matrix)
    height, width = small.header.size
    return {
        "shot": path.stem,
        "space": space,
        "width": width,
        "height": height,
        "stops": float(np.log2(gain)),
        "missing": bool(small.missing.any()),
        "picture": previews.jpeg(previews.display(small.rgb, matrix, gain=gain, missing=small.missing)),
    }


def merge(output: Path, record: StageRecord | None) -> dict[str, Any] | None:
    """The merged shots and the figures of their brackets."""
    paths = shots(output, "merge")
    if not paths:
        return None
    by_shot = record.figures.get("shots", {}) if record else {}
    longest = 1000 if len(paths) <= 2 else 560
    shown = [
        {**shot_preview(path, longest=longest), "figures": by_shot.get(path.stem, {})} for path in paths[:MOST_SHOTS]
    ]
    return {"shots": shown, "more": len(paths) - len(shown)}


def read_profile(output: Path) -> profile.Profile | None:
    """The profile, completed by the balance if it has come that far."""
    for stage in ("balance", "correct"):
        path = output / stage / "profile.json"
        if path.is_file():
            return profile.read(path)
    return None


def chart(output: Path, calibration: profile.Profile) -> dict[str, Any]:
    """The chart in the corrected shot, and every patch: published, fitted, and how far apart."""
    from calibrate.chart import CLASSIC, SG

    matrix = previews.srgb_matrix(calibration.working_space)
    patches = calibration.chart.patches
    found = {
        "chart": calibration.chart,
        "delta_e": calibration.delta_e(),
        "worst": max(patches, key=lambda patch: patch.delta_e).name,
        "notable": NOTABLE_DELTA_E,
        "columns": SG.columns if len(patches) == SG.count else CLASSIC.columns,
        "patches": [
            {
                "patch": patch,
                "target": previews.css_colour(patch.target_rgb, matrix),
                "fitted": previews.css_colour(patch.fitted_rgb, matrix),
                "relative_noise": float(np.max(np.divide(patch.noise, np.maximum(patch.camera_rgb, 1e-12)))),
            }
            for patch in patches
        ],
        "matrix": calibration.matrix,
        "crop": None,
    }
    reference = output / "correct" / "reference.exr"
    if reference.is_file():
        points = [*calibration.chart.corners, *(p for quad in calibration.chart.quads for p in quad)]
        found["crop"] = _crop(reference, points, matrix, margin=0.12, gain=1.0)
    return found


def lamp(output: Path, calibration: profile.Profile) -> dict[str, Any] | None:
    """The D65 lamp in the corrected shot, what it read and what it reads now."""
    if calibration.lamp is None or calibration.balance_matrix is None:
        return None
    matrix = previews.srgb_matrix(calibration.working_space)
    rgb = np.asarray(calibration.lamp.rgb)
    found = {
        "lamp": calibration.lamp,
        "balanced": [float(v) for v in np.asarray(calibration.balance_matrix) @ rgb],
        "ratios": [float(v) for v in rgb / rgb[1]],
        "matrix": calibration.balance_matrix,
        "unlikely": None if calibration.light is None else calibration.light.camera_unlikely,
        "crop": None,
    }
    reference = output / "correct" / "reference.exr"
    if reference.is_file() and rgb.max() > 0:
        gain = 0.75 / float(rgb.max())
        found["crop"] = _crop(reference, calibration.lamp.polygon, matrix, margin=1.0, gain=gain)
    return found


def _crop(
    path: Path, points: Sequence[tuple[float, float]], matrix: previews.Floats, *, margin: float, gain: float
) -> dict[str, Any] | None:
    """The part of an image around some points, enlarged, and how to draw on it in the image's own pixels."""
    height, width = exr.header(path).size
    at = np.asarray(points, np.float64)
    if np.abs(at).max() > 4 * max(height, width):
        return None  # not a place in this image
    low, high = at.min(axis=0), at.max(axis=0)
    around = margin * float((high - low).max()) + 4
    left, right = int(np.floor(low[0] - around)), int(np.ceil(high[0] + around)) + 1
    top, bottom = max(0, int(np.floor(low[1] - around))), min(height, int(np.ceil(high[1] + around)) + 1)
    latlong = width == 2 * height
    if not latlong:
        left, right = max(0, left), min(width, right)
    right = min(right, left + width)
    if bottom <= top or right <= left:
        return None
    image = previews.crop(path, (left, top, right, bottom), wrap=latlong)
    step = -(-max(image.shape[:2]) // _CROP_PIXELS)
    image = image[::step, ::step]
    times = max(1, _CROP_PIXELS // max(image.shape[:2]))
    image = image.repeat(times, axis=0).repeat(times, axis=1)
    missing = previews.missing_in(image)
    return {
        "picture": previews.jpeg(previews.display(image, matrix, gain=gain, missing=missing), quality=88),
        "missing": bool(missing.any()),
        "ratio": (right - left) / (bottom - top),
        # pixel (x, y) has its centre at integers, the picture its corner at 0
        "view": f"{left - 0.5:g} {top - 0.5:g} {right - left} {bottom - top}",
        "box": [left, top, right, bottom],
        "stops": float(np.log2(gain)),
    }


def before_and_after(output: Path) -> list[dict[str, Any]]:
    """Each shot after the correction and after the balance."""
    corrected, balanced = ({path.stem: path for path in shots(output, stage)} for stage in ("correct", "balance"))
    names = list(dict.fromkeys([*corrected, *balanced]))[:MOST_SHOTS]
    longest = 800 if len(names) <= 2 else 480

    def preview(paths: Mapping[str, Path], name: str) -> dict[str, Any] | None:
        return shot_preview(paths[name], longest=longest) if name in paths else None

    return [
        {"shot": name, "corrected": preview(corrected, name), "balanced": preview(balanced, name)} for name in names
    ]
