"""Which patches glare and dirt have spoilt: those that a fit of the others misses by far."""

from typing import Final

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.correct.model import ChartFit
from calibrate.difference import delta_e_2000, lab_from_xyz

# A patch is spoilt if the fit of the others misses it by so many times the median, by at least so much (CIEDE2000), and in
# its luminance by this factor. Glare and shadow change how bright a patch is; a matrix that does not suit a pigment under
# a warm light misses its hue.
_OUTLIER_FACTOR: Final = 4.0
_OUTLIER_DELTA_E: Final = 8.0
_OUTLIER_LUMINANCE: Final = 1.25
_MOST_OUTLIERS: Final = 6  # one patch in so many
# So many are tried, those that are missed most: of 140 patches none draws the fit to itself.
_MOST_TRIED: Final = 24


def spoilt_patches(problem: ChartFit, names: tuple[str, ...]) -> npt.NDArray[np.bool_]:
    """Mark the patches [N] that a fit of the others misses by far, one after the other, the worst first.

    The worst is not the one that is missed most: a bright spoilt patch draws the fit to itself, and the others stand out. It
    is the one without which the others agree best, of those that are missed most: of a Classic of all, of 140 one in six.
    """
    left_out = np.zeros(len(names), dtype=np.bool_)
    lab = lab_from_xyz(problem.target)
    while True:
        best, worst, missed, median, luminance = np.inf, 0, 0.0, 0.0, 1.0
        matrix, light = problem.solved(~left_out)
        misses = delta_e_2000(lab_from_xyz(problem.terms / light[:, None] @ matrix.T), lab)
        free = np.flatnonzero(~left_out & ~problem.held)
        for index in np.sort(free[np.argsort(-misses[free], kind="stable")[:_MOST_TRIED]]):
            without = ~left_out & (np.arange(len(names)) != index)
            matrix, light = problem.solved(without)
            fitted = problem.terms / light[:, None] @ matrix.T
            delta_e = delta_e_2000(lab_from_xyz(fitted), lab)
            if delta_e[without].mean() < best:
                best, worst = float(delta_e[without].mean()), int(index)
                missed, median = float(delta_e[index]), float(np.median(delta_e[without]))
                luminance = float(max(fitted[index, 1], 1e-6) / problem.target[index, 1])
        changed = max(luminance, 1 / luminance)
        if missed < max(_OUTLIER_DELTA_E, _OUTLIER_FACTOR * median) or changed < _OUTLIER_LUMINANCE:
            return left_out
        left_out[worst] = True
        if left_out.sum() > len(names) // _MOST_OUTLIERS:
            raise CalibrateError(
                f"correct.chart: {left_out.sum()} patches ({_named(left_out, names)}) differ by far from what the others "
                f"predict; at most {len(names) // _MOST_OUTLIERS} may. Something covers the chart, it is lit by two lights, it shines, or the "
                "edition is another one (`correct.reference`). Photograph it again, turned away from the lamps, or give its corners."
            )


def spoilt_warnings(left_out: npt.NDArray[np.bool_], names: tuple[str, ...]) -> tuple[str, ...]:
    """Return what to say of the patches that were left out."""
    if not left_out.any():
        return ()
    return (
        f"correct.chart: left out of the fit: {_named(left_out, names)}; the other patches predict another colour there. "
        "Glare, dirt or a shadow: turn the chart away from the lamps, or clean it.",
    )


def _named(chosen: npt.NDArray[np.bool_], names: tuple[str, ...]) -> str:
    return ", ".join(name for name, own in zip(names, chosen, strict=True) if own)
