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


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """`light` [N], non-negative, in the unit of A, and its `covariance` [N, N]; `weights` [K] of the Gaussians; `families`
    [5], the probability of each; `freedom`, how many numbers the reading determined.
    """

    light: Floats
    covariance: Floats
    weights: Floats
    families: Floats
    freedom: float


def posterior(m: Floats, A: Floats, covariance: Floats, prior: Prior, *, positive: bool = True) -> Posterior:
    """Return the light E [N] of m [72] = A [72, N] @ E + errors of `covariance` [72, 72]."""
    noise_root = np.linalg.cholesky(covariance)
    y, B = np.linalg.solve(noise_root, m), np.linalg.solve(noise_root, A)  # whitened: errors are unit
    scale = m.mean() / (prior.means @ A.mean(axis=0))
    count, n = prior.means.shape
    evidence = np.empty(count)
    estimates, freedoms = np.empty((count, n)), np.empty(count)
    gains: list[Floats] = []
    for k in range(count):
        mean, C = scale[k] * prior.means[k], scale[k] ** 2 * prior.covariances[k]
        CB = C @ B.T
        G = B @ CB + np.eye(y.size)
        L = np.linalg.cholesky(G)
        r = np.linalg.solve(L, y - B @ mean)
        gain = np.linalg.solve(L, CB.T)
        evidence[k] = prior.log_share[k] - TEMPER * (0.5 * r @ r + np.log(np.diag(L)).sum())
        estimates[k] = mean + gain.T @ r
        gains.append(gain)
        freedoms[k] = y.size - (np.linalg.inv(L) ** 2).sum()
    weights = np.exp(evidence - evidence.max())
    weights /= weights.sum()
    families = np.bincount(prior.family, weights, len(FAMILIES)).astype(np.float64)
    used = np.where(weights >= min(LEAST_WEIGHT, weights.max()), weights, 0.0)
    used /= used.sum()
    if positive:
        for k in np.flatnonzero(used).tolist():
            estimates[k] = _non_negative(y, B, scale[k] * prior.means[k], prior.roots[k] / scale[k])
    light = used @ estimates
    spread = np.zeros((n, n))
    for k in np.flatnonzero(used).tolist():
        off = estimates[k] - light
        spread += used[k] * (scale[k] ** 2 * prior.covariances[k] - gains[k].T @ gains[k] + np.outer(off, off))
    return Posterior(np.maximum(light, 0.0), spread, weights, families, float(used @ freedoms))


def _non_negative(y: Floats, B: Floats, mean: Floats, root: Floats) -> Floats:
    from scipy.optimize import nnls

    solution: Floats = nnls(np.concatenate([B, root]), np.concatenate([y, root @ mean]), maxiter=20 * mean.size)[0]
    return solution
