"""Exposures, black and noise of a bracket from its pixels: one robust fit to a sample of its photosites.

A photosite i in frame k reads c = b + s + a_k x_i + noise: b the file's black, s a shift of it that all frames share, a_k
the light of the frame, x_i the radiance. All x_i are eliminated (Schur complement), the few that remain are solved by
Gauss–Newton with inverse-variance weights. That is the fit of maximum likelihood, so noise in the short frames does not
flatten the ratios as a regression of one frame on another would. What moves or flickers departs from the common ratios by
more than the noise and is weighted down by Tukey's biweight.

The residuals of the fit show the noise: their variance against the signal is the camera's photon transfer curve (Janesick
2007, "Photon Transfer", SPIE), here without flat fields, as each photosite is compared with itself.
"""

import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from calibrate.merge.records import Float64

Samples = npt.NDArray[np.uint16]
Indices = npt.NDArray[np.int64]

# Above this share of the range from black to clipping a sample is not asked: sensors bend there.
_LINEAR = 0.85

# Tukey's constant for 95 % efficiency.
_TUKEY = 4.685

# Nothing is concluded from fewer sites than this.
_FEWEST_SITES = 300

# Exposures may be off by 40 % (σ) where no sample speaks, black by 0.05 % of the range.
_PRIOR_LOG_LIGHT = 0.4
_PRIOR_BLACK = 5e-4

_BLOCKS = 64
_STEPS = (8, 4, 3)
_BINS = 28
_ROUNDING_VARIANCE = 1.0 / 12.0


@dataclass(frozen=True, slots=True, eq=False)
class Sites:
    """A regular sample of photosites: `counts` (M, N) raw counts, pattern `position` (M,), black `group` (M,), `tile` (M,)."""

    counts: Samples
    position: Indices
    group: Indices
    tile: Indices


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """Result of the fit.

    Attributes
    ----------
    log_light, light_error
        Shape (N,): natural logarithm of each frame's light over what was told, and its standard error, against the frame
        that is known best.
    black_shift, black_error
        Shape (groups,), raw counts.
    noise
        By class of ISO: (gain e-/DN, its relative error, read noise DN, its relative error); None where not measurable.
    spread
        Robust standard deviation of the residuals in units of what the noise model expects; 1 where all is understood.
    uneven
        Shape (N,): largest departure of one tile of a frame from its common ratio, beyond 5 standard errors.
    sites
        Sites that spoke.
    """

    log_light: Float64
    light_error: Float64
    black_shift: Float64
    black_error: Float64
    noise: tuple[tuple[float, float, float, float] | None, ...]
    spread: float
    uneven: Float64
    sites: int


def fit_jointly(
    sites: Sites,
    *,
    light: Float64,
    black: Float64,
    clip: Float64,
    gain: Float64,
    read_dn: Float64,
    iso_class: Indices,
    fixed: npt.NDArray[np.bool_],
    with_noise: bool,
) -> Joint:
    """Fit the exposures, a shift of black, and the noise of a bracket.

    Parameters
    ----------
    light
        Shape (N, P): told light by frame and position.
    black, clip
        Shape (N, P), raw counts.
    gain, read_dn
        Shape (N,): noise to start from: electrons a count, standard deviation of a dark sample in counts.
    iso_class
        Shape (N,): frames of the same class share one noise model.
    fixed
        Shape (N,): frames whose light is known.
    with_noise
        Fit the noise; otherwise it is believed.
    """
    frames = light.shape[0]
    groups = int(sites.group.max()) + 1 if len(sites.group) else 1
    log_light = _chain(sites, light, black, clip, read_dn)
    log_light[fixed] = 0.0
    shift = np.zeros(groups)
    read2 = np.maximum(read_dn, 0.5) ** 2
    gain = gain.copy()
    noise: list[tuple[float, float, float, float] | None] = [None] * (int(iso_class.max()) + 1)
    x = np.full(len(sites.position), np.nan)
    residual = np.empty(sites.counts.shape, np.float32)
    signal = np.empty(sites.counts.shape, np.float32)
    size = frames + groups
    span = float(np.mean(clip - black))
    prior = np.concatenate([np.where(fixed, 1e12, _PRIOR_LOG_LIGHT**-2), np.full(groups, (_PRIOR_BLACK * span) ** -2)])
    spread, used, hessian = 1e3, 0, np.diag(prior)
    for steps in _STEPS:
        for _ in range(steps):
            normal, gradient = np.zeros((_BLOCKS, size, size)), np.zeros((_BLOCKS, size))
            told = np.zeros(_BLOCKS, np.int64)
            _accumulate(
                sites.counts, sites.position, sites.group, light * np.exp(log_light)[:, None], black, clip, shift,
                gain, read2, x, spread, normal, gradient, told, residual, signal,
            )  # fmt: skip
            used = int(told.sum())
            seen = np.isfinite(residual)
            if used < _FEWEST_SITES or not seen.any():
                return _nothing(frames, groups, len(noise), used)
            spread = max(1.4826 * float(np.median(np.abs(residual[seen]))), 0.3)
            bare = normal.sum(axis=0)
            reference = int(np.argmax(np.where(fixed, np.inf, np.diag(bare)[:frames])))
            hessian = bare + np.diag(prior)
            hessian[reference, reference] += 1e12
            # The priors pull towards what was told.
            pull = gradient.sum(axis=0) - prior * np.concatenate([log_light, shift])
            pull[reference] = 0.0
            step = np.linalg.solve(hessian, pull)
            log_light += np.where(fixed, 0.0, np.clip(step[:frames], -0.5, 0.5))
            log_light -= 0.0 if fixed.any() else log_light[reference]
            shift += step[frames:]
            if np.abs(step[:frames]).max() < 2e-5 and np.abs(step[frames:]).max() < 2e-3:
                break
        if not with_noise:
            break
        for c in range(len(noise)):
            of = np.flatnonzero(iso_class == c)
            noise[c] = found = _transfer(residual[:, of], signal[:, of], read2[of[0]], gain[of[0]])
            if found is not None:
                gain[of], read2[of] = found[0], found[2] ** 2
    error = np.sqrt(np.diag(np.linalg.inv(hessian))) * max(spread, 1.0)
    uneven = _uneven(sites, residual, signal, gain, read2)
    return Joint(
        log_light, error[:frames], shift, error[frames:], tuple(noise), spread, uneven, used
    )  # fmt: skip


