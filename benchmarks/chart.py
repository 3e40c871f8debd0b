"""Is the chart found, wherever it stands, and nothing else taken for it?

    python -m benchmarks chart --with 500 --without 200 --maps 45 --log chart.jsonl

Synthetic scenes from `chart_scenes` (a Classic, or none) and `chart_kinds` (an SG, a Passport and other proportions, two charts);
where ENVCAL_DATA names a folder, also its `real/*.hdr` (no chart) and `real/chart_*.jpg` (a chart each). A chart counts as found
if the largest corner error is at most 2 % of its width. What is in the log is not done again: a run that was cut goes on.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.chart_kinds import scene_with_passport, scene_with_sg, scene_with_two
from benchmarks.chart_scenes import Scene, map_with_chart, scene_with_chart, scene_without_chart
from calibrate import CalibrateError

LARGEST_ERROR = 0.02
#: So often it is told how far it is.
_TOLD_EVERY = 25

Row = dict[str, Any]


def main(arguments: list[str] | None = None) -> int:
    """Print how many charts were found, how exactly, how fast, and what was falsely taken for one."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks chart", description=__doc__)
    parser.add_argument("--with", dest="present", type=int, default=500, help="scenes with a chart")
    parser.add_argument("--without", dest="absent", type=int, default=200, help="scenes without one")
    parser.add_argument("--maps", type=int, default=45, help="lat-long maps of 1280×640 with a chart")
    parser.add_argument("--sg", type=int, default=100, help="scenes with a Digital SG")
    parser.add_argument("--passports", type=int, default=99, help="scenes with other proportions of patch and gap")
    parser.add_argument("--two", type=int, default=40, help="scenes with two charts")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--log", type=Path, help="a line for each scene; scenes that are in it are not done again")
    parser.add_argument("--json", type=Path, help="write the figures there")
    given = parser.parse_args(arguments)
    done = _Log(given.log)
    figures: dict[str, Any] = {}
    folder = os.environ.get("ENVCAL_DATA")
    if folder:
        figures["real"] = _real(Path(folder) / "real")
    else:
        print("real photographs and maps: skipped, ENVCAL_DATA names no folder", flush=True)
    for kind, count in (
        ("without", given.absent),
        ("maps", given.maps),
        ("sg", given.sg),
        ("passports", given.passports),
        ("two", given.two),
        ("pictures", given.present),
    ):
        rows = list(done.rows(kind, range(given.first, given.first + count)))
        if rows:
            figures[kind] = _told(kind, rows)
    if given.json:
        given.json.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    return 0


class _Log:
    """What became of each scene, kept in a file where one is given."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        text = path.read_text(encoding="utf-8") if path is not None and path.exists() else ""
        # The last line of a run that was killed may be a part of one.
        if path is not None and text and not text.endswith("\n"):
            text = text[: text.rfind("\n") + 1]
            path.write_text(text, encoding="utf-8")
        self._known = {(row["kind"], row["seed"]): row for row in map(json.loads, text.splitlines())}

    def rows(self, kind: str, seeds: Iterable[int]) -> Iterable[Row]:
        seeds = list(seeds)
        good = spent = 0.0
        for count, seed in enumerate(seeds, 1):
            row = self._known.get((kind, seed))
            if row is None:
                row = {"kind": kind, "seed": seed, **KINDS[kind](seed)}
                if not row["good"]:
                    print(f"  {kind} {seed} ({row['what']}): {row['said']}", flush=True)
                if self._path is not None:
                    with self._path.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(row) + "\n")
            good, spent = good + row["good"], spent + row["seconds"]
            if count % _TOLD_EVERY == 0 and count < len(seeds):
                print(f"  {kind}: {good:.0f} of {count} so far, of {len(seeds)}; CPU s {spent:.0f}", flush=True)
            yield row


def look(scene: Scene, *, latlong: bool = False, kind: str | None = None) -> tuple[float, str, float, float]:
    """Return the largest corner error as a share of the chart's width (inf if refused), the refusal, CPU seconds and score."""
    from calibrate.chart import chart_reference, find_chart

    reference = chart_reference() if kind is None else chart_reference(kind)
    start = time.process_time()
    refusal, score = "", float("nan")
    try:
        found = find_chart(scene.image, reference, latlong=latlong)
        corners, score = found.corners, found.score
    except CalibrateError as error:
        corners, refusal = np.full((4, 2), np.inf), str(error)
    seconds = time.process_time() - start
    if scene.corners is None:
        return (float("inf") if refusal else 0.0), refusal, seconds, score
    offset = corners - scene.corners
    width = float(np.hypot(*(scene.corners[1] - scene.corners[0])))
    if latlong:
        whole = scene.image.shape[1]
        offset[:, 0] = (offset[:, 0] + whole / 2) % whole - whole / 2 if not refusal else np.inf
        width = _width_on_map(scene)
    return float(np.hypot(*offset.T).max() / width), refusal, seconds, score


