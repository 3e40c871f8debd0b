"""Merging a bracket: time, memory and error against the truth, beside other libraries in one run.

`python -m benchmarks merge [--size 1500x1000] [--full] [--peers PYTHON]`
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from pathlib import Path
from time import strftime

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.maps import size
from benchmarks.merge_worker import WAYS

Image = npt.NDArray[np.float32]

#: 24 megapixels × 7 frames, 61 megapixels × 5.
FULL = (((6000, 4000), 7), ((9504, 6336), 5))
BLACK, WHITE, GAIN, READ_E = 512, 16383, 3.1, 3.0
DECADES = range(-3, 3)
OURS = tuple(name for name in WAYS if name.startswith("envcal"))
#: A pixel is beside clipping if its green is so near to what some frame clips at (natural logarithm).
_BESIDE = 0.1
_MANY_PIXELS = 4_000_000


@dataclass(frozen=True, slots=True)
class Faults:
    """What a capture's files do not say."""

    factors: tuple[float, ...]
    blacks: tuple[float, float, float, float]
    clips: tuple[float, float, float, float]


@dataclass(slots=True)
class Row:
    """One library on one bracket; errors by decade of radiance, relative."""

    name: str
    seconds: float = 0.0
    cpu: float = 0.0
    peak_per_pixel: float = 0.0
    rmse: dict[int, float] = field(default_factory=dict)
    bias: dict[int, float] = field(default_factory=dict)
    fringe: float = 0.0
    fringe_elsewhere: float = 0.0
    skipped: str = ""


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; return 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks merge", description=__doc__)
    parser.add_argument("--size", type=size, default=(1500, 1000), help="of the frames (default 1500x1000)")
    parser.add_argument("--frames", type=int, default=7, help="of the bracket, 2 EV apart (default 7)")
    parser.add_argument("--full", action="store_true", help="24 megapixels × 7 frames, and 61 × 5")
    parser.add_argument(
        "--peers", type=Path, metavar="PYTHON", default=Path(sys.executable),
        help="the interpreter of an environment with HDRutils, colour-hdri and OpenCV (default: this one)",
    )  # fmt: skip
    parser.add_argument(
        "--memory", type=float, default=None, metavar="GB",
        help="what no library may exceed (default: four fifths of what is free, at most 14)",
    )  # fmt: skip
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    given = parser.parse_args(arguments)
    gigabytes = given.memory or free_gigabytes()
    found = {}
    for (width, height), frames in FULL if given.full else ((given.size, given.frames),):
        for faulty in (False, True):
            name = f"{width}×{height}, {frames} frames, {'faulty' if faulty else 'as its files say'}"
            print(f"\n{name}\n", flush=True)
            # The peers believe the files: what faults do to them shows on small frames, and takes them minutes on large ones.
            ways = OURS if given.full and faulty else tuple(WAYS)
            rows, ideal = measure(
                (width, height), frames, faulty=faulty, peers=given.peers, ways=ways, gigabytes=gigabytes
            )
            print(table(rows, ideal), flush=True)
            found[name] = {"ideal": ideal, "rows": [asdict(row) for row in rows]}
    if given.json:
        given.json.write_text(json.dumps(found, indent=1), encoding="utf-8")
    return 0


def free_gigabytes() -> float:
    """Return four fifths of the free memory, at most 14 GB; 6 where the system does not tell."""
    told = Path("/proc/meminfo")
    if not told.is_file():
        return 6.0
    (line,) = [line for line in told.read_text(encoding="utf-8").splitlines() if line.startswith("MemAvailable")]
    return min(0.8 * int(line.split()[1]) / 1e6, 14.0)


def say(text: str) -> None:
    """Tell on stderr what goes on, with the time."""
    print(f"{strftime('%H:%M:%S')} {text}", file=sys.stderr, flush=True)


