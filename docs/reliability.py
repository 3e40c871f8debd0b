"""Make docs/images/reliability.png of the families that the chart tells.

`python docs/reliability.py FILE…` takes what `python -m benchmarks spectrometer --only kinds --json FILE` wrote, and for unknown cameras
that of `--only kinds-unknown`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path


def main(files: list[Path], picture: Path) -> None:
    """Plot how often the most probable family was right over how probable it was said to be."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    found = {key: value for file in files for key, value in json.loads(file.read_text(encoding="utf-8")).items()}
    figure, axes = plt.subplots(figsize=(4.2, 4.0), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    for key, label in (("kinds_known", "camera known"), ("kinds_unknown", "camera unknown")):
        if key in found:
            said, right, count = zip(*found[key]["reliability"], strict=True)
            error = [2 * (r * (1 - r) / n) ** 0.5 for r, n in zip(right, count, strict=True)]
            axes.errorbar(said, right, error, fmt="o-", capsize=2, markersize=4, label=label)
    axes.set(xlim=(0.2, 1.02), ylim=(0.2, 1.02), xlabel="probability said", ylabel="share that was right")
    axes.legend(frameon=False, loc="lower right")
    figure.savefig(picture, dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]], Path(__file__).parent / "images" / "reliability.png")
