"""How well the lights of a map are found: counts, temperatures, assignment, and what their spectra are worth.

`python -m benchmarks lights`, with ENVCAL_DATA naming a folder of rooms and skies whose spectra are known. Truth comes from
the light transport of those rooms, never from the code under test. Without the folder only the times are measured.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.lights_report import report
from benchmarks.maps import lit_map
from benchmarks.rooms import Lamp, Room, Scene, atlas, error, lamps, lit, rooms, scaled_error, skies, solid_angle
from uplift.cct import cct_duv, xy_of_rgb
from uplift.cluster import Clusters, cluster_angles
from uplift.illuminants import FAMILIES, family_emission
from uplift.lights import Lights, lights_of
from uplift.lights.mixtures import mixtures_of
from uplift.sky import find_sky
from uplift.spectrum import Observer, RGBSpace, illuminant, observer, rgb_space

Float64 = npt.NDArray[np.float64]

ALIKE_MIRED, ALIKE_DUV = 25.0, 0.010  # nearer lamps count as one light
WITHOUT_DATA = "ENVCAL_DATA is not set: times only"
# Which groups shine and how strongly, ceiling, floor lamps, window.
STRENGTHS = ((1.0, 1.0, 0.0), (1.0, 0.0, 1.0), (0.0, 1.0, 1.0), (1.0, 1.0, 1.0), (0.4, 1.0, 1.0), (1.0, 0.4, 0.0))


@dataclass(slots=True)
class Context:
    """What all measurements share."""

    folder: Path
    eyes: Observer
    space: RGBSpace
    reflectances: Float64 = field(init=False)

    def __post_init__(self) -> None:
        self.reflectances = atlas(self.folder, self.eyes)


def find(rgb: npt.NDArray[np.float32], space: RGBSpace) -> tuple[bool, Clusters]:
    """Return whether there is a sky, and the clusters."""
    sky = find_sky(rgb, space.luminance_weights)
    return sky.present, cluster_angles(
        rgb, luminance_weights=space.luminance_weights, xyz_from_rgb=space.xyz_from_rgb, sky=sky
    )


def judged(scene: Scene, context: Context, indoor: str = "auto") -> tuple[bool, Clusters, Lights]:
    """Return sky, clusters and lights of a scene."""
    present, clusters = find(scene.rgb, context.space)
    return present, clusters, lights_of(scene.rgb, clusters, indoor=indoor, observer=context.eyes, space=context.space)


# ---- one lamp ----


def single(context: Context, places: list[Room], every: list[Lamp], *, alternatives: bool) -> dict[str, Any]:
    """Rooms with one lamp: how many clusters, which CCT, and the relight ratio with the type declared or not."""
    rows = []
    for room in places:
        for lamp in every:
            scene = lit(room, {0: (lamp, 1.0), 1: (lamp, 1.0)}, observer=context.eyes, space=context.space)
            rows.append(_single_row(scene, lamp, context, alternatives))
    return {"rows": rows}


def _single_row(scene: Scene, lamp: Lamp, context: Context, alternatives: bool) -> dict[str, Any]:
    eyes, space = context.eyes, context.space
    present, clusters, unknown = judged(scene, context)
    scaled = scaled_error(scene, context.reflectances, observer=eyes, space=space)

    def ratio(emissions: Any) -> float:
        return error(scene, clusters.labels, emissions, context.reflectances, observer=eyes, space=space) / scaled

    row = {
        "scene": scene.name,
        "kind": lamp.kind,
        "lamp": lamp.name,
        "library": lamp.in_library,
        "cct": lamp.cct,
        "duv": lamp.duv,
        "sky": present,
        "clusters": clusters.count,
        "cct_seen": unknown[0].cct_seen,
        "duv_seen": unknown[0].duv_seen,
        "cct_sigma": unknown[0].cct_sigma,
        "scaled": scaled,
        "undeclared": ratio([one.emission for one in unknown]),
        "true": ratio([lamp.emission] * clusters.count),
    }
    if lamp.kind in ("led", "fluorescent", "incandescent"):
        told = lights_of(scene.rgb, clusters, indoor=lamp.kind, observer=eyes, space=space)
        row["declared"] = ratio([one.emission for one in told])
    if alternatives:
        for family in ("smooth", "led", "fluorescent"):
            row[family] = ratio([_of_family(family, one.cct_seen, eyes) for one in unknown])
        row["blend"] = ratio([_blend(one.kinds, one.cct_seen, eyes) for one in unknown])
    return row


def _of_family(family: str, cct: float, eyes: Observer) -> Float64:
    reached = float(np.clip(cct, FAMILIES[family].low_k, FAMILIES[family].high_k))
    return family_emission(family, reached, eyes)


def _blend(kinds: Mapping[str, float], cct: float, eyes: Observer) -> Float64:
    """Mean of what each kind would have at the CCT, by the kinds' probabilities; smooth for those without a family."""
    total = np.zeros(eyes.wavelengths_nm.size)
    for kind, probability in kinds.items():
        total += probability * _of_family(kind if kind in ("led", "fluorescent") else "smooth", cct, eyes)
    return total