def truth(width: int, height: int, seed: int = 1) -> Image:
    """Return radiance over six decades, shape (height, width, 3): soft hills of soft colours, brightest 10^2.5."""
    rng = np.random.default_rng(seed)

    def hills(cells: int) -> Image:
        coarse = rng.standard_normal((cells, cells * 3 // 2)).astype(np.float32)
        soft = cv2.resize(cv2.GaussianBlur(coarse, (0, 0), 1.0), (width, height), interpolation=cv2.INTER_CUBIC)
        return np.asarray((soft - soft.min()) / (soft.max() - soft.min()), np.float32)

    level = 10 ** (np.float32(-3.2) + np.float32(5.7) * hills(14))
    return np.stack(
        [level * (np.float32(0.4) + np.float32(0.5) * hills(9)), level, level * (0.3 + 0.5 * hills(8))], axis=-1
    )


def faults(frames: int, *, faulty: bool) -> Faults:
    """Return none, or times wrong by up to 1/3 EV, black by up to 3 counts, and white levels by colour."""
    if not faulty:
        return Faults((1.0,) * frames, (0.0,) * 4, (WHITE,) * 4)
    rng = np.random.default_rng(7)
    wrong = 2 ** rng.uniform(-1 / 3, 1 / 3, frames)
    wrong /= np.sort(wrong)[(frames - 1) // 2]  # only ratios can be known
    b, c = rng.uniform(-3, 3, 4), np.round(rng.uniform(15200, WHITE, 4))
    return Faults(tuple(wrong), (b[0], b[1], b[2], b[3]), (c[0], c[1], c[2], c[3]))


def times(frames: int) -> list[Fraction]:
    """Return exposure times 2 EV apart that cover the truth: the shortest clips nothing."""
    return [Fraction(4**k, 512) for k in range(frames)]


def expose(radiance: Image, time: Fraction, n: int, fault: Faults) -> npt.NDArray[np.uint16]:
    """Return the counts of one frame, RGGB; in bands, so that 61 megapixels fit."""
    rng = np.random.default_rng(100 + n)
    height, width = radiance.shape[:2]
    out = np.empty((height, width), np.uint16)
    for top in range(0, height, 256):
        band = radiance[top : top + 256]
        for k, channel in enumerate((0, 1, 1, 2)):
            place = np.s_[k // 2 :: 2, k % 2 :: 2]
            light = band[..., channel][place].astype(np.float64) * float(time) * fault.factors[n]
            electrons = rng.poisson(np.minimum(light, 1.5) * (WHITE - BLACK) * GAIN)
            counts = (electrons + READ_E * rng.standard_normal(light.shape)) / GAIN + BLACK + fault.blacks[k]
            out[top : top + 256][place] = np.clip(np.rint(np.minimum(counts, fault.clips[k])), 0, 65535)
    return out


def write(folder: Path, radiance: Image, frames: int, fault: Faults) -> Image:
    """Write the bracket as DNG and return the ideal estimator's mosaic: all parameters and the radiance known to it."""
    from samples.dng import encode_dng
    from samples.sensor import Camera

    camera = Camera(black_dn=(BLACK,) * 4, white_dn=WHITE)
    folder.mkdir(parents=True, exist_ok=True)
    height, width = radiance.shape[:2]
    above, below = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    well = GAIN * (WHITE - BLACK)
    # A frame's noise hangs on its own number alone, so that they can be exposed side by side.
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        exposed = pool.map(lambda n: expose(radiance, times(frames)[n], n, fault), range(frames))
    for n, (time, counts) in enumerate(zip(times(frames), exposed, strict=True)):
        (folder / f"frame_{n}.dng").write_bytes(encode_dng(counts, time, camera=camera, neutral=np.ones(3)))
        for k, channel in enumerate((0, 1, 1, 2)):
            place = np.s_[k // 2 :: 2, k % 2 :: 2]
            light = float(time) * fault.factors[n]
            signal = radiance[..., channel][place] * light
            weight = light**2 / (signal / well + (READ_E**2 + GAIN**2 / 12) / well**2)
            black = BLACK + fault.blacks[k]
            weight[(counts[place] >= fault.clips[k]) | (signal * (WHITE - BLACK) + black >= fault.clips[k])] = 0
            above[place] += weight * (counts[place] - black) / (WHITE - BLACK) / light
            below[place] += weight
    with np.errstate(invalid="ignore"):
        return np.asarray(above / below, np.float32)


def mosaic_of(image: Image) -> Image:
    """Return the samples of an image that an RGGB mosaic has."""
    out = np.empty(image.shape[:2], np.float32)
    for k, channel in enumerate((0, 1, 1, 2)):
        out[k // 2 :: 2, k % 2 :: 2] = image[k // 2 :: 2, k % 2 :: 2, channel]
    return out


def measure(
    shape: tuple[int, int],
    frames: int,
    *,
    faulty: bool,
    peers: Path,
    ways: tuple[str, ...] = tuple(WAYS),
    gigabytes: float = 6.0,
) -> tuple[list[Row], dict[int, float]]:
    """Return a row for every library, and the ideal estimator's error by decade."""
    width, height = shape
    radiance = truth(width, height)
    fault = faults(frames, faulty=faulty)
    say(f"the bracket is exposed and written: {frames} frames of {width}×{height}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        best = write(folder, radiance, frames, fault)
        write(folder / "small", truth(180, 120), frames, fault)
        told = {"times": [float(t) for t in times(frames)], "black": BLACK}
        (folder / "told.json").write_text(json.dumps(told), encoding="utf-8")
        true = mosaic_of(radiance)
        ideal = {d: e for d, (e, _) in by_decade(best, true, 1.0).items()}
        rows = [_run(way, folder, radiance, true, fault, peers, gigabytes) for way in ways]
    return rows, ideal


def _run(way: str, folder: Path, radiance: Image, true: Image, fault: Faults, peers: Path, gigabytes: float) -> Row:
    row, out = Row(way), folder / "out.npy"
    say(way)
    python = Path(sys.executable) if way in OURS else peers
    worker = Path(__file__).with_name("merge_worker.py")
    path = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]) if way in OURS else ""
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(
        [str(python), str(worker), way, str(folder), str(out), str(gigabytes)],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    if done.returncode:
        row.skipped = (done.stderr.strip().splitlines() or ["stopped without a word"])[-1]
        if any(
            word in done.stderr for word in ("MemoryError", "bad_alloc", "Insufficient memory", "Unable to allocate")
        ):
            row.skipped = f"wants more than {gigabytes:g} GB (--memory)"
        return row
    figures = json.loads(done.stdout.strip().splitlines()[-1])
    row.seconds, row.cpu = figures["seconds"], figures["cpu"]
    row.peak_per_pixel = (figures["peak"] - figures["before"]) / true.size
    image = np.load(out)
    if image.shape != radiance.shape:
        row.skipped = f"returned {image.shape} for {radiance.shape}"
        return row
    # Units differ: one factor, from the pixels that every library measures well.
    well = (radiance[..., 1] > 0.05) & (radiance[..., 1] < 5) & (image[..., 1] > 0)
    scale = float(np.median(image[..., 1][well] / radiance[..., 1][well]))
    for decade, (rmse, bias) in by_decade(mosaic_of(image), true, scale).items():
        row.rmse[decade], row.bias[decade] = rmse, bias
    row.fringe, row.fringe_elsewhere = fringes(image, radiance, fault, len(fault.factors))
    return row


def by_decade(mosaic: Image, true: Image, scale: float) -> dict[int, tuple[float, float]]:
    """Return relative RMSE and bias by decade of radiance, at the samples that were measured."""
    error = mosaic / scale / true - 1
    out = {}
    for decade in DECADES:
        inside = (true >= 10.0**decade) & (true < 10.0 ** (decade + 1)) & np.isfinite(error)
        if inside.sum() > 1000:
            values = error[inside].astype(np.float64)
            out[decade] = (float(np.sqrt(np.mean(values**2))), float(np.mean(values)))
    return out


def fringes(image: Image, radiance: Image, fault: Faults, frames: int) -> tuple[float, float]:
    """Return the RMS error of log R/G and log B/G beside the clipping of some frame's green, and elsewhere as bright.

    Of large images every third pixel of every third row is looked at, which meets all places of the pattern.
    """
    if image.shape[0] * image.shape[1] > _MANY_PIXELS:
        image, radiance = image[::3, ::3], radiance[::3, ::3]
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.log(image[..., ::2] / image[..., 1:2]) - np.log(radiance[..., ::2] / radiance[..., 1:2])
    off -= np.nanmedian(off, axis=(0, 1))
    squares = (off**2).sum(axis=2)
    green = np.log(radiance[..., 1])
    tops = [-np.log(float(t) * f) for t, f in zip(times(frames), fault.factors, strict=True)]
    near = np.zeros(green.shape, np.bool_)
    for top in tops:
        near |= np.abs(green - top) < _BESIDE
    bright = (green > min(tops)) & np.isfinite(squares)
    return float(np.sqrt(np.mean(squares[bright & near]))), float(np.sqrt(np.mean(squares[bright & ~near])))


def table(rows: list[Row], ideal: dict[int, float]) -> str:
    """Return the table and the ratios as text."""
    heads = " ".join(f"{f'1e{d}':>9}" for d in ideal)
    lines = [f"{'relative RMSE by decade':28}{heads}", f"{'ideal':28}" + " ".join(f"{v:9.4%}" for v in ideal.values())]
    done = [row for row in rows if not row.skipped]
    for row in done:
        lines.append(f"{row.name:28}" + " ".join(f"{row.rmse.get(d, np.nan):9.4%}" for d in ideal))
        lines.append(
            f"{'  ratio to the ideal':28}" + " ".join(f"{row.rmse.get(d, np.nan) / v:9.3f}" for d, v in ideal.items())
        )
        lines.append(f"{'  bias':28}" + " ".join(f"{row.bias.get(d, np.nan):+9.4%}" for d in ideal))
    lines.append(f"\n{'':16}{'s':>9}{'CPU s':>9}{'peak B/px':>11}{'chroma beside clipping':>24}{'elsewhere':>11}")
    lines += [
        f"{row.name:16}{row.seconds:9.2f}{row.cpu:9.2f}{row.peak_per_pixel:11.1f}{row.fringe:24.4f}{row.fringe_elsewhere:11.4f}"
        for row in done
    ]
    lines += ratios(done)
    lines += [f"skipped {row.name}: {row.skipped}" for row in rows if row.skipped]
    return "\n".join(lines)


def ratios(done: list[Row]) -> list[str]:
    """Return what others take and miss in terms of envcal, and what a second core gains."""
    by_name = {row.name: row for row in done}
    mine, alone = by_name.get("envcal"), by_name.get("envcal, one core")
    if mine is None:
        return []
    lines = []
    if alone:
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        lines.append(f"envcal on {cores} cores: {alone.seconds / max(mine.seconds, 1e-9):.2f} times as fast as on one")
    for row in done:
        if row.name in OURS:
            continue
        errors = [row.rmse[d] / mine.rmse[d] for d in mine.rmse if d in row.rmse]
        written = by_name.get("envcal to EXR")
        to_file = f" ({row.seconds / written.seconds:.1f} with the file written)" if written else ""
        lines.append(
            f"ratio {row.name} : envcal: time {row.seconds / max(mine.seconds, 1e-9):.1f}{to_file}, CPU time "
            f"{row.cpu / max(mine.cpu, 1e-9):.1f}, memory {row.peak_per_pixel / max(mine.peak_per_pixel, 1e-9):.1f}, "
            f"error {min(errors):.2f} to {max(errors):.2f}"
        )
    return lines


if __name__ == "__main__":
    sys.exit(main())
