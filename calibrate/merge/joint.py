"""Exposures, black and noise of a bracket from its pixels: one robust fit to a sample of its photosites.

A photosite i in frame k reads c = b + s + a_k x_i + noise: b the file's black, s a shift of it that all frames share, a_k
the light of the frame, x_i the radiance. All x_i are eliminated (Schur complement), the few that remain are solved by
Gauss–Newton with inverse-variance weights. That is the fit of maximum likelihood, so noise in the short frames does not
flatten the ratios as a regression of one frame on another would. What moves or flickers departs from the common ratios by
more than the noise and is weighted down by Tukey's biweight.

The residuals of the fit show the noise: their variance against the signal is the camera's photon transfer curve (Janesick
2007, "Photon Transfer", SPIE), here without flat fields, as each photosite is compared with itself.
"""

import dataclasses
import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calibrate.merge.normal import LINEAR, Indices, accumulate
from calibrate.merge.records import Counts, Float64
from calibrate.merge.transfer import photon_transfer

# Nothing is concluded from fewer sites than this.
_FEWEST_SITES = 300

# Exposures may be off by 40 % (σ) where no sample speaks, black by 0.05 % of the range.
_PRIOR_LOG_LIGHT = 0.4
_PRIOR_BLACK = 5e-4

_BLOCKS = 64

# The first steps, from what was told to nearly the truth, ask one site of so many if that leaves a good number.
_COARSE, _MANY_SITES = 8, 16_000
_STEPS = (8, 8, 4)

# A step smaller than the first share of the standard error is the last, and one that takes back some of the one before and is
# smaller than the second. What counts as the error is at least this (logarithm of light, counts).
_CLOSE, _SEE_SAW, _SMALLEST_LIGHT, _SMALLEST_BLACK = 0.05, 0.5, 2e-5, 2e-3