# ---- several lamps ----


def mixtures(every: list[Lamp], count: int, seed: int) -> list[dict[int, tuple[Lamp, float]]]:
    """Return ways to light a room by two or three lamps that differ clearly, drawn at random but always the same."""
    rng = np.random.default_rng(seed)
    usable = [lamp for lamp in every if 1700 < lamp.cct < 12_000 and abs(lamp.duv) < 0.02]
    day = [lamp for lamp in usable if lamp.cct > 4500]
    out: list[dict[int, tuple[Lamp, float]]] = []
    while len(out) < count:
        strengths = STRENGTHS[len(out) % len(STRENGTHS)]
        lights: dict[int, tuple[Lamp, float]] = {}
        for group, strength in enumerate(strengths):
            if strength:
                choice = day if group == 2 else usable
                lights[group] = (choice[int(rng.integers(len(choice)))], strength)
        those = [lamp for lamp, _ in lights.values()]
        if all(not alike(a, b) for i, a in enumerate(those) for b in those[:i]):
            out.append(lights)
    return out


def alike(a: Lamp, b: Lamp) -> bool:
    """Whether two lamps have so similar colours that they count as one light."""
    return abs(1e6 / a.cct - 1e6 / b.cct) < ALIKE_MIRED and abs(a.duv - b.duv) < ALIKE_DUV


def several(context: Context, places: list[Room], every: list[Lamp], *, count: int, seed: int) -> dict[str, Any]:
    """Rooms with two and three lamps: which were found, and which pixels went to the right one."""
    rows = []
    for number, lights in enumerate(mixtures(every, count, seed)):
        room = places[number % len(places)]
        scene = lit(room, lights, observer=context.eyes, space=context.space)
        rows.append(several_row(scene, context))
    return {"rows": rows}


def owners(scene: Scene, clusters: Clusters, context: Context) -> tuple[Float64, Float64, npt.NDArray[np.int64]]:
    """Return the clusters' CCTs [k], how far each is from each lamp [k, lamps] (1: alike), and the nearest lamp [k]; −1: none."""
    cct, duv = cct_duv(xy_of_rgb(clusters.lamps, context.space.xyz_from_rgb))
    truth_mired = np.array([1e6 / lamp.cct for lamp in scene.lamps])
    truth_duv = np.array([lamp.duv for lamp in scene.lamps])
    off = np.hypot((1e6 / cct[:, None] - truth_mired) / ALIKE_MIRED, (duv[:, None] - truth_duv) / ALIKE_DUV)
    owner = np.where(np.isfinite(off).all(axis=1), np.argmin(np.nan_to_num(off, nan=1e9), axis=1), -1)
    return cct, off, owner


