"""Is the lamp found, is it read right, and is nothing else taken for it without a word?

    python -m benchmarks lamp --with 300 --without 150

Scenes from `lamp_scenes`, by seed. What counts, fixed before the search was tuned:

- found: the region taken lies on the lamp. At least 98 % of the *readable* scenes: at least 7 pixels thin, 100 pixels that show
  nothing else, at most 5 % of them clipped, at least 1.5 times as bright as chart white, not before something a third as bright;
- read right: its u'v' is that of the lamp's own light, as the chart's matrix has it, to 0.01;
- a wrong object is one that is no lamp, or not where the lamp is; it must be refused or carry a warning that it may not be the lamp;
- a lamp read wrong must be refused or carry any warning.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.lamp_scenes import Calibrated, LampScene, calibrated, lamp_scene
from calibrate import CalibrateError

LARGEST_ERROR = 0.01
#: What a warning says that doubts which object it is.
DOUBTS = ("another region", "may not be the lamp")
#: The search was chosen with seeds from 100000 on and a look at some from 0 on and from 1000 on; those from here on are new to it.
FIRST_SEED = 2000

Float64 = npt.NDArray[np.float64]


def main(arguments: list[str] | None = None) -> int:
    """Print how many lamps were found and read right, and what was taken for one; 1 if a wrong object was not warned about."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks lamp", description=__doc__)
    parser.add_argument("--with", dest="present", type=int, default=300, help="scenes with a lamp")
    parser.add_argument("--without", dest="absent", type=int, default=150, help="scenes without one")
    parser.add_argument("--first", type=int, default=FIRST_SEED, help="the first seed")
    parser.add_argument("--unknown-camera", action="store_true", help="no matrix of the camera is known")
    parser.add_argument("--json", type=Path, help="write the figures there")
    given = parser.parse_args(arguments)
    from uplift.spectrum import rgb_space

    xyz_from_rgb = rgb_space("ITU-R BT.2020").xyz_from_rgb
    counts: dict[str, Counter[str]] = {"readable": Counter(), "hard": Counter(), "without": Counter()}
    errors: list[float] = []
    seconds: list[float] = []
    for present, count in ((True, given.present), (False, given.absent)):
        for seed in range(given.first, given.first + count):
            scene = lamp_scene(seed, lamp=present)
            group = "without" if not present else "readable" if scene.readable else "hard"
            try:
                made = calibrated(scene, seed=seed, xyz_from_rgb=xyz_from_rgb)
            except CalibrateError:
                counts[group]["no chart"] += 1
                continue
            start = time.process_time()
            verdict, error, said = look(scene, made, xyz_from_rgb, known=not given.unknown_camera)
            seconds.append(time.process_time() - start)
            counts[group][verdict] += 1
            if verdict.startswith("found"):
                errors.append(error)
            if "unwarned" in verdict or (group == "readable" and not verdict.startswith("found")):
                print(f"  {verdict}: {group} {seed} ({scene.what}): {said[:110]}", flush=True)
    figures = {group: dict(counts[group]) for group in counts}
    return _told(figures, errors, seconds, given.json)


def look(scene: LampScene, made: Calibrated, xyz_from_rgb: Float64, *, known: bool = True) -> tuple[str, float, str]:
    """Search the lamp of a calibrated scene: the verdict, the error in u'v' (NaN if it was not found) and what was said."""
    from calibrate.lamp import find_lamp
    from calibrate.lamp.curve import uv_from_xyz

    expected = made.matrix @ scene.camera_d65 if known else None
    try:
        lamp = find_lamp(made.image, chart_corners=made.corners, xyz_from_rgb=xyz_from_rgb, expected_rgb=expected)
    except CalibrateError as refusal:
        return "refused", float("nan"), str(refusal)
    said = " / ".join(lamp.warnings)
    x, y = np.round(lamp.polygon.mean(axis=0)).astype(int)
    on_lamp = scene.place is not None and bool(scene.place[max(y - 2, 0) : y + 3, max(x - 2, 0) : x + 3].any())
    if not on_lamp:
        warned = any(doubt in said for doubt in DOUBTS)
        return f"wrong object, {'warned' if warned else 'unwarned'}", float("nan"), said or f"at ({x}, {y})"
    true = uv_from_xyz(xyz_from_rgb @ made.matrix @ scene.camera_lamp)
    error = float(np.hypot(*(uv_from_xyz(xyz_from_rgb @ lamp.rgb) - true)))
    if error > LARGEST_ERROR:
        return f"found, misread, {'warned' if said else 'unwarned'}", error, said or f"off by {error:.3f}"
    return f"found{', warned' if said else ''}", error, said


def _told(figures: dict[str, dict[str, int]], errors: list[float], seconds: list[float], path: Path | None) -> int:
    for group, verdicts in figures.items():
        total = sum(verdicts.values()) - verdicts.get("no chart", 0)
        found = sum(n for verdict, n in verdicts.items() if verdict.startswith("found"))
        told = ", ".join(f"{n} {verdict}" for verdict, n in sorted(verdicts.items()))
        share = f"; found {found / total:.1%}" if total and group != "without" else ""
        print(f"{group}: {total} scenes{share}; {told}")
    unwarned = sum(n for v in figures.values() for verdict, n in v.items() if "unwarned" in verdict)
    print(f"wrong or misread without a warning: {unwarned}")
    if errors:
        print(
            f"error in u'v' of the lamps found: median {np.median(errors):.4f}, 95 % {np.percentile(errors, 95):.4f}; CPU s a "
            f"search: median {np.median(seconds):.2f}, largest {max(seconds):.2f}"
        )
    if path:
        written: dict[str, Any] = {**figures, "unwarned": unwarned, "errors": errors}
        path.write_text(json.dumps(written, indent=1), encoding="utf-8")
    return 1 if unwarned else 0