def _nothing(frames: int, groups: int, classes: int, used: int) -> Joint:
    unknown = np.full(frames, np.inf)
    return Joint(
        np.zeros(frames), unknown, np.zeros(groups), np.full(groups, np.inf), (None,) * classes, np.inf, np.zeros(frames), used
    )  # fmt: skip


def _chain(sites: Sites, light: Float64, black: Float64, clip: Float64, read_dn: Float64) -> Float64:
    """Return first guesses of the logarithms: medians of ratios between neighbours, from the longest down."""
    frames = light.shape[0]
    out = np.zeros(frames)
    order = np.argsort(light.mean(axis=1), kind="stable")[::-1]
    for longer, shorter in itertools.pairwise(order):
        high = sites.counts[:, longer] - black[longer][sites.position]
        low = sites.counts[:, shorter] - black[shorter][sites.position]
        top = _LINEAR * (clip - black)
        good = (low > 12.0 * max(read_dn[shorter], 1.0)) & (high < top[longer][sites.position])
        good &= low < top[shorter][sites.position]
        out[shorter] = out[longer]
        if good.sum() >= 100:
            told = (light[longer] / light[shorter])[sites.position[good]]
            change = float(np.log(np.median(high[good] / low[good] / told)))
            if abs(change) < 2.0:
                out[shorter] = out[longer] - change
    return out


def _transfer(
    residual: npt.NDArray[np.float32], signal: npt.NDArray[np.float32], read2: float, gain: float
) -> tuple[float, float, float, float] | None:
    """Return gain and read noise from residuals in units of the model's σ, by bins of the signal."""
    seen = np.isfinite(residual)
    s = np.maximum(signal[seen].astype(np.float64), 0.0)
    squares = residual[seen].astype(np.float64) ** 2 * (read2 + s / gain)
    edges = np.concatenate([[0.0], np.geomspace(2.0, max(float(s.max(initial=0.0)), 4.0), _BINS)])
    which = np.digitize(s, edges[1:-1])
    rows = []
    for k in range(_BINS):
        inside = which == k
        count = int(inside.sum())
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


def _uneven(
    sites: Sites,
    residual: npt.NDArray[np.float32],
    signal: npt.NDArray[np.float32],
    gain: Float64,
    read2: Float64,
) -> Float64:
    """Return by frame the largest departure of a tile, as a share of the light, that is beyond 5 standard errors."""
    out = np.zeros(residual.shape[1])
    for k in range(residual.shape[1]):
        s = signal[:, k].astype(np.float64)
        sigma = np.sqrt(read2[k] + np.maximum(s, 0.0) / gain[k])
        bright = np.isfinite(residual[:, k]) & (s > 10.0 * sigma)
        if not bright.any():
            continue
        relative = residual[bright, k] * sigma[bright] / s[bright]
        tile = sites.tile[bright]
        order = np.argsort(tile, kind="stable")
        for part in np.split(relative[order], np.flatnonzero(np.diff(tile[order])) + 1):
            if len(part) >= 60:
                middle = float(np.median(part))
                error = 1.2533 * 1.4826 * float(np.median(np.abs(part - middle))) / len(part) ** 0.5
                if abs(middle) > 5.0 * error:
                    out[k] = max(out[k], abs(middle))
    return out


@njit(cache=True, parallel=True, error_model="numpy")
def _accumulate(  # noqa: PLR0912, PLR0915 - one pass over the frames of a site
    counts: Samples,
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
            if np.isnan(x[i]):
                for k in range(frames):
                    if counts[i, k] < black[k, p] + _LINEAR * (clip[k, p] - black[k, p]):
                        above += light[k, p] * (counts[i, k] - black[k, p] - shift[g])
                        below += light[k, p] * light[k, p]
                x[i] = above / below if below > 0 else 0.0
            valid = 0
            above, below = 0.0, 0.0
            for k in range(frames):
                a[k] = light[k, p]
                d[k] = counts[i, k] - black[k, p] - shift[g]
                s = a[k] * x[i]
                residual[i, k] = np.nan
                signal[i, k] = s
                w[k] = 0.0
                if s < _LINEAR * (clip[k, p] - black[k, p]) and counts[i, k] < clip[k, p]:
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