def several_row(scene: Scene, context: Context) -> dict[str, Any]:
    """Return the figures of one scene of several lamps."""
    present, clusters = find(scene.rgb, context.space)
    weight = solid_angle(scene.rgb.shape[0])[:, None] / scene.rgb.shape[1]
    light = scene.parts.sum(axis=0) * weight
    shares = (scene.parts * weight).sum(axis=(1, 2)) / light.sum()
    cct, off, owner = owners(scene, clusters, context)
    strongest = np.argmax(scene.parts, axis=0)
    right = owner[clusters.labels] == strongest
    found = [bool((np.abs(cct / lamp.cct - 1) < 0.08).any()) for lamp in scene.lamps]
    return {
        "scene": scene.name,
        "sky": present,
        "lamps": len(scene.lamps),
        "clusters": clusters.count,
        "found": [bool(f) for f, share in zip(found, shares, strict=True) if share >= 0.10],
        "shares": [float(s) for s in shares],
        "cct": [lamp.cct for lamp in scene.lamps],
        "cct_seen": [float(v) for v in cct],
        "right": float((right * light).sum() / light.sum()),
        "spurious": int(sum(np.nan_to_num(off, nan=9.0).min(axis=1) > 1.5)),
    }


# ---- pixels of two lamps ----


def shared(context: Context, places: list[Room], every: list[Lamp], *, count: int, seed: int) -> dict[str, Any]:
    """Rooms of two lamps whose spectra are declared: the relight ratio of hard labels and of mixtures, found and true."""
    rows = []
    pairs = [lights for lights in mixtures(every, 2 * count, seed) if len(lights) == 2][:count]
    for number, lights in enumerate(pairs):
        scene = lit(places[number % len(places)], lights, observer=context.eyes, space=context.space)
        _, clusters = find(scene.rgb, context.space)
        owner = owners(scene, clusters, context)[2]
        if sorted(owner) == [0, 1]:
            rows.append(_shared_row(scene, clusters, owner, context))
    return {"rows": rows, "left_out": len(pairs) - len(rows)}


def _shared_row(
    scene: Scene, clusters: Clusters, owner: npt.NDArray[np.int64], context: Context
) -> dict[str, float | str]:
    eyes, space = context.eyes, context.space
    emissions = [scene.lamps[lamp].emission for lamp in owner]
    mixing = mixtures_of(emissions, clusters.share.tolist(), [True, True], room=3)
    every = [*emissions, *mixing.emissions]
    parts = scene.parts[owner]
    strongest = np.argmax(parts, axis=0).astype(np.uint32)
    part = (parts.max(axis=0) / np.maximum(parts.sum(axis=0), 1e-30)).astype(np.float32)
    scaled = scaled_error(scene, context.reflectances, observer=eyes, space=space)

    def ratio(labels: npt.NDArray[np.uint32], lights: list[Float64]) -> float:
        return error(scene, labels, lights, context.reflectances, observer=eyes, space=space) / scaled

    unknown = [light.emission for light in lights_of(scene.rgb, clusters, observer=eyes, space=space)]
    of_unknown = mixtures_of(unknown, clusters.share.tolist(), [True, True], room=3)
    found = mixing.labels(clusters.labels, clusters.second, clusters.weight)
    return {
        "scene": scene.name,
        "scaled": scaled,
        "one": ratio(clusters.labels, emissions),
        "mixed": ratio(found, every),
        "one, true": ratio(strongest, emissions),
        "mixed, true": ratio(mixing.labels(strongest, 1 - strongest, part), every),
        "undeclared, one": ratio(clusters.labels, unknown),
        "undeclared, mixed": ratio(found, [*unknown, *of_unknown.emissions]),
    }


# ---- under the sky ----


def outdoors(context: Context) -> dict[str, Any]:
    """Skies: one outdoor cluster, and its relight error beside that of the best single CCT."""
    rows = []
    for scene in skies(context.folder, context.eyes, context.space):
        present, clusters, found = judged(scene, context)
        eyes, space = context.eyes, context.space
        scaled = scaled_error(scene, context.reflectances, observer=eyes, space=space)
        one = np.zeros_like(clusters.labels)

        def ours(labels: Any, emissions: Any, scene: Scene = scene) -> float:
            return error(scene, labels, emissions, context.reflectances, observer=context.eyes, space=context.space)

        scan = {
            float(k): ours(one, [family_emission("daylight" if k >= 5000 else "sunset", float(k), eyes)])
            for k in np.rint(1e6 / np.arange(60.0, 330.0, 15.0))
        }
        best = min(scan, key=lambda k: scan[k])
        rows.append(
            {
                "scene": scene.name,
                "sky": present,
                "clusters": clusters.count,
                "outdoor": int(clusters.outdoor.sum()),
                "cct": found[0].cct,
                "scaled": scaled,
                "chosen": ours(clusters.labels, [light.emission for light in found]),
                "best": scan[best],
                "best_cct": best,
                "scan": scan,
            }
        )
    return {"rows": rows}