def _width_on_map(scene: Scene) -> float:
    """The chart's width in pixels of the map's equator: near a pole, distances in x count less than they seem."""
    stretch = max(float(np.cos(np.radians(scene.facts["pitch"]))), 0.05)
    return float(scene.facts["degrees"] / 360 * scene.image.shape[1] / stretch)


def _with_chart(
    make: Callable[[int], Scene], *, latlong: bool = False, kind: str | None = None
) -> Callable[[int], Row]:
    def row(seed: int) -> Row:
        scene = make(seed)
        error, refusal, seconds, score = look(scene, latlong=latlong, kind=kind)
        facts = ", ".join(f"{name} {value:.3g}" for name, value in scene.facts.items())
        return {
            "good": error <= LARGEST_ERROR,
            "error": error if np.isfinite(error) else None,
            "score": score if np.isfinite(score) else None,
            "seconds": seconds,
            "what": f"{scene.what}; {facts}",
            "said": refusal[:110] or f"error {error:.1%}",
        }

    return row


def _without(seed: int) -> Row:
    scene = scene_without_chart(seed)
    error, refusal, seconds, score = look(scene)
    said = refusal[:110] or f"false chart, score {score:.1f}"
    return {"good": error > 0, "error": None, "seconds": seconds, "what": scene.what, "said": said}


def _two(seed: int) -> Row:
    from calibrate.chart import find_charts

    scene = scene_with_two(seed)
    start = time.process_time()
    try:
        found = [chart.corners for chart in find_charts(scene.image)]
        said = f"{len(found)} charts"
    except CalibrateError as refused:
        found, said = [], str(refused)[:110]
    seconds = time.process_time() - start
    error = float("inf")
    if len(found) == 2:
        off = np.hypot(*np.moveaxis(np.array(found) - scene.corners, -1, 0)).max(axis=1)
        error = float((off / np.hypot(*(scene.corners[:, 1] - scene.corners[:, 0]).T)).max())
        said = f"error {error:.1%}"
    finite = error if np.isfinite(error) else None
    return {"good": error <= LARGEST_ERROR, "error": finite, "seconds": seconds, "what": scene.what, "said": said}


KINDS: dict[str, Callable[[int], Row]] = {
    "pictures": _with_chart(scene_with_chart),
    "maps": _with_chart(map_with_chart, latlong=True),
    "without": _without,
    "sg": _with_chart(scene_with_sg, kind="ColorCheckerSG - After November 2014"),
    "passports": _with_chart(scene_with_passport),
    "two": _two,
}


def _told(kind: str, rows: list[Row]) -> Row:
    """Print and return the figures of a kind of scene."""
    good = sum(row["good"] for row in rows)
    times = [row["seconds"] for row in rows]
    seen = [row["error"] for row in rows if row["error"] is not None]
    aim = "without a false chart" if kind == "without" else f"found within {LARGEST_ERROR:.0%} of the width"
    print(f"{kind}: {good} of {len(rows)} ({good / len(rows):.1%}) {aim}", end="")
    if seen:
        print(f"; error median {np.median(seen):.2%}, 95 % {np.percentile(seen, 95):.2%}", end="")
    print(f"; CPU s an image: median {np.median(times):.2f}, largest {max(times):.1f}", flush=True)
    return {
        "scenes": len(rows),
        "good": good,
        "missed": [row["seed"] for row in rows if not row["good"]],
        "error_median": float(np.median(seen)) if seen else None,
        "error_95": float(np.percentile(seen, 95)) if seen else None,
        "seconds_median": float(np.median(times)),
        "seconds_largest": max(times),
    }


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
