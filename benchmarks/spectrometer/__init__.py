"""The chart as a spectrometer: what the measured spectra are worth, and how often the kind of lamp is right.

`python -m benchmarks spectrometer [--lamps spd_houser.mat] [--json FILE]`. It needs the environment variable ENVCAL_DATA: a
folder with `camera_sensitivities.npz`, `led19_measured.csv`, `truth/room*.npz` and `munsell_glossy_1485.npz`. Each published lamp
that the prior holds is measured with a prior that knows neither it nor any other published lamp within 5 % of its
spectrum. `--lamps` names the 401 lamps of Houser et al. (Opt. Express 21, 2013) as Debian's psychtoolbox-3-common has them;
those within 5 % of a published one, or of the same product, are left out. Readings have 1 % noise on every value, the lamp's
too; an unknown camera is one that the model of cameras was fitted without.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import Any

from benchmarks.spectrometer import held_out, kinds, odd_cameras, refusals
from benchmarks.spectrometer.lamps import houser, left_out_lamps, measured_leds, natural, spread
from benchmarks.spectrometer.readings import cameras
from benchmarks.spectrometer.relight import relights
from benchmarks.spectrometer.report import report


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; return 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks spectrometer", description=__doc__)
    parser.add_argument("--lamps", type=Path, metavar="MAT", help="spd_houser.mat of psychtoolbox-3-common")
    parser.add_argument("--cameras", type=int, default=11, help="cameras (default 11)")
    parser.add_argument("--each", type=int, default=2, help="cameras for each lamp of the relight test (default 2)")
    parser.add_argument("--every", type=int, default=1, help="take every n-th lamp only")
    parser.add_argument(
        "--only",
        choices=("relight", "kinds", "kinds-unknown", "held-out", "refusals", "odd-cameras"),
        help="measure this alone",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    chosen = parser.parse_args(arguments)
    named = os.environ.get("ENVCAL_DATA")
    if named is None:
        print("ENVCAL_DATA is not set: cameras, lamps and rooms are needed; nothing is measured")
        return 0
    folder = Path(named)
    numbers, curves = cameras(folder, chosen.cameras)
    figures: dict[str, Any] = {}
    more = houser(chosen.lamps) if chosen.lamps else []
    fresh = [*measured_leds(folder), *more] if more else [*measured_leds(folder), *left_out_lamps()]
    if chosen.only in (None, "relight"):
        tested = spread(fresh, 40 if more else 1000)[:: chosen.every]
        figures["relight"] = list(relights(folder, tested, numbers, curves, chosen.each))
    everything = [*fresh, *(left_out_lamps() if more else []), *natural(folder)][:: chosen.every]
    if chosen.only in (None, "kinds"):
        figures["kinds_known"] = kinds.kinds(everything, numbers, curves, known=True)
    if chosen.only == "kinds-unknown":
        figures["kinds_unknown"] = kinds.kinds(everything, numbers, curves, known=False)
    if chosen.only == "held-out":
        figures["held_out"] = held_out.held_out(held_out.measured(everything, numbers, curves))
    if chosen.only == "refusals":
        figures["refusals"] = refusals.named(curves, numbers[1:7:5])
    if chosen.only == "odd-cameras":
        figures["odd_cameras"] = odd_cameras.odd_cameras(folder, odd_cameras.one_of_each(fresh), curves)
    print(report(figures))
    if chosen.json:
        chosen.json.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    return 0
