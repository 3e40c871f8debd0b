"""How exactly RGB comes back: uplift, sum the spectra, compare, over maps and lamps of all five families.

`python -m benchmarks roundtrip [--size 256x128] [--json FILE]`; if the environment variable ENVCAL_DATA names a
folder, its `real/*.hdr` (each under several lamps) and its `truth/room*.npz` (relit by every lamp) count too.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from benchmarks.maps import KINDS, Float64, Image, inside_locus, lamps, random_map, real_maps, relit_rooms, size
from uplift.difference import delta_e_2000
from uplift.pixels import Status, rgb_of, uplift_pixels
from uplift.spectrum import RGBSpace, observer, rgb_space
from uplift.table import Table, build_table

SPACE = "ITU-R BT.2020"
BORDER = 1e-4  # of chromaticity: where no smooth reflectance of any light leads


@dataclass(slots=True)
class Sums:
    """What is gathered over several uplifts; ΔE2000 relative to white 1, `strict` relative to each pixel's own."""

    uplifts: int = 0
    pixels: int = 0
    status: dict[str, int] = field(default_factory=lambda: {kind.name.lower(): 0 for kind in Status})
    total: float = 0.0
    worst: float = 0.0
    strict: float = 0.0
    worst_fallback: float = 0.0
    worst_closest: float = 0.0
    above_one: int = 0
    kept_above_one: int = 0
    with_closest: int = 0
    closest_inside: int = 0

    def add(self, rgb: Image, found: Any, space: RGBSpace) -> None:
        """Take one uplift of `rgb` into account."""
        asked = rgb.astype(np.float64)
        shown = rgb_of(
            found.coefficients, found.scale, found.emission, found.emissions, observer=observer(), space=space
        )
        difference = delta_e_2000(asked, shown, space)
        exact, fallback = found.status == Status.EXACT, found.status == Status.FALLBACK
        closest = found.status == Status.CLOSEST
        self.uplifts += 1
        self.pixels += exact.size
        for kind in Status:
            self.status[kind.name.lower()] += int((found.status == kind).sum())
        if exact.any():
            self.total += float(difference[exact].sum())
            self.worst = max(self.worst, float(difference[exact].max()))
            own = delta_e_2000(asked[exact], shown[exact], space, white=None)
            self.strict = max(self.strict, float(np.nanmax(own)))
        if fallback.any():
            self.worst_fallback = max(self.worst_fallback, float(difference[fallback].max()))
        if closest.any():
            self.with_closest += 1
            self.worst_closest = max(self.worst_closest, float(difference[closest].max()))
            self.closest_inside += int((inside_locus(asked[closest], observer=observer(), space=space) > BORDER).sum())
        self.above_one += int((difference > 1).sum())
        self.kept_above_one += int((difference[exact | fallback] > 1).sum())

    def joined(self, other: Sums) -> Sums:
        """Return both together."""
        return Sums(
            self.uplifts + other.uplifts,
            self.pixels + other.pixels,
            {kind: count + other.status[kind] for kind, count in self.status.items()},
            self.total + other.total,
            max(self.worst, other.worst),
            max(self.strict, other.strict),
            max(self.worst_fallback, other.worst_fallback),
            max(self.worst_closest, other.worst_closest),
            self.above_one + other.above_one,
            self.kept_above_one + other.kept_above_one,
            self.with_closest + other.with_closest,
            self.closest_inside + other.closest_inside,
        )

    def figures(self) -> dict[str, Any]:
        """Return the figures, for JSON."""
        exact = self.status["exact"]
        return {
            "uplifts": self.uplifts,
            "pixels": self.pixels,
            "status": self.status,
            "delta_e_mean": self.total / exact if exact else None,
            "delta_e_max": self.worst,
            "delta_e_max_strict": self.strict,
            "fallback_delta_e_max": self.worst_fallback,
            "closest_delta_e_max": self.worst_closest,
            "pixels_above_1": self.above_one,
            "exact_or_fallback_above_1": self.kept_above_one,
            "uplifts_with_closest": self.with_closest,
            "closest_inside_the_locus": self.closest_inside,
        }


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; return 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks roundtrip", description=__doc__)
    parser.add_argument("--size", type=size, default=(256, 128), help="of the random maps (default 256x128)")
    parser.add_argument("--lamps", type=int, default=8, help="of each family (default 8)")
    parser.add_argument("--precision", choices=("exact", "float", "preview"), default="exact")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    chosen = parser.parse_args(arguments)
    groups = measure(*chosen.size, per_family=chosen.lamps, precision=chosen.precision)
    everything = Sums()
    for sums in groups.values():
        everything = everything.joined(sums)
    print(report({**groups, "all": everything}))
    if chosen.json:
        figures = {name: sums.figures() for name, sums in {**groups, "all": everything}.items()}
        chosen.json.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    return 0


