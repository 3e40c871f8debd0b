"""The colour of a light in the map, how sure it is, and which kinds of lamp it speaks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uplift.cct import cct_duv, mccamy, nearest_cct, xy_of_rgb
from uplift.cluster import Clusters
from uplift.illuminants.kinds import kind_probabilities
from uplift.spectrum import Observer, RGBSpace

# Relative error of the CCT besides the spread of its evidence. Direct: over 90 lamps in relit rooms the median was 0.2 %,
# 80 % were within 1.1 % and 90 % within 4.6 % (windows that mirror another lamp). Outdoors: 2.3 % at most in three skies.
# Surfaces: up to 15 % where they are coloured at random.
CCT_ERROR_DIRECT, CCT_ERROR_SURFACES, CCT_ERROR_OUTDOOR = 0.02, 0.10, 0.05
DUV_ERROR_DIRECT, DUV_ERROR_SURFACES = 0.001, 0.010
DUV_PER_MIRED = 0.00042  # the length of a mired in (u, v): 25 of them are 0.009 to 0.012
SKY_SAYS_DAYLIGHT = 100.0  # how much likelier daylight is than any other kind where there is a sky, before any colour


@dataclass(frozen=True, slots=True)
class Seen:
    """A light's colour in the map; NaN for a black cluster."""

    cct: float  # K
    duv: float
    cct_sigma: float  # K
    duv_sigma: float
    sun: float  # K, of the brightest place of an outdoor light; NaN otherwise
    trusted: bool  # seen directly, or outdoors; not told by surfaces


def seen_of(clusters: Clusters, cluster: int, space: RGBSpace, estimator: str, calibration: float) -> Seen:
    """Return the colour of a cluster's light by an estimator ("lamps", "paper"), and its uncertainty."""
    outdoor, direct = bool(clusters.outdoor[cluster]), bool(clusters.direct[cluster])
    if estimator == "paper":
        mean = xy_of_rgb(clusters.means[cluster], space.xyz_from_rgb)
        cct = float(mccamy(mean))
        if outdoor:
            cct = (cct + float(mccamy(xy_of_rgb(clusters.brightest[cluster], space.xyz_from_rgb)))) / 2.0
        duv = nearest_cct(mean)[1]
    else:
        cct, duv = nearest_cct(xy_of_rgb(clusters.lamps[cluster], space.xyz_from_rgb))
    sun = float("nan")
    if outdoor:
        sun = float(cct_duv(xy_of_rgb(clusters.brightest[cluster], space.xyz_from_rgb))[0])
    spread = float(clusters.spread_mired[cluster])
    error = CCT_ERROR_DIRECT if direct else CCT_ERROR_SURFACES
    of_spread = 0.0 if not np.isfinite(spread) else spread * cct**2 / 1e6
    across = float(clusters.spread_duv[cluster])
    across = 0.0 if not np.isfinite(across) else across
    if outdoor:  # a sky's many colours are no uncertainty of what it gives to a level surface
        error, of_spread, across = CCT_ERROR_OUTDOOR, 0.0, 0.0
    sigma = float(np.sqrt((error * cct) ** 2 + of_spread**2 + (calibration * cct) ** 2))
    # A camera that errs by so much along the locus errs across it as well.
    of_camera = DUV_PER_MIRED * calibration * 1e6 / cct if np.isfinite(cct) and cct > 0 else 0.0
    own = DUV_ERROR_DIRECT if direct or outdoor else DUV_ERROR_SURFACES
    duv_sigma = float(np.sqrt(own**2 + across**2 + of_camera**2))
    return Seen(cct, duv, sigma, duv_sigma, sun, direct or outdoor or estimator == "paper")


def kinds_of(seen: Seen, outdoor: bool, observer: Observer) -> dict[str, float]:
    """Return the probability of each kind, from the sky and the colour."""
    spread = seen.cct_sigma / seen.cct**2 * 1e6 if np.isfinite(seen.cct) else 0.0
    found = kind_probabilities(seen.cct, seen.duv, observer, sigma_mired=spread, sigma_duv=seen.duv_sigma)
    if outdoor:
        found = {kind: p * (SKY_SAYS_DAYLIGHT if kind == "daylight" else 1.0) for kind, p in found.items()}
    total = sum(found.values())
    return {kind: p / total for kind, p in found.items()}
