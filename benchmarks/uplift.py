"""Speed and memory of every uplift in one run: same map, same machine, with ratios.

`python -m benchmarks uplift [--size 4096x2048] [--large [16384x8192]]`
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from benchmarks.maps import lit_map, size
from benchmarks.peers import PlainLoop, colour_look_up, renderer_load
from uplift.difference import delta_e_2000
from uplift.illuminants import family_emission
from uplift.lattice import build_cube, build_lattice, rgb_of_lattice, spectra_of_lattice, uplift_lattice
from uplift.pixels import Buffers, Status, rgb_of, spectra_of, uplift_pixels
from uplift.scaled import uplift_scaled
from uplift.spectrum import illuminant, observer, rgb_space
from uplift.table import build_table

#: What one light of each kind costs; the map is lit by all of them.
LIGHTS = ("D65", "FL2", "LED-B3", "incandescent 2856 K")


@dataclass(frozen=True, slots=True)
class Row:
    """One way of uplifting: `rate` and `single` in Mpixel/s on all cores and on one; ΔE2000 of the round trip; `memory`,
    the most that numpy held during a run, in bytes a pixel.
    """

    name: str
    rate: float
    single: float | None
    pixels: int
    mean: float | None
    worst: float | None
    remark: str = ""
    memory: float | None = None


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; return 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks uplift", description=__doc__)
    parser.add_argument("--size", type=size, default=(4096, 2048), help="of the map (default 4096x2048)")
    parser.add_argument("--crop", type=int, default=1 << 17, help="pixels for the slow peers (default 131072)")
    parser.add_argument("--repeat", type=int, default=5, help="runs of each; the fastest counts")
    parser.add_argument(
        "--large", type=size, nargs="?", const=(16384, 8192), help="stream a map of this size, in tiles"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    parser.add_argument("--streaming", type=size, help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if chosen.streaming:
        print(json.dumps(stream(*chosen.streaming)))
        return 0
    figures = (
        {"large": large(*chosen.large)} if chosen.large else speed(*chosen.size, crop=chosen.crop, repeat=chosen.repeat)
    )
    if chosen.json:
        chosen.json.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    return 0


def precisions() -> list[dict[str, Any]]:
    """Return the settings under which `uplift_pixels` is measured."""
    return [{"precision": name} for name in ("exact", "float", "preview")]


def fastest(run: Callable[[], Any], repeat: int) -> float:
    """Return the seconds of the fastest of `repeat` runs."""
    out = []
    for _ in range(max(1, repeat)):
        start = time.perf_counter()
        run()
        out.append(time.perf_counter() - start)
    return min(out)


def peak_gb() -> float | None:
    """Return the most memory this process has held, in GB; None where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return used / 1e9 if sys.platform == "darwin" else used * 1024 / 1e9


@dataclass(frozen=True, slots=True)
class _Case:
    """What is measured: a call for the rows of a slice, and what is known of its errors."""

    name: str
    run: Callable[[slice], Any]
    mean: float | None = None
    worst: float | None = None
    remark: str = ""