# ---- time ----


def times(width: int, height: int, repeat: int) -> dict[str, float]:
    """Seconds of CPU and of the clock for sky, clusters and CCT of one map; the fastest of several runs."""
    eyes, space = observer(), rgb_space("ITU-R BT.2020")
    emissions = [illuminant(name, eyes) for name in ("D65", "LED-B3", "A")]
    rgb, _ = lit_map(width, height, emissions, observer=eyes, space=space)
    for k, emission in enumerate(emissions):
        size = height // 32
        x = (2 * k + 1) * width // 6
        rgb[height // 4 : height // 4 + size, x : x + size] = (
            4000 * (space.rgb_from_xyz @ eyes.cmfs.T @ emission) * eyes.step_nm
        )
    best: dict[str, float] = {}
    for _ in range(repeat + 1):
        marks = [(time.perf_counter(), time.process_time())]
        sky = find_sky(rgb, space.luminance_weights)
        marks.append((time.perf_counter(), time.process_time()))
        clusters = cluster_angles(
            rgb, luminance_weights=space.luminance_weights, xyz_from_rgb=space.xyz_from_rgb, sky=sky
        )
        marks.append((time.perf_counter(), time.process_time()))
        lights_of(rgb, clusters, observer=eyes, space=space)
        marks.append((time.perf_counter(), time.process_time()))
        for name, start, end in (("sky", 0, 1), ("clusters", 1, 2), ("lights", 2, 3), ("all", 0, 3)):
            for what, column in (("s", 0), ("cpu_s", 1)):
                key = f"{name}_{what}"
                best[key] = min(best.get(key, np.inf), marks[end][column] - marks[start][column])
    return best


# ---- all of it ----


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; return 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks lights", description=__doc__)
    parser.add_argument("--mixtures", type=int, default=48, help="rooms of two and three lamps (default 48)")
    parser.add_argument("--pairs", type=int, default=18, help="rooms of two declared lamps (default 18)")
    parser.add_argument("--seed", type=int, default=0, help="of their lamps")
    parser.add_argument("--every", type=int, default=1, help="take every n-th lamp only")
    parser.add_argument("--size", type=int, default=4096, help="width of the map whose time is taken")
    parser.add_argument(
        "--only", choices=("single", "several", "shared", "outdoors", "times"), help="measure this alone"
    )
    parser.add_argument("--alternatives", action="store_true", help="other answers to an unknown type too")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    chosen = parser.parse_args(arguments)
    named = os.environ.get("ENVCAL_DATA")
    figures: dict[str, Any] = {"size": [chosen.size, chosen.size // 2]}
    figures["times"] = times(chosen.size, chosen.size // 2, repeat=3 if chosen.only in (None, "times") else 0)
    if named is None:
        print(WITHOUT_DATA)
    else:
        figures |= measured(Path(named), chosen)
    print(report(figures))
    if chosen.json:
        chosen.json.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    return 0


def measured(folder: Path, chosen: argparse.Namespace) -> dict[str, Any]:
    """Measure on the rooms and skies of a folder."""
    eyes = observer()
    context = Context(folder, eyes, rgb_space("ITU-R BT.2020"))
    every, places = lamps(folder, eyes)[:: chosen.every], rooms(folder, eyes)
    out: dict[str, Any] = {}
    if chosen.only in (None, "single"):
        out["single"] = single(context, places, every, alternatives=chosen.alternatives)
    if chosen.only in (None, "several"):
        out["several"] = several(context, places, every, count=chosen.mixtures, seed=chosen.seed)
    if chosen.only in (None, "shared"):
        out["shared"] = shared(context, places, every, count=chosen.pairs, seed=chosen.seed)
    if chosen.only in (None, "outdoors"):
        out["outdoors"] = outdoors(context)
    return out
