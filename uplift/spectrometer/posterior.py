"""The light that a reading tells of: posterior of a mixture of Gaussians, non-negative.

For one Gaussian N(μ, C) the estimate is the Wiener filter μ + C Aᵀ (A C Aᵀ + N)⁻¹ (m − A μ) (e.g. H. Haneishi et al., "System
design for accurately estimating the spectral reflectance of art paintings", Appl. Opt. 39, 2000, for reflectances). Here each
Gaussian of the prior gives its own, weighted by its evidence N(m; A μ, A C Aᵀ + N). Light is not negative: of each Gaussian
that counts, the most probable *non-negative* spectrum is taken (non-negative least squares, C. Lawson and R. Hanson 1974),
instead of clipping, which changes what the patches would read.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uplift.spectrometer.lamps import FAMILIES
from uplift.spectrometer.prior import Prior

Floats = npt.NDArray[np.float64]

#: Gaussians with less of the posterior are left out of the non-negative solution.
LEAST_WEIGHT = 0.02
#: The evidence is taken to this power: the model's errors are larger and more alike than the Gaussians say.
TEMPER = 0.5
#: To this one where the family is asked, and LEDs are then so much likelier than their share of the prior, as most lamps are
#: LEDs by now. The least log loss of 3820 readings of lamps that the prior does not know at which every family is right as often
#: as asked; what such a choice is worth was measured on lamps that it had not seen (docs/spectrometer.md).
FAMILY_TEMPER, LED_LIKELIER = 0.25, 4 / 3


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """`light` [N], non-negative, in the unit of A, and its `covariance` [N, N]; `families` [5], the probability of each.

    `freedom`: how many numbers the reading determined; `log_evidence`, tempered as the mixture is, but for a constant of the
    reading; `misfit` [K]: -log evidence of each Gaussian but for such a constant.
    """

    light: Floats
    covariance: Floats
    families: Floats
    freedom: float
    log_evidence: float
    misfit: Floats


def posterior(m: Floats, A: Floats, covariance: Floats, prior: Prior, *, positive: bool = True) -> Posterior:
    """Return the light E [N] of m [72] = A [72, N] @ E + errors of `covariance` [72, 72]."""
    from scipy.linalg import solve_triangular

    noise_root = np.linalg.cholesky(covariance)
    white = solve_triangular(noise_root, np.column_stack([m, A]), lower=True)  # whitened: errors are unit
    y, B = white[:, 0], white[:, 1:]
    scale = m.mean() / (prior.means @ A.mean(axis=0))
    n = prior.means.shape[1]
    means = scale[:, np.newaxis] * prior.means
    CB = (scale**2)[:, np.newaxis, np.newaxis] * (prior.covariances @ B.T)  # [K, N, 72]
    L = np.linalg.cholesky(B @ CB + np.eye(y.size))
    off = y - means @ B.T
    r = np.stack([solve_triangular(L[k], off[k], lower=True) for k in range(len(L))])
    determinants = np.log(np.diagonal(L, axis1=1, axis2=2)).sum(axis=1)
    misfit = 0.5 * (r**2).sum(axis=1) + determinants
    evidence = prior.log_share - TEMPER * misfit
    weights = np.exp(evidence - evidence.max())
    total = float(evidence.max() + np.log(weights.sum()) - TEMPER * np.log(np.diag(noise_root)).sum())
    weights /= weights.sum()
    families = family_probabilities(misfit, prior, FAMILY_TEMPER, LED_LIKELIER)
    used = np.flatnonzero(weights >= min(LEAST_WEIGHT, weights.max()))
    part = weights[used] / weights[used].sum()
    estimates, spread, freedom = np.empty((used.size, n)), np.zeros((n, n)), 0.0
    for i, k in enumerate(used.tolist()):
        inverse = solve_triangular(L[k], np.eye(y.size), lower=True)
        gain = inverse @ CB[k].T
        estimates[i] = means[k] + gain.T @ r[k]
        if positive:
            estimates[i] = _non_negative(y, B, means[k], prior.roots[k] / scale[k])
        spread += part[i] * (scale[k] ** 2 * prior.covariances[k] - gain.T @ gain)
        freedom += part[i] * (y.size - float((inverse**2).sum()))
    light = part @ estimates
    apart = estimates - light
    spread += (part[:, np.newaxis] * apart).T @ apart
    return Posterior(np.maximum(light, 0.0), spread, families, freedom, total, misfit)


def family_probabilities(misfit: Floats, prior: Prior, temper: float, led_likelier: float) -> Floats:
    """Return the probability of each family [5] by the misfits [K] of the Gaussians, at this power and weight of LEDs."""
    evidence = prior.log_share - temper * misfit
    likelier = np.where(prior.family == FAMILIES.index("led"), led_likelier, 1.0)
    shares = np.bincount(prior.family, likelier * np.exp(evidence - evidence.max()), len(FAMILIES))
    return np.asarray(shares / shares.sum(), np.float64)


def _non_negative(y: Floats, B: Floats, mean: Floats, root: Floats) -> Floats:
    from scipy.optimize import nnls

    solution: Floats = nnls(np.concatenate([B, root]), np.concatenate([y, root @ mean]), maxiter=20 * mean.size)[0]
    return solution