def _together(cases: Sequence[_Case], shape: tuple[int, int], repeat: int) -> list[Row]:
    """Measure every case on all cores and on one, turn about: a machine that is slow for a while is so for all of them."""
    height, width = shape
    cores = numba.get_num_threads()
    seconds = {(case.name, threads): [math.inf] for case in cases for threads in (cores, 1)}
    for case in cases:
        case.run(slice(0, 2))  # compiles
    try:
        for _ in range(max(1, repeat)):
            for case in cases:
                for threads in (cores, 1):
                    numba.set_num_threads(threads)
                    start = time.perf_counter()
                    case.run(slice(0, height))
                    seconds[case.name, threads].append(time.perf_counter() - start)
    finally:
        numba.set_num_threads(cores)
    quarter = max(2, height // 4)
    rows = []
    for case in cases:
        memory = _held(partial(case.run, slice(0, quarter))) / (quarter * width)
        rate, single = (height * width / min(seconds[case.name, threads]) / 1e6 for threads in (cores, 1))
        rows.append(Row(case.name, rate, single, height * width, case.mean, case.worst, case.remark, memory))
    return rows


def _held(run: Callable[[], Any]) -> float:
    """Return the most bytes that numpy held for `run`."""
    tracemalloc.start()
    try:
        run()
        return float(tracemalloc.get_traced_memory()[1])
    finally:
        tracemalloc.stop()


def speed(width: int, height: int, *, crop: int, repeat: int) -> dict[str, Any]:
    """Measure every way of uplifting one map, print the table, and return the figures."""
    eyes = observer()
    space = rgb_space("ITU-R BT.2020")
    emissions = [illuminant(name, eyes) for name in LIGHTS[:3]] + [family_emission("incandescent", 2856, eyes)]
    rgb, cluster = lit_map(width, height, emissions, observer=eyes, space=space)
    print(
        f"{width}×{height}, {len(LIGHTS)} lights ({', '.join(LIGHTS)}), {space.name}, {numba.get_num_threads()} cores"
    )
    print(
        "the plain loop and the three precisions write into memory that is there, as who streams a map lets them; "
        "B/pixel is what they take besides"
    )

    # Every n-th row: as many pixels as the slow ones can take, of all lights.
    every = max(1, -(-width * height // crop))
    few, few_cluster = np.ascontiguousarray(rgb[::every]), np.ascontiguousarray(cluster[::every])
    on_crop = f"rate measured on one row in {every}" if every > 1 else ""

    plain = PlainLoop(emissions, observer=eyes, space=space)
    cases: list[_Case] = []
    memory = (np.empty(rgb.shape), np.empty(cluster.shape))
    for steps, name in ((2, "plain loop"), (0, "plain loop, look-up alone")):
        c, s = plain(few, few_cluster, steps=steps)
        error = _errors(few, plain.colours(c, s, few_cluster), space)
        whole = partial(_rows, partial(plain, steps=steps, out=memory), rgb, cluster)
        cases.append(_Case(name, whole, error["mean"], error["worst"]))
    tables = [build_table(light, observer=eyes, space=space) for light in emissions]
    buffers = Buffers.of(cluster.size)
    for settings in precisions():
        solve: Any = partial(uplift_pixels, tables=tables, **settings)
        found = solve(few, few_cluster)
        shown = rgb_of(found.coefficients, found.scale, found.emission, found.emissions, observer=eyes, space=space)
        error = _errors(few, shown, space, found.status)
        whole = partial(_rows, partial(solve, out=buffers), rgb, cluster)
        name = settings.get("precision", "exact")
        cases.append(_Case(name, whole, error["mean"], error["worst"], _shares(found.counts)))
    rows = _together(cases, (height, width), repeat)
    rows += _slow_peers(few, few_cluster, emissions, repeat, on_crop)
    peers, skipped = _foreign_peers(rgb, few, repeat, on_crop)
    rows += peers
    print(_table(rows))
    for reason in skipped:
        print(f"skipped: {reason}")
    builds = _builds(emissions, repeat)
    peak = peak_gb()
    print(f"peak memory of this process: {peak:.2f} GB" if peak else "peak memory: not told by this system")
    return {
        "size": [width, height],
        "rows": [asdict(row) for row in rows],
        "skipped": skipped,
        **builds,
        "peak_gb": peak,
    }


def _rows(solve: Any, rgb: npt.NDArray[np.float32], cluster: npt.NDArray[np.uint32], part: slice) -> None:
    solve(rgb[part], cluster[part])


def _errors(
    rgb: npt.NDArray[np.float32], shown: npt.NDArray[np.float64], space: Any, status: Any = None
) -> dict[str, float]:
    """Return the mean and the worst ΔE2000 over the pixels that were solved."""
    difference = delta_e_2000(rgb.astype(np.float64), shown, space)
    if status is not None:
        difference = difference[(status == Status.EXACT) | (status == Status.FALLBACK)]
    return {"mean": float(np.nanmean(difference)), "worst": float(np.nanmax(difference))}


def _shares(counts: dict[Status, int]) -> str:
    total = max(1, sum(counts.values()))
    return ", ".join(f"{n / total:.2%} {kind.name.lower()}" for kind, n in counts.items() if n and kind)


def _slow_peers(
    rgb: npt.NDArray[np.float32],
    cluster: npt.NDArray[np.uint32],
    emissions: list[npt.NDArray[np.float64]],
    repeat: int,
    remark: str,
) -> list[Row]:
    """Measure the baselines of the package, and what it costs to turn each result into 81 bands."""
    eyes = observer()
    space = rgb_space("ITU-R BT.2020")
    shape = rgb.shape[:2]
    cube = build_cube(observer=eyes, space=space)
    lattices = [build_lattice(light, cube) for light in emissions]
    mixed = uplift_lattice(rgb, cluster, lattices)
    where = (mixed.cell, mixed.position, mixed.scale, mixed.emission)
    error = _errors(rgb, rgb_of_lattice(*where, mixed.emissions, cube), space, mixed.status)
    scaled = uplift_scaled(rgb, observer=eyes, space=space)
    shown = rgb_of(scaled.coefficients, scaled.scale, scaled.emission, scaled.emissions, observer=eyes, space=space)
    looks = f"{mixed.visited[mixed.status == Status.EXACT].mean():.2f} look-ups a pixel"
    tables = [build_table(light, observer=eyes, space=space) for light in emissions]

    def in_bands(part: slice) -> None:
        up = uplift_pixels(rgb[part], cluster[part], tables)
        spectra_of(up.coefficients, up.scale, up.emission, up.emissions, eyes.wavelengths_nm, observer=eyes)

    def lattice_in_bands(part: slice) -> None:
        up = uplift_lattice(rgb[part], cluster[part], lattices)
        spectra_of_lattice(up.cell, up.position, up.scale, up.emission, up.emissions, cube)

    def scale(part: slice) -> None:
        uplift_scaled(rgb[part], observer=eyes, space=space)

    def mix(part: slice) -> None:
        uplift_lattice(rgb[part], cluster[part], lattices)

    plain = _errors(rgb, shown, space, scaled.status)
    notes = {
        "scaled": "; ".join(note for note in (_shares(scaled.counts), remark) if note),
        "lattice": "; ".join(note for note in (looks, _shares(mixed.counts), remark) if note),
    }
    cases = [
        _Case("scaled", scale, plain["mean"], plain["worst"], notes["scaled"]),
        _Case("lattice", mix, error["mean"], error["worst"], notes["lattice"]),
        _Case("exact, and its 81 bands", in_bands, remark=remark),
        _Case("lattice, and its 81 bands", lattice_in_bands, remark=remark),
    ]
    return _together(cases, shape, repeat)


def _foreign_peers(
    rgb: npt.NDArray[np.float32], few: npt.NDArray[np.float32], repeat: int, remark: str
) -> tuple[list[Row], list[str]]:
    rows, skipped = [], []
    look_up = colour_look_up(observer(), rgb_space("ITU-R BT.2020"))
    if isinstance(look_up, str):
        skipped.append(look_up)
    else:
        pixels = few.shape[0] * few.shape[1]
        rate = pixels / fastest(lambda: look_up(few), repeat) / 1e6
        rows.append(
            Row(
                "colour-science Jakob2019",
                rate,
                None,
                pixels,
                None,
                None,
                "; ".join(note for note in ("look-up", remark) if note),
            )
        )
    loaded = renderer_load(rgb)
    if isinstance(loaded, str):
        skipped.append(loaded)
    else:
        variant, seconds = loaded
        pixels = rgb.shape[0] * rgb.shape[1]
        rows.append(Row(f"Mitsuba {variant}", pixels / seconds / 1e6, None, pixels, None, None, "loads the map"))
    return rows, skipped


def _table(rows: list[Row]) -> str:
    """Return the rows as text, each with its ratio to the plain loop and to the lattice."""
    rate = {row.name: row.rate for row in rows}
    head = f"{'':27} {'Mpixel/s':>9} {'one core':>9} {'ratio':>6} {'× plain':>8} {'× lattice':>9} {'B/pixel':>8} {'ΔE mean':>8} {'max':>8}"
    lines = [head]
    for row in rows:
        single = f"{row.single:9.3f} {row.rate / row.single:6.2f}" if row.single else f"{'':16}"
        held = "" if row.memory is None else f"{row.memory:.0f}"
        errors = "" if row.mean is None else f"{row.mean:8.1e} {row.worst:8.1e}"
        lines.append(
            f"{row.name:27} {row.rate:9.3f} {single} {row.rate / rate['plain loop']:8.2f} "
            f"{row.rate / rate['lattice']:9.1f} {held:>8} {errors:17}  {row.remark}".rstrip()
        )
    bands = rate["exact, and its 81 bands"] / rate["lattice, and its 81 bands"]
    lines.append(f"ratio exact : lattice {rate['exact'] / rate['lattice']:.1f}, with the spectra of both {bands:.1f}")
    return "\n".join(lines)


def _builds(emissions: list[npt.NDArray[np.float64]], repeat: int) -> dict[str, Any]:
    """Measure what is built once a light, print it, and return it in seconds."""
    eyes = observer()
    space = rgb_space("ITU-R BT.2020")
    cube = build_cube(observer=eyes, space=space)
    tables = {
        name: fastest(partial(build_table, light, observer=eyes, space=space), repeat)
        for name, light in zip(LIGHTS, emissions, strict=True)
    }
    lattices = {
        name: fastest(partial(build_lattice, light, cube), repeat)
        for name, light in zip(LIGHTS, emissions, strict=True)
    }
    whole = fastest(lambda: build_cube(observer=eyes, space=space), 1)
    for what, seconds in (("table", tables), ("lattice", lattices)):
        print(f"{what:8} " + ", ".join(f"{name} {t:.3f} s" for name, t in seconds.items()))
    ratio = (whole + max(lattices.values())) / max(tables.values())
    print(f"the lattices' cube, once for all lights: {whole:.3f} s; ratio (cube + lattice) : table {ratio:.1f}")
    return {"table_s": tables, "lattice_s": lattices, "cube_s": whole}


def large(width: int, height: int) -> dict[str, Any]:
    """Uplift a file of this size in a process of its own, print time and memory, and return them."""
    command = [sys.executable, "-m", "benchmarks", "uplift", "--streaming", f"{width}x{height}"]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=Path(__file__).parents[1])
    figures: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    pixels = width * height / 1e6
    print(f"{width}×{height} through the step `uplift`, tile by tile, from file to file:")
    peak = f"{figures['peak_gb']:.2f} GB (ratio to 8 GB: {figures['peak_gb'] / 8:.2f})" if figures["peak_gb"] else "?"
    print(f"  {figures['seconds']:.1f} s, {pixels / figures['seconds']:.2f} Mpixel/s, peak memory {peak}")
    print(f"  of which reading the map {figures['read_s']:.1f} s; the file has {figures['bytes'] / 1e9:.2f} GB")
    print(f"  {figures['summary']}")
    return figures


def stream(width: int, height: int) -> dict[str, Any]:
    """Write a map and its clusters in tiles, uplift them with the step's own function, and return the figures."""
    from envcal import exr
    from envcal.config import UpliftSettings
    from envcal.lights_file import LightRecord, Lights
    from envcal.maps import read_map
    from envcal.provenance import colour_space
    from envcal.steps.uplift import uplift

    eyes = observer()
    space = rgb_space("ITU-R BT.2020")
    emissions = [illuminant(name, eyes) for name in LIGHTS[:3]] + [family_emission("incandescent", 2856, eyes)]
    blank = {"type": "measured", "cct": None, "duv": None, "cct_seen": None, "cct_sigma": None, "duv_seen": None}
    told = {"outdoor": False, "share": 0.25, "at": (0.5, 0.5), "source": "", "confidence": 1.0, "declared": True}
    lights = Lights(
        wavelengths="380:780:5",
        observer=eyes.name,
        space=space.name,
        sky=False,
        lights=[
            LightRecord.model_validate(
                {"cluster": k, "remedy": "", "emission": [float(v) for v in light], **blank, **told}
            )
            for k, light in enumerate(emissions)
        ],
    )
    rows = min(256, height)
    rgb, cluster = lit_map(width, rows, emissions, observer=eyes, space=space)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        image, clusters = folder / "map.exr", folder / "clusters.exr"
        same = {**colour_space(space.name), "envmap": True}
        names: dict[str, Any] = dict.fromkeys("RGB", "f4")
        with (
            exr.Writer(image, (height, width), channels=names, attributes=same) as first,
            exr.Writer(
                clusters,
                (height, width),
                channels={"cluster": "u4"},
                attributes={**same, "envcalLights": lights.model_dump(mode="json")},
            ) as second,
        ):
            for top in range(0, height, rows):
                count = min(rows, height - top)
                first.rows(exr.rgb_planes(rgb[:count]))
                second.rows({"cluster": cluster[:count]})
        del rgb, cluster
        start = time.perf_counter()
        source = read_map(image)
        read = time.perf_counter() - start
        outcome = uplift(source, clusters, folder / "up.exr", UpliftSettings())
        seconds = time.perf_counter() - start
        return {
            "size": [width, height],
            "seconds": seconds,
            "read_s": read,
            "peak_gb": peak_gb(),
            "bytes": (folder / "up.exr").stat().st_size,
            "summary": outcome.summary,
            "status": outcome.figures["status"],
        }


if __name__ == "__main__":
    sys.exit(main())
