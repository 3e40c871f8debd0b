"""Incandescent light: black bodies by Planck's law, 1000–4000 K.

A filament is a little bluer than a black body of its colour temperature (tungsten's emissivity falls towards red);
its chromaticity and the shape of its spectrum over the visible range are those of a black body within a percent.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from uplift.cct import planck
from uplift.illuminants.nodes import cct_duv_of, check_range, solved
from uplift.spectrum import Observer, normalised

RANGE_K = (1000.0, 4000.0)


def incandescent(cct: float, observer: Observer) -> npt.NDArray[np.float64]:
    """Return the emission [N], Y = 1, of a black body whose CCT is `cct` kelvin, 1000–4000.

    Raises UpliftError outside that range.
    """
    check_range("incandescent", cct, *RANGE_K, "No filament is hotter; declare another type, or the right CCT.")
    return black_body(cct, observer)


def black_body(cct: float, observer: Observer) -> npt.NDArray[np.float64]:
    """Return Planck's law [N], Y = 1, at the temperature at which the observer's grid sees exactly `cct`."""

    def offset(temperature: float) -> float:
        return cct_duv_of(planck(observer.wavelengths_nm, temperature), observer)[0] - cct

    temperature = cct
    if abs(offset(cct)) > 1e-4 and 1005.0 < cct < 90_000.0:  # near the ends of CCT's range there is nothing to bracket
        temperature = solved(offset, cct * 0.996, cct * 1.004)
    return normalised(planck(observer.wavelengths_nm, temperature), observer)
