"""The normal equations of the joint fit: one compiled pass over the sampled photosites."""

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from calibrate.merge.records import Counts, Float64

Indices = npt.NDArray[np.int64]

# Above this share of the range from black to clipping a sample is not asked: sensors bend there.
LINEAR = 0.85

# Tukey's constant for 95 % efficiency.
_TUKEY = 4.685


@njit(cache=True, parallel=True, error_model="numpy")
def accumulate(  # noqa: PLR0912, PLR0915 - one pass over the frames of a site
    counts: Counts,
    position: Indices,
    group: Indices,
    light: Float64,
    black: Float64,
    clip: Float64,
    shift: Float64,
    gain: Float64,
    read2: Float64,
    x: Float64,
    spread: float,
    normal: Float64,
    gradient: Float64,
    told: Indices,
    residual: npt.NDArray[np.float32],
    signal: npt.NDArray[np.float32],
) -> None:  # pragma: no cover - compiled
    """Add the normal equations of every site, in fixed blocks of sites, so that threads change no bit."""
    sites, frames = counts.shape
    blocks = normal.shape[0]
    for block in prange(blocks):
        w, d, a, u = np.empty(frames), np.empty(frames), np.empty(frames), np.empty(frames)
        for i in range(sites * block // blocks, sites * (block + 1) // blocks):
            p, g = position[i], group[i]
            above, below = 0.0, 0.0
            fresh = np.isnan(x[i])
            if fresh:
                for k in range(frames):
                    if counts[i, k] < black[k, p] + LINEAR * (clip[k, p] - black[k, p]):
                        above += light[k, p] * (counts[i, k] - black[k, p] - shift[g])
                        below += light[k, p] * light[k, p]
                x[i] = above / below if below > 0 else 0.0
            valid = 0
            # A first guess is settled before anything is concluded from it.
            for _ in range(3 if fresh else 1):
                valid = 0
                above, below = 0.0, 0.0
                for k in range(frames):
                    a[k] = light[k, p]
                    d[k] = counts[i, k] - black[k, p] - shift[g]
                    s = a[k] * x[i]
                    residual[i, k] = np.nan
                    signal[i, k] = s
                    w[k] = 0.0
                    if s < LINEAR * (clip[k, p] - black[k, p]) and counts[i, k] < clip[k, p]:
                        w[k] = 1.0 / (read2[k] + max(s, 0.0) / gain[k])
                        above += w[k] * a[k] * d[k]
                        below += w[k] * a[k] * a[k]
                        valid += 1
                if below > 0.0:
                    x[i] = above / below
            if valid < 2:
                continue
            robust = 0.0
            above = 0.0
            for k in range(frames):
                if w[k] > 0.0:
                    rest = 1.0 - w[k] * a[k] * a[k] / below
                    r = (d[k] - a[k] * x[i]) * np.sqrt(w[k] / max(rest, 1e-12))
                    if rest > 0.02:
                        residual[i, k] = r
                    z = r / (_TUKEY * spread)
                    w[k] = w[k] * (1.0 - z * z) ** 2 if abs(z) < 1.0 else 0.0
                    robust += w[k] * a[k] * a[k]
                    above += w[k] * a[k] * d[k]
            if robust <= 0.0:
                continue
            told[block] += 1
            best = above / robust
            sum_wa = 0.0
            sum_w = 0.0
            sum_r = 0.0
            for k in range(frames):
                u[k] = w[k] * a[k] * a[k] * best
                r = d[k] - a[k] * best
                gradient[block, k] += w[k] * a[k] * best * r
                normal[block, k, k] += u[k] * best
                cross = w[k] * a[k] * best
                normal[block, k, frames + g] += cross
                normal[block, frames + g, k] += cross
                sum_wa += w[k] * a[k]
                sum_w += w[k]
                sum_r += w[k] * r
            gradient[block, frames + g] += sum_r
            normal[block, frames + g, frames + g] += sum_w - sum_wa * sum_wa / robust
            for k in range(frames):
                normal[block, k, frames + g] -= u[k] * sum_wa / robust
                normal[block, frames + g, k] -= u[k] * sum_wa / robust
                for j in range(frames):
                    normal[block, k, j] -= u[k] * u[j] / robust
