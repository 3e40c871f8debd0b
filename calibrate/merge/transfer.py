"""Gain and read noise from the residuals of a fit: the photon transfer curve (Janesick 2007, "Photon Transfer", SPIE)."""

import itertools

import numpy as np
import numpy.typing as npt

_BINS = 28
_ROUNDING_VARIANCE = 1.0 / 12.0


def photon_transfer(
    residual: npt.NDArray[np.float32], signal: npt.NDArray[np.float32], read2: float, gain: float
) -> tuple[float, float, float, float] | None:
    """Return gain and read noise from residuals in units of the model's σ, by bins of the signal."""
    seen = np.isfinite(residual)
    s = np.maximum(signal[seen].astype(np.float64), 0.0)
    squares = residual[seen].astype(np.float64) ** 2 * (read2 + s / gain)
    edges = np.concatenate([[0.0], np.geomspace(2.0, max(float(s.max(initial=0.0)), 4.0), _BINS)])
    which = np.digitize(s, edges[1:-1]).astype(np.uint8)
    order = np.argsort(which, kind="stable")
    s, squares = s[order], squares[order]
    rows = []
    for inside in itertools.starmap(slice, itertools.pairwise(np.searchsorted(which[order], np.arange(_BINS + 1)))):
        count = inside.stop - inside.start
        if count >= 60:
            # The median of χ² with one degree of freedom is 0.4549.
            rows.append((float(s[inside].mean()), float(np.median(squares[inside])) / 0.45494, count))
    if len(rows) < 4:
        return None
    level, variance, count = np.array(rows).T
    estimate = np.array([read2, 1.0 / gain])
    covariance = np.eye(2)
    for _ in range(4):
        expected = np.maximum(estimate[0] + level * estimate[1], 1e-3)
        # The median of squares knows a variance to √(2.7 · 2/n); the bins' own errors are 2 % at best.
        weight = 1.0 / (expected**2 * (5.4 / count + 4e-4))
        design = np.stack([np.ones_like(level), level], axis=1)
        covariance = np.linalg.inv(design.T @ (weight[:, None] * design))
        estimate = covariance @ (design.T @ (weight * variance))
        estimate = np.maximum(estimate, [_ROUNDING_VARIANCE, 1e-9])
    read, slope = estimate
    errors = np.sqrt(np.diag(covariance))
    return 1.0 / slope, float(errors[1] / slope), float(np.sqrt(read)), float(0.5 * errors[0] / read)