def measure(
    width: int, height: int, *, per_family: int, precision: Literal["exact", "float", "preview"]
) -> dict[str, Sums]:
    """Uplift everything there is; return the sums by kind of map."""
    groups: dict[str, Sums] = {}
    for group, rgb, space, cluster, tables in uplifts(width, height, per_family):
        found = uplift_pixels(rgb, cluster, tables, precision=precision)
        groups.setdefault(group, Sums()).add(rgb, found, space)
    return groups


def uplifts(
    width: int, height: int, per_family: int
) -> Iterator[tuple[str, Image, RGBSpace, npt.NDArray[np.uint32], list[Table]]]:
    """Yield (group, map, space, clusters, tables) of every uplift."""
    eyes, wide = observer(), rgb_space(SPACE)
    named = os.environ.get("ENVCAL_DATA")
    folder = Path(named) if named else None
    every = lamps(per_family, eyes)
    for number, (family, _, emission) in enumerate(every):
        tables = [build_table(emission, observer=eyes, space=wide)]
        for kind in KINDS:
            rgb = random_map(kind, width, height, emission, observer=eyes, space=wide, seed=number)
            yield f"random: {kind}", rgb, wide, np.zeros(rgb.shape[:2], np.uint32), tables
        if folder:
            for _, rgb in relit_rooms(folder, emission, observer=eyes, space=wide):
                yield f"rooms: {family}", rgb, wide, np.zeros(rgb.shape[:2], np.uint32), tables
    if folder is None:
        print("ENVCAL_DATA is not set: random maps only")
        return
    middle = [every[k] for k in range(per_family // 2, len(every), per_family)]
    for _, rgb, space_name in real_maps(folder):
        space = rgb_space(space_name)
        cluster, emissions = _lights(rgb, space)
        yield "real: own lights", rgb, space, cluster, [build_table(e, observer=eyes, space=space) for e in emissions]
        for _, _, emission in middle:
            table = build_table(emission, observer=eyes, space=space)
            yield "real: other lamps", rgb, space, np.zeros(rgb.shape[:2], np.uint32), [table]


def _lights(rgb: Image, space: RGBSpace) -> tuple[npt.NDArray[np.uint32], list[Float64]]:
    """Return the clusters of a map and their lights, as the pipeline finds them."""
    from uplift.cluster import cluster_angles
    from uplift.lights import lights_of
    from uplift.sky import find_sky

    sky = find_sky(rgb, space.luminance_weights)
    clusters = cluster_angles(rgb, luminance_weights=space.luminance_weights, xyz_from_rgb=space.xyz_from_rgb, sky=sky)
    found = lights_of(rgb, clusters, observer=observer(), space=space)
    return clusters.labels, [light.emission for light in found.lights]


def report(groups: dict[str, Sums]) -> str:
    """Return the sums as text."""
    lines = [
        f"{'':22} {'uplifts':>7} {'Mpixel':>7} {'ΔE mean':>8} {'max':>8} {'strict':>8} "
        f"{'fallback':>9} {'max ΔE':>8} {'closest':>9} {'max ΔE':>8}"
    ]
    for name, sums in groups.items():
        share = {kind: count / max(1, sums.pixels) for kind, count in sums.status.items()}
        mean = sums.total / max(1, sums.status["exact"])
        lines.append(
            f"{name:22} {sums.uplifts:7d} {sums.pixels / 1e6:7.2f} {mean:8.1e} {sums.worst:8.1e} {sums.strict:8.1e} "
            f"{share['fallback']:9.4%} {sums.worst_fallback:8.1e} {share['closest']:9.4%} {sums.worst_closest:8.2g}"
        )
    whole = groups["all"]
    shares = ", ".join(f"{count / max(1, whole.pixels):.4%} {kind}" for kind, count in whole.status.items())
    lines += [
        f"status: {shares}",
        f"{whole.above_one} pixels above ΔE2000 1, of which {whole.kept_above_one} are exact or fallback; "
        f"{whole.with_closest} of {whole.uplifts} uplifts have pixels moved to the closest colour; "
        f"{whole.closest_inside} of these lie inside the spectral locus by more than {BORDER:g}",
        f"ratio of the paper's mean (4.85e-12) to this one: {4.85e-12 / max(whole.total / max(1, whole.status['exact']), 1e-300):.3g}; "
        f"of its max (6.53e-12): {6.53e-12 / max(whole.worst, 1e-300):.3g}",
        "ΔE over exact pixels, white = 1; strict: white = the pixel's own luminance",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
