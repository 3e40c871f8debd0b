"""How far to follow a measured spectrum: no further than it can be trusted to relight better than a plain one.

A wrong spectrum does more harm than a smooth one of the same colour. What each would cost is estimated with spectra drawn
from the posterior, taken as twice as wide as it says: the chart's 24 reflectances stand in for the surfaces of a room and
for those that its light then falls on, and a room's reflectance is recovered from its colour as a polynomial of three
coefficients. The loss is the distance in CIELAB, over that of the spectrum D65. Of the mixtures of the measured and the
smooth spectrum the first is taken whose loss, in the worst tenth of the draws, is small enough, or else the least bad. If then the measured
spectrum would be bad even if it were exactly right, the lamp suits three coefficients badly (some daylight tubes, metal halide lamps), and
the loss can no longer tell which mixture is best: only those that are smooth for the most part are left.

An unknown camera's spectrum is never followed whole: the camera may be mistaken in a way that the light makes up for, of which the
posterior knows nothing.

This is an approximation of the uplift, not the uplift itself: over 156 estimates of 39 lamps, few of them LEDs, the logarithm
of its ratio for the true light had a correlation of 0.87 to 0.94 with that of rendered rooms, and the same with the uplift itself in its place one
of 0.97 over 60 lamps, at ten times the cost. `ENOUGH`, `QUANTILE` and `WIDER` were chosen on those 156. `BADLY`, `HARDLY` and
`MOST_UNKNOWN` were chosen on half of 148 readings of 74 lamps by 11 cameras and checked on the other half (docs/spectrometer.md).
"""

from __future__ import annotations

import numpy as np

from uplift.illuminants import cct_duv_of, family_emission
from uplift.spectrometer.posterior import Floats
from uplift.spectrum import Observer, illuminant, xyz_of

#: Shares of the measured spectrum that are tried, in this order.
SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)
#: Loss over that of D65 which is small enough, in this quantile of this many draws from a posterior so much wider.
ENOUGH, QUANTILE, DRAWS, WIDER = 0.8, 0.9, 40, 2.0
#: Loss over that of D65 from which on a spectrum suits the uplift badly though it be right, and the largest share of such a one (and
#: of one that was read by a camera of which it is doubtful that it is like the known ones).
BADLY, HARDLY = 0.65, 0.25
#: The largest share with an unknown camera.
MOST_UNKNOWN = 0.85
_SMOOTH_K = (1000.0, 25000.0)


def smooth_of_colour(emission: Floats, observer: Observer) -> Floats:
    """Return the smooth light [N] of the CCT of `emission` [N], bent by the exponential of a parabola to its very colour."""
    kelvin = float(np.clip(cct_duv_of(emission, observer)[0], *_SMOOTH_K))
    base, goal = family_emission("smooth", kelvin, observer), xyz_of(emission, observer)
    powers = _powers(observer)
    amounts = np.zeros(3)
    for _ in range(30):
        bent = base * np.exp(amounts @ powers)
        slopes = xyz_of(bent * powers, observer).T
        amounts = amounts + np.clip(np.linalg.solve(slopes, goal - xyz_of(bent, observer)), -0.5, 0.5)
    return np.asarray(base * np.exp(amounts @ powers))


def trusted(
    emission: Floats, covariance: Floats, reflectances: Floats, observer: Observer, *, most: float = 1.0
) -> tuple[Floats, float]:
    """Return the light [N] to use for a measured `emission` [N] of Y = 1 with its `covariance`, and the share measured.

    No share above `most` is tried.
    """
    if not np.isfinite(cct_duv_of(emission, observer)[0]):  # no white: nothing smooth has its colour
        return emission, 1.0
    plain = smooth_of_colour(emission, observer)
    shares = (most, *(share for share in SHARES if share < most))
    tried = [share * emission + (1.0 - share) * plain for share in shares]
    daylight = illuminant("D65", observer)
    losses = relight_losses(_draws(emission, covariance, observer), [*tried, daylight], reflectances, observer)
    bad = np.quantile(losses[:, :-1] / losses[:, -1:], QUANTILE, axis=0)
    enough = np.flatnonzero(bad < ENOUGH)
    if enough.size:
        best = int(enough[0])
    else:
        if_right = relight_losses(emission[np.newaxis], [emission, daylight], reflectances, observer)[0]
        left = np.array(shares) <= (HARDLY if if_right[0] > BADLY * if_right[1] else 1.0)
        best = int(np.where(left, bad, np.inf).argmin())
    return tried[best], shares[best]


def relight_losses(truths: Floats, tried: list[Floats], reflectances: Floats, observer: Observer) -> Floats:
    """Return the loss [S, K] of believing light `tried` [K][N] where it is one of `truths` [S, N], for `reflectances` [R, N]."""
    cmfs, powers = observer.cmfs * observer.step_nm, _powers(observer)
    white = illuminant("D65", observer) @ cmfs
    seen = np.einsum("rn,sn,nc->src", reflectances, truths, cmfs, optimize=True)  # the room's colours
    adapted = seen[:, :, np.newaxis, np.newaxis, 1]
    right = np.einsum("jn,sn,kn,nc->sjkc", reflectances, truths, reflectances, cmfs, optimize=True)
    right = _lab(right / adapted, white)
    out = np.empty((len(truths), len(tried)))
    for number, light in enumerate(tried):
        amounts = seen @ np.linalg.inv(np.einsum("bn,n,nc->bc", powers, light, cmfs))
        again = np.einsum("kn,bn,n,nc->kbc", reflectances, powers, light, cmfs, optimize=True)
        relit = np.einsum("sjb,kbc->sjkc", amounts, again, optimize=True)
        out[:, number] = np.linalg.norm(_lab(relit / adapted, white) - right, axis=-1).mean(axis=(1, 2))
    return out


def _draws(emission: Floats, covariance: Floats, observer: Observer) -> Floats:
    values, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
    random = np.random.default_rng(0).standard_normal((DRAWS, emission.size))
    drawn = np.maximum(emission + WIDER * random @ (axes * np.sqrt(np.maximum(values, 0.0))).T, 0.0)
    return np.asarray(drawn / xyz_of(drawn, observer)[:, 1:2])


def _powers(observer: Observer) -> Floats:
    t = (observer.wavelengths_nm - 560.0) / 180.0
    return np.stack([np.ones_like(t), t, t**2])


def _lab(xyz: Floats, white: Floats) -> Floats:
    """CIELAB over 100, the cube root held below one part in 10 000."""
    f = np.cbrt(np.maximum(xyz / white, 1e-4))
    return np.stack([1.16 * f[..., 1], 5 * (f[..., 0] - f[..., 1]), 2 * (f[..., 1] - f[..., 2])], axis=-1)
