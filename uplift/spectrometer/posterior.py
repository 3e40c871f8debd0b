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
#: The evidence is taken to this power: the model's errors are larger and more alike than the Gaussians say. Found by
#: making the probabilities of the families true over lamps that the prior does not know (docs/spectrometer.md).
TEMPER = 0.5
#: And the probabilities of the families to this one: the least log loss over 3200 readings of 320 lamps (0.31; 0.36 at 1),
#: chosen on those same readings.
FAMILY_TEMPER = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """`light` [N], non-negative, in the unit of A, and its `covariance` [N, N]; `weights` [K] of the Gaussians; `families`
    [5], the probability of each; `freedom`, how many numbers the reading determined; `log_evidence`, tempered as the weights
    are, but for a constant of the reading.
    """

    light: Floats
    covariance: Floats
    weights: Floats
    families: Floats
    freedom: float
    log_evidence: float


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
    evidence = prior.log_share - TEMPER * (0.5 * (r**2).sum(axis=1) + determinants)
    weights = np.exp(evidence - evidence.max())
    total = float(evidence.max() + np.log(weights.sum()) - TEMPER * np.log(np.diag(noise_root)).sum())
    weights /= weights.sum()
    shares: Floats = np.bincount(prior.family, weights, len(FAMILIES)).astype(np.float64) ** FAMILY_TEMPER
    families: Floats = shares / shares.sum()
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
    return Posterior(np.maximum(light, 0.0), spread, weights, families, freedom, total)


def _non_negative(y: Floats, B: Floats, mean: Floats, root: Floats) -> Floats:
    from scipy.optimize import nnls

    solution: Floats = nnls(np.concatenate([B, root]), np.concatenate([y, root @ mean]), maxiter=20 * mean.size)[0]
    return solution
