"""`python -m samples` makes the files of samples/capture again; `--truth DIR` writes what is true of them."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from samples import make_capture, write_capture, write_truth

SHIPPED = Path(__file__).parent / "capture"


def main(arguments: list[str] | None = None) -> int:
    """Write the shipped capture, or its truth; return 0."""
    parser = argparse.ArgumentParser(prog="python -m samples", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=SHIPPED, help="folder of the DNG files")
    parser.add_argument("--uncompressed", action="store_true", help="plain DNG (needs no imagecodecs)")
    parser.add_argument("--truth", type=Path, metavar="DIR", help="write DIR/truth.npz instead of the DNG files")
    parser.add_argument("--spectral", action="store_true", help="with --truth: the spectral cube too (270 MB)")
    chosen = parser.parse_args(arguments)
    capture = make_capture()
    if chosen.truth is not None:
        print(write_truth(chosen.truth, capture.truth(spectral=chosen.spectral)))
        return 0
    for path in write_capture(chosen.output, capture, compressed=not chosen.uncompressed):
        print(f"{path}  {path.stat().st_size / 1e6:.2f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
