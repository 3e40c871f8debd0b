"""White LEDs: the CIE's measured ones, and models of warmer and cooler ones.

The nodes from 2734 to 6591 K are CIE LED-B1 to LED-B5 (CIE 015:2018), the representative phosphor-converted blue LEDs
of Kokka et al. (Metrologia 55, 2018). Hybrid (BH1), violet-pumped (V1, V2) and RGB LEDs are had by name: within ten kelvin
of a B lamp their spectra are quite different, so that mixing by CCT would jump from one kind to another.

No measured distribution below LED-B1 or above LED-B5 is published by the CIE. The nodes there are **modelled**: the blue
pump and the phosphor of LED-B1 with more of the red of LED-RGB1, and those of LED-B5 with more pump and some of the
green of LED-RGB1, in fixed proportions that stand in the table below and lie on the Planckian locus within Duv 3e-6.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

from uplift.illuminants.nodes import Node, check_range, interpolated, nodes_of
from uplift.spectrum import Observer, illuminant, normalised

Floats = npt.NDArray[np.float64]

MEASURED = ("LED-B1", "LED-B2", "LED-B3", "LED-B4", "LED-B5")
NAMES = (*MEASURED, "LED-BH1", "LED-RGB1", "LED-V1", "LED-V2")
RANGE_K = (1700.0, 30_000.0)

# where the pump ends and the phosphor begins: the valley between them; and the same of LED-RGB1's three parts
VALLEY_B1_NM, VALLEY_B5_NM = 480.0, 485.0
BLUE_END_RGB1_NM, GREEN_END_RGB1_NM = 490.0, 575.0
VALLEY_WIDTH_NM = 2.5

# CCT in kelvin: (pump of LED-B1, red of LED-RGB1), added to the phosphor of LED-B1
WARMER = {1690: (0.2557, 1.1161), 1900: (0.3857, 0.6930), 2150: (0.5529, 0.3810), 2400: (0.7270, 0.1774)}
# CCT in kelvin: (pump of LED-B5, green of LED-RGB1), added to the phosphor of LED-B5
COOLER = {
    8000: (1.2418, 0.0899),
    10000: (1.5084, 0.1894),
    14000: (1.8571, 0.3027),
    20000: (2.1404, 0.3843),
    30300: (2.3702, 0.4451),
}


def led(cct: float, observer: Observer) -> Floats:
    """Return the emission [N], Y = 1, of a phosphor-converted LED of `cct` kelvin, 1700–30 000.

    Raises UpliftError outside that range.
    """
    check_range("led", cct, *RANGE_K, "Give a measured spectrum, or another type.")
    return interpolated(led_nodes(observer), cct, observer)


@cache
def led_nodes(observer: Observer) -> tuple[Node, ...]:
    """Return the distributions in order of CCT; the names of those that are no measurements end in "(modelled)"."""
    warm, cool, rgb = (illuminant(name, observer) for name in ("LED-B1", "LED-B5", "LED-RGB1"))
    pump_warm = _below(VALLEY_B1_NM, observer) * warm
    pump_cool = _below(VALLEY_B5_NM, observer) * cool
    to_green = _below(GREEN_END_RGB1_NM, observer) * rgb
    red, green = rgb - to_green, to_green - _below(BLUE_END_RGB1_NM, observer) * rgb
    spectra = [(name, illuminant(name, observer)) for name in MEASURED]
    spectra += [
        (_modelled(cct), normalised((warm - pump_warm) + pump * pump_warm + more * red, observer))
        for cct, (pump, more) in WARMER.items()
    ]
    spectra += [
        (_modelled(cct), normalised((cool - pump_cool) + pump * pump_cool + more * green, observer))
        for cct, (pump, more) in COOLER.items()
    ]
    return nodes_of(spectra, observer)


def _modelled(cct: int) -> str:
    return f"LED {cct} K (modelled)"


def _below(wavelength_nm: float, observer: Observer) -> Floats:
    """A smooth step [N] from 1 below to 0 above a wavelength."""
    out: Floats = 1.0 / (1.0 + np.exp((observer.wavelengths_nm - wavelength_nm) / VALLEY_WIDTH_NM))
    return out