@dataclass(frozen=True, slots=True, eq=False)
class Sites:
    """A regular sample of photosites: `counts` (M, N) raw counts, pattern `position` (M,), black `group` (M,), `tile` (M,)."""

    counts: Counts
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
    read2 = np.maximum(read_dn, 0.5) ** 2
    gain = gain.copy()
    noise: list[tuple[float, float, float, float] | None] = [None] * (int(iso_class.max()) + 1)
    told = np.concatenate([_chain(sites, light, black, clip, read_dn), np.zeros(groups)])
    told[:frames][fixed] = 0.0
    span = float(np.mean(clip - black))
    prior = np.concatenate([np.where(fixed, 1e12, _PRIOR_LOG_LIGHT**-2), np.full(groups, (_PRIOR_BLACK * span) ** -2)])
    fit = _Fit(told, np.diag(prior), np.empty((0, frames), np.float32), np.empty((0, frames), np.float32), 1e3, 0)
    some = _few(sites)
    x = np.full(len(sites.position), np.nan)
    for part, steps in zip((some, sites, sites), _STEPS, strict=True):
        of_sites = x if part is sites else np.full(len(part.position), np.nan)
        fit = _descend(part, of_sites, fit, steps, light, black, clip, gain, read2, prior, fixed)
        if fit.used < _FEWEST_SITES or not np.isfinite(fit.spread):
            if part is sites:
                return _nothing(frames, groups, len(noise), fit.used)
            fit = dataclasses.replace(fit, unknowns=told, spread=1e3)
            continue
        if not with_noise:
            if part is sites:
                break
            continue
        for c in range(len(noise)):
            of = np.flatnonzero(iso_class == c)
            noise[c] = found = photon_transfer(fit.residual[:, of], fit.signal[:, of], read2[of[0]], gain[of[0]])
            if found is not None:
                gain[of], read2[of] = found[0], found[2] ** 2
    error = np.sqrt(np.diag(np.linalg.inv(fit.hessian))) * max(fit.spread, 1.0)
    uneven = _uneven(sites, fit.residual, fit.signal, gain, read2)
    log_light, shift = fit.unknowns[:frames], fit.unknowns[frames:]
    return Joint(
        log_light, error[:frames], shift, error[frames:], tuple(noise), fit.spread, uneven, fit.used
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Where the fit stands: logarithms of the lights and shifts of black, their normal matrix, residuals and signals by site."""

    unknowns: Float64
    hessian: Float64
    residual: npt.NDArray[np.float32]
    signal: npt.NDArray[np.float32]
    spread: float
    used: int


def _few(sites: Sites) -> Sites:
    """Return some of the sites, drawn by a fixed seed, if they are many."""
    if len(sites.position) < _MANY_SITES:
        return sites
    some = np.random.default_rng(0).permutation(len(sites.position))[::_COARSE]
    some.sort()
    return Sites(sites.counts[some], sites.position[some], sites.group[some], sites.tile[some])


def _descend(
    sites: Sites, x: Float64, fit: _Fit, steps: int, light: Float64, black: Float64, clip: Float64, gain: Float64,
    read2: Float64, prior: Float64, fixed: npt.NDArray[np.bool_],
) -> _Fit:  # fmt: skip
    """Take so many steps of Gauss and Newton; the radiances `x` of the sites are kept in place."""
    frames, size = light.shape[0], len(prior)
    residual, signal = np.empty(sites.counts.shape, np.float32), np.empty(sites.counts.shape, np.float32)
    smallest = np.concatenate([np.full(frames, _SMALLEST_LIGHT), np.full(size - frames, _SMALLEST_BLACK)])
    last = np.zeros(size)
    unknowns, spread, used, hessian = fit.unknowns.copy(), fit.spread, 0, fit.hessian
    for _ in range(steps):
        normal, gradient = np.zeros((_BLOCKS, size, size)), np.zeros((_BLOCKS, size))
        told = np.zeros(_BLOCKS, np.int64)
        accumulate(
            sites.counts, sites.position, sites.group, light * np.exp(unknowns[:frames])[:, None], black, clip,
            unknowns[frames:], gain, read2, x, spread, normal, gradient, told, residual, signal,
        )  # fmt: skip
        used = int(told.sum())
        seen = np.isfinite(residual)
        if used < _FEWEST_SITES or not seen.any():
            return dataclasses.replace(fit, spread=np.inf, used=used)
        spread = max(1.4826 * float(np.median(np.abs(residual[seen]))), 0.3)
        bare = normal.sum(axis=0)
        reference = int(np.argmax(np.where(fixed, np.inf, np.diag(bare)[:frames])))
        hessian = bare + np.diag(prior)
        hessian[reference, reference] += 1e12
        # The priors pull towards what was told.
        pull = gradient.sum(axis=0) - prior * unknowns
        pull[reference] = 0.0
        step = np.linalg.solve(hessian, pull)
        error = np.maximum(np.sqrt(np.diag(np.linalg.inv(hessian))), smallest)
        # Samples near the limit come and go with the radiance that they shape: steps end in a see-saw around the solution, and
        # half of one ends in it.
        back = bool(step @ (np.diag(bare) * last) < 0) and bool(np.all(np.abs(step) < _SEE_SAW * error))
        step *= 0.5 if back else 1.0
        last = step
        unknowns[:frames] += np.where(fixed, 0.0, np.clip(step[:frames], -0.5, 0.5))
        unknowns[:frames] -= 0.0 if fixed.any() else unknowns[reference]
        unknowns[frames:] += step[frames:]
        if back or np.all(np.abs(step) < _CLOSE * error):
            break
    return _Fit(unknowns, hessian, residual, signal, spread, used)


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
        top = LINEAR * (clip - black)
        good = (low > 12.0 * max(read_dn[shorter], 1.0)) & (high < top[longer][sites.position])
        good &= low < top[shorter][sites.position]
        out[shorter] = out[longer]
        if good.sum() >= 100:
            told = (light[longer] / light[shorter])[sites.position[good]]
            change = float(np.log(np.median(high[good] / low[good] / told)))
            if abs(change) < 2.0:
                out[shorter] = out[longer] - change
    return out


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
        # Few bits are sorted the faster.
        tile = sites.tile[bright].astype(np.uint8)
        order = np.argsort(tile, kind="stable")
        for part in np.split(relative[order], np.flatnonzero(np.diff(tile[order])) + 1):
            if len(part) >= 60:
                middle = _middle(part)
                error = 1.2533 * 1.4826 * _middle(np.abs(part - middle)) / len(part) ** 0.5
                if abs(middle) > 5.0 * error:
                    out[k] = max(out[k], abs(middle))
    return out


def _middle(values: Float64) -> float:
    """Return the median, of an even number the upper one: a fifth of the time of numpy's on a few hundred."""
    return float(np.partition(values, len(values) // 2)[len(values) // 2])
