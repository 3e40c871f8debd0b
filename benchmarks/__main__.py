"""`python -m benchmarks [NAME [OPTION …]]`: list the benchmarks and run all of them, or run one."""

from __future__ import annotations

import sys
from importlib import import_module

BENCHMARKS = {
    "uplift": "speed and memory of every uplift, with ratios to a plain loop and to the lattice",
    "lights": "which lights are found in rooms and skies, and what their spectra are worth",
    "merge": "time, memory and error of merging a bracket, beside HDRutils, colour-hdri and OpenCV",
    "colour": "how true colours are after chart, lamp or camera sensitivities, over many cameras",
    "chart": "charts found and falsely found in synthetic scenes, maps and photographs",
    "lamp": "D65 lamps found, and other things taken for one, in synthetic captures",
    "roundtrip": "how exactly RGB comes back, over maps and lamps of all families",
    "brightness": "how well pixels relight surfaces, by how bright their reflectance is taken to be",
    "relit_render": "a rendered scene under the true spectra of a room, our uplift and the usual one",
    "render": "the Mitsuba emitter beside Mitsuba's own environment map: time, noise, start-up",
    "pipeline": "from RAW files to spectra: the whole pipeline on synthetic captures, beside the truth",
    "spectrometer": "spectra and kinds of lamps as the chart measures them",
}


def main(arguments: list[str] | None = None) -> int:
    """Run what was named; return 0, or 2 if there is no such benchmark."""
    given = sys.argv[1:] if arguments is None else arguments
    if given and given[0] in BENCHMARKS:
        return int(import_module(f"benchmarks.{given[0]}").main(given[1:]))
    for name, what in BENCHMARKS.items():
        print(f"{name:10} {what}")
    if given and given[0] in ("-h", "--help", "--list"):
        print("\npython -m benchmarks runs all; python -m benchmarks NAME --help tells the options of one")
        return 0
    if given:
        print(f"\n{given[0]}: no such benchmark; expected {' or '.join(BENCHMARKS)}", file=sys.stderr)
        return 2
    for name in BENCHMARKS:
        print(f"\n== {name} ==\n")
        import_module(f"benchmarks.{name}").main([])
    return 0


if __name__ == "__main__":
    sys.exit(main())
