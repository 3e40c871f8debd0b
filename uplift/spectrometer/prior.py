"""What is known of a lamp before it is measured: a mixture of Gaussians, several to each family.

One Gaussian over all lamps makes a mean of what is either an LED or a tube; one to each family still takes a bulb of
2000 K and one of 3400 K for a cloud instead of a line. So the lamps of each family are parted by k-means into groups of
like shape, and each group gives one Gaussian: its mean and covariance, with a little of every wavelength's own variance
added so that no spectrum is impossible. The evidence of a family is the sum over its groups.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from uplift.spectrometer.lamps import FAMILIES, lamps
from uplift.spectrum import Observer

Floats = npt.NDArray[np.float64]

#: Groups of each family.
GROUPS = {"led": 14, "fluorescent": 10, "incandescent": 4, "daylight": 5, "discharge": 6}
#: How likely each family is where nothing is known.
SHARE = {"led": 0.30, "fluorescent": 0.20, "incandescent": 0.20, "daylight": 0.20, "discharge": 0.10}
#: A measured lamp counts as many modelled ones.
PUBLISHED_COUNTS = 3.0
#: Own variance of every wavelength: as a part of the group's mean variance, and of its squared mean radiance.
OWN_OF_VARIANCE, OWN_OF_LIGHT = 0.003, 2e-5
#: Shapes are compared at this resolution, so that a line a sample off is no other lamp.
RESOLUTION_NM = 18.0


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """A mixture of K Gaussians over spectra of Y = 1.

    `means` [K, N], `covariances` [K, N, N], `roots` [K, N, N] with roots.T @ roots the inverse of the covariance, `log_share`
    [K], `family` [K] the index into `FAMILIES`.
    """

    means: Floats
    covariances: Floats
    roots: Floats
    log_share: Floats
    family: npt.NDArray[np.int64]


@cache
def prior_of(observer: Observer, left_out: frozenset[str] = frozenset()) -> Prior:
    """Return the prior on the observer's grid; `left_out` names published lamps it shall not know."""
    means, covariances, roots, shares, families = [], [], [], [], []
    for number, family in enumerate(lamps(observer, left_out)):
        weights = np.where(np.arange(len(family.emissions)) < family.published, PUBLISHED_COUNTS, 1.0)
        group = _groups(family.emissions, GROUPS[family.family], observer)
        for k in range(group.max() + 1):
            own, w = family.emissions[group == k], weights[group == k]
            mean = w @ own / w.sum()
            off = own - mean
            covariance = (off * w[:, np.newaxis]).T @ off / w.sum()
            floor = OWN_OF_VARIANCE * np.trace(covariance) + OWN_OF_LIGHT * (mean @ mean)
            covariance += floor / mean.size * np.eye(mean.size)
            means.append(mean)
            covariances.append(covariance)
            roots.append(np.linalg.inv(np.linalg.cholesky(covariance)))
            shares.append(SHARE[family.family] * w.sum() / weights.sum())
            families.append(number)
    assert len(set(families)) == len(FAMILIES)
    return Prior(
        np.array(means), np.array(covariances), np.array(roots), np.log(np.array(shares)), np.array(families, np.int64)
    )


def _groups(emissions: Floats, count: int, observer: Observer) -> npt.NDArray[np.int64]:
    """Group [S] of each lamp by k-means on the smoothed spectra, seeded with far ones; groups of few join the nearest."""
    nm = observer.wavelengths_nm
    blur = np.exp(-0.5 * ((nm[:, np.newaxis] - nm) / (RESOLUTION_NM / 2.3548)) ** 2)
    blur /= blur.sum(axis=1, keepdims=True)
    shapes = np.sqrt(emissions @ blur.T)
    centres = [shapes.mean(axis=0)]
    nearest = ((shapes - centres[0]) ** 2).sum(axis=1)
    chance = np.random.default_rng(len(shapes))
    for _ in range(count - 1):
        centres.append(shapes[chance.choice(len(shapes), p=nearest / nearest.sum())])
        nearest = np.minimum(nearest, ((shapes - centres[-1]) ** 2).sum(axis=1))
    middle = np.array(centres)
    for _ in range(25):
        group = _distances(shapes, middle).argmin(axis=1)
        middle = np.array([shapes[group == k].mean(axis=0) if (group == k).any() else middle[k] for k in range(count)])
    enough = np.bincount(group, minlength=count) >= 12
    group = _distances(shapes, middle[enough]).argmin(axis=1)
    return np.unique(group, return_inverse=True)[1].astype(np.int64)


def _distances(shapes: Floats, centres: Floats) -> Floats:
    return np.asarray((shapes**2).sum(axis=1)[:, np.newaxis] - 2 * shapes @ centres.T + (centres**2).sum(axis=1))
