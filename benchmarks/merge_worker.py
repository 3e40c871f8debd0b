"""Merge one bracket with one library, alone in its process: `python merge_worker.py NAME FOLDER OUT.npy GIGABYTES`.

Prints a line of JSON: seconds and peak memory. Imports nothing but the library it runs, so that it also works in an
environment that has only that library and rawpy. A library that wants more memory than GIGABYTES ends with a MemoryError.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


def envcal(files: list[Path], _told: dict[str, Any]) -> np.ndarray[Any, Any]:
    from calibrate.demosaic import demosaic
    from calibrate.merge import Asked, measure_bracket, merge_mosaics
    from envcal.raw import open_bracket

    raws = open_bracket(files)
    measured = measure_bracket(raws, Asked())
    merged = merge_mosaics(raws, measured=measured)
    del raws
    return demosaic(merged.mosaic, merged.cfa)


def envcal_to_exr(files: list[Path], _told: dict[str, Any]) -> Callable[[], np.ndarray[Any, Any]]:
    """What `envcal merge` does, file written; it is read back when the time is taken."""
    from envcal import exr
    from envcal.config import MergeSettings
    from envcal.steps.merge import merge

    out = files[0].with_name("merged.exr")
    merge(files, out, MergeSettings())
    return lambda: exr.read_rgb(out)[1]


def hdrutils(files: list[Path], told: dict[str, Any]) -> np.ndarray[Any, Any]:
    import HDRutils

    n = len(files)
    image, _ = HDRutils.merge(
        [str(f) for f in files],
        demosaic_first=False,
        color_space="raw",
        demosaic="malvar",
        black_level=told["black"],
        exp=told["times"],
        gain=np.ones(n),
        aperture=np.ones(n),
        bits=14,
    )
    return np.asarray(image, np.float32)


def _developed(path: Path, bits: int) -> np.ndarray[Any, Any]:
    import rawpy

    with rawpy.imread(str(path)) as raw:
        return np.asarray(
            raw.postprocess(
                gamma=(1, 1),
                no_auto_bright=True,
                output_bps=bits,
                user_wb=[1, 1, 1, 1],
                output_color=rawpy.ColorSpace.raw,
                user_flip=0,
                adjust_maximum_thr=0,
            )
        )


def colour_hdri(files: list[Path], told: dict[str, Any]) -> np.ndarray[Any, Any]:
    from colour_hdri import Image, ImageStack, Metadata, image_stack_to_HDRI

    stack = ImageStack()
    stack.extend(
        Image(str(f), data=_developed(f, 16).astype(np.float32) / 65535, metadata=Metadata(8.0, t, 100.0))
        for f, t in zip(files, told["times"], strict=True)
    )
    return np.asarray(image_stack_to_HDRI(stack), np.float32)


def opencv(files: list[Path], told: dict[str, Any]) -> np.ndarray[Any, Any]:
    import cv2

    images = [np.ascontiguousarray(_developed(f, 8)) for f in files]
    linear = np.repeat(np.arange(256, dtype=np.float32)[:, None, None], 3, axis=2) / 255
    linear[0] = linear[1] / 2  # its logarithm is taken
    times = np.array(told["times"], np.float32)
    return np.asarray(cv2.createMergeDebevec().process(images, times, linear), np.float32)


WAYS: dict[str, Callable[[list[Path], dict[str, Any]], Any]] = {
    "envcal": envcal,
    "envcal, one core": envcal,
    "envcal to EXR": envcal_to_exr,
    "HDRutils": hdrutils,
    "colour-hdri": colour_hdri,
    "OpenCV Debevec": opencv,
}


def peak_bytes() -> int:
    """Return the largest memory this process has had, 0 where the system does not tell."""
    # Linux counts in getrusage what the process that started this one had; what it says of the address space does not.
    status = Path("/proc/self/status")
    if status.is_file():
        (line,) = [line for line in status.read_text(encoding="utf-8").splitlines() if line.startswith("VmHWM")]
        return int(line.split()[1]) * 1024
    try:
        import resource
    except ImportError:
        return 0
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(largest if sys.platform == "darwin" else largest * 1024)


def limit(name: str, gigabytes: float) -> None:
    """Bound the memory, and the cores, where the system can."""
    try:
        import resource
    except ImportError:
        return
    resource.setrlimit(resource.RLIMIT_AS, (int(gigabytes * 1e9),) * 2)
    if name.endswith("one core") and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def main(name: str, folder: Path, out: Path, gigabytes: float) -> None:
    limit(name, gigabytes)
    told = json.loads((folder / "told.json").read_text(encoding="utf-8"))
    way = WAYS[name]
    # Compilation and imports are paid once a machine and once a process; they are not what is compared.
    way(sorted((folder / "small").glob("*.dng")), told)
    before = peak_bytes()
    files = sorted(folder.glob("*.dng"))
    start, cpu = time.perf_counter(), time.process_time()
    image = way(files, told)
    seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
    print(json.dumps({"seconds": seconds, "cpu": cpu, "peak": peak_bytes(), "before": before}))
    np.save(out, image() if callable(image) else image)


if __name__ == "__main__":
    # The folder of this file, which Python puts first, has modules of the same names as packages.
    sys.path = [entry for entry in sys.path if Path(entry).resolve() != Path(__file__).resolve().parent]
    main(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), float(sys.argv[4]))
