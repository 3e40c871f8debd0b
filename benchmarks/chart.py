"""Is the chart found, wherever it stands, and nothing else taken for it?

    python -m benchmarks chart --with 500 --without 200 --maps 45

Synthetic scenes from `chart_scenes`; where ENVCAL_DATA names a folder, also its `real/*.hdr` (no chart) and
`real/chart_*.jpg` (a chart each). A chart counts as found if the largest corner error is at most 2 % of its width.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.chart_scenes import Scene, map_with_chart, scene_with_chart, scene_without_chart
from calibrate import CalibrateError

LARGEST_ERROR = 0.02


def main(arguments: list[str] | None = None) -> int:
    """Print how many charts were found, how exactly, how fast, and what was falsely taken for one."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks chart", description=__doc__)
    parser.add_argument("--with", dest="present", type=int, default=500, help="scenes with a chart")
    parser.add_argument("--without", dest="absent", type=int, default=200, help="scenes without one")
    parser.add_argument("--maps", type=int, default=45, help="lat-long maps of 1280×640 with a chart")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--json", type=Path, help="write the figures there")
    given = parser.parse_args(arguments)
    seeds = range(given.first, given.first + given.present)
    figures: dict[str, Any] = {"pictures": _found([scene_with_chart, seeds], latlong=False)}
    figures["maps"] = _found([map_with_chart, range(given.first, given.first + given.maps)], latlong=True)
    figures["without"] = _false(range(given.first, given.first + given.absent))
    folder = os.environ.get("ENVCAL_DATA")
    if folder:
        figures["real"] = _real(Path(folder) / "real")
    else:
        print("real photographs and maps: skipped, ENVCAL_DATA names no folder")
    if given.json:
        given.json.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    return 0


def look(scene: Scene, *, latlong: bool) -> tuple[float, str, float]:
    """Return the largest corner error as a share of the chart's width (inf if refused), the refusal, and CPU seconds."""
    from calibrate.chart import find_chart

    start = time.process_time()
    try:
        corners = find_chart(scene.image, latlong=latlong).corners
        refusal = ""
    except CalibrateError as error:
        corners, refusal = np.full((4, 2), np.inf), str(error)
    seconds = time.process_time() - start
    if scene.corners is None:
        return (float("inf") if refusal else 0.0), refusal, seconds
    offset = corners - scene.corners
    if latlong:
        width = scene.image.shape[1]
        offset[:, 0] = (offset[:, 0] + width / 2) % width - width / 2 if not refusal else np.inf
        return float(np.hypot(*offset.T).max() / _width_on_map(scene)), refusal, seconds
    return float(np.hypot(*offset.T).max() / np.hypot(*(scene.corners[1] - scene.corners[0]))), refusal, seconds


def _width_on_map(scene: Scene) -> float:
    """The chart's width in pixels of the map's equator: near a pole, distances in x count less than they seem."""
    stretch = max(float(np.cos(np.radians(scene.facts["pitch"]))), 0.05)
    return float(scene.facts["degrees"] / 360 * scene.image.shape[1] / stretch)


def _found(source: Any, *, latlong: bool) -> dict[str, Any]:
    make, seeds = source
    errors, times, missed = [], [], []
    for seed in seeds:
        scene = make(seed)
        error, refusal, seconds = look(scene, latlong=latlong)
        errors.append(error)
        times.append(seconds)
        if not error <= LARGEST_ERROR:
            missed.append(seed)
            facts = ", ".join(f"{name} {value:.3g}" for name, value in scene.facts.items())
            print(f"  missed {seed} ({scene.what}; {facts}): {refusal[:90] or f'error {error:.1%}'}", flush=True)
    seen = np.array([e for e in errors if np.isfinite(e)])
    count = len(errors)
    kind = "maps" if latlong else "pictures"
    print(
        f"{kind} with a chart: {count - len(missed)} of {count} found within {LARGEST_ERROR:.0%} of its width", end=""
    )
    if count:
        print(
            f"; error median {np.median(seen):.2%}, 95 % {np.percentile(seen, 95):.2%}; CPU s an image: median "
            f"{np.median(times):.2f}, largest {max(times):.1f}",
            end="",
        )
    print(flush=True)
    return {
        "scenes": count,
        "found": count - len(missed),
        "missed": missed,
        "error_median": float(np.median(seen)) if seen.size else None,
        "error_95": float(np.percentile(seen, 95)) if seen.size else None,
        "seconds_median": float(np.median(times)) if times else None,
        "seconds_largest": max(times, default=None),
    }


def _false(seeds: range) -> dict[str, Any]:
    false: Counter[str] = Counter()
    times = []
    for seed in seeds:
        scene = scene_without_chart(seed)
        error, _, seconds = look(scene, latlong=False)
        times.append(seconds)
        if error == 0.0:
            false[scene.what] += 1
            print(f"  false chart in {seed} ({scene.what})", flush=True)
    print(f"pictures without a chart: {sum(false.values())} false charts in {len(times)}", end="")
    print(f"; CPU s an image: median {np.median(times):.2f}, largest {max(times):.1f}" if times else "", flush=True)
    return {"scenes": len(times), "false": dict(false), "seconds_median": float(np.median(times)) if times else None}


def _real(folder: Path) -> dict[str, Any]:
    from calibrate.chart import find_chart

    results: dict[str, Any] = {}
    for path in sorted([*folder.glob("*.hdr"), *folder.glob("chart_*.jpg")]):
        image: npt.NDArray[np.float32] = np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))[..., ::-1]
        image = (image / np.float32(255)) ** np.float32(2.2) if path.suffix == ".jpg" else image.astype(np.float32)
        start = time.process_time()
        try:
            found = find_chart(image, latlong=path.suffix == ".hdr")
            said = f"a chart at {found.corners.round().astype(int).tolist()}, score {found.score:.1f}"
        except CalibrateError as error:
            said = f"none: {str(error)[:80]}"
        results[path.name] = said
        print(f"{path.name}: {said}; CPU s {time.process_time() - start:.1f}", flush=True)
    return results
