"""Emission spectra of the families of lamps that an environment map may hold.

`family_emission` returns one by the name of its family and its CCT; `FAMILIES` says which there are and how far they
reach. Single lamps (FL11, LED-V2, HP1, …) are had by name from `uplift.spectrum.illuminant`, a person's own from
`measured_emission`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from uplift import UpliftError
from uplift.illuminants import daylight as _daylight
from uplift.illuminants import fluorescent as _fluorescent
from uplift.illuminants import incandescent as _incandescent
from uplift.illuminants import led as _led
from uplift.illuminants import smooth as _smooth
from uplift.illuminants import sunset as _sunset
from uplift.illuminants.measured import measured_emission
from uplift.illuminants.nodes import cct_duv_of
from uplift.illuminants.prague import prague_nodes, prague_sunset, read_prague
from uplift.spectrum import Observer
from uplift.spectrum import observer as grid

__all__ = ["FAMILIES", "Family", "cct_duv_of", "family_emission", "measured_emission", "with_sky_model"]


@dataclass(frozen=True, slots=True)
class Family:
    """A kind of lamp whose spectrum follows from its CCT."""

    emission: Callable[[float, Observer], npt.NDArray[np.float64]]
    low_k: float
    high_k: float
    source: str


FAMILIES: dict[str, Family] = {
    "daylight": Family(
        _daylight.daylight, *_daylight.RANGE_K, "CIE D50, D55, D65, D75 interpolated; D series above 7500 K"
    ),
    "sunset": Family(
        _sunset.sunset, *_sunset.RANGE_K, "direct beam of a low sun (Bird and Riordan 1984), airmass solved for the CCT"
    ),
    "led": Family(
        _led.led, *_led.RANGE_K, "CIE LED-B1 to LED-B5 interpolated; modelled from them below 2734 K and above 6591 K"
    ),
    "fluorescent": Family(_fluorescent.fluorescent, *_fluorescent.RANGE_K, "CIE FL1 to FL6 interpolated"),
    "incandescent": Family(_incandescent.incandescent, *_incandescent.RANGE_K, "black body (Planck)"),
    "smooth": Family(
        _smooth.smooth, *_smooth.RANGE_K, "unknown kind of lamp: black body below 4500 K, daylight above 5500 K"
    ),
}


def with_sky_model(data: npt.NDArray[np.uint8], *, place: str = "Prague sky model") -> dict[str, Family]:
    """Return the families with sunsets from a data file of the Prague sky model, `data` [bytes]; see `prague`.

    Raises UpliftError if the bytes are not such a file.
    """
    sky = read_prague(data, place=place)
    nodes = prague_nodes(sky, grid())
    reach = (nodes[0].cct, min(nodes[-1].cct, _daylight.RANGE_K[0]))
    if reach[0] >= reach[1]:
        raise UpliftError(f"{place}: its low suns have {reach[0]:.0f} K and more; expected some below 5000 K")

    def sunset(cct: float, observer: Observer) -> npt.NDArray[np.float64]:
        return prague_sunset(prague_nodes(sky, observer), cct, observer)

    source = "brightest place of the sky under a low sun (Prague sky model, Wilkie et al. 2021)"
    return {**FAMILIES, "sunset": Family(sunset, reach[0] * (1 + 1e-6), reach[1] * (1 - 1e-6), source)}


def family_emission(family: str, cct: float, observer: Observer) -> npt.NDArray[np.float64]:
    """Return the emission [N], Y = 1, of a family of lamps at exactly `cct` kelvin.

    Raises UpliftError for an unknown family, or a CCT that it does not reach.
    """
    if family not in FAMILIES:
        raise UpliftError(f"family {family!r} is unknown; expected one of {', '.join(FAMILIES)}")
    return FAMILIES[family].emission(cct, observer)
