"""What a person is told of a light: what is doubtful, and what would make it surer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from uplift.illuminants import cct_duv_of
from uplift.lights.declared import NAMED_TYPES
from uplift.lights.record import Declared, Light
from uplift.spectrum import Observer

Floats = npt.NDArray[np.float64]

TUBE_REMEDY = (
    "name the tube: type FL12, FL11 or FL10 for a three-band one of 3000, 4000 or 5000 K (marked 830, 840, 850), FL7 to FL9 or "
    "FL3.12 to FL3.14 for a broad-band one of high colour rendering; or photograph the chart in its light"
)
LED_DUV = 0.004  # phosphor LEDs of the CIE and nearly all others are nearer than this to the family's locus
SAME_MIRED, SAME_DUV = 20.0, 0.006  # so near a spectrum must be to a light's colour to be taken for its own


def about_tubes(lights: Sequence[Light], known: Mapping[int, Declared]) -> list[str]:
    """Return a warning of the lights that are fluorescent, of tubes that nobody named."""
    tubes = [light for light in lights if _is_any_tube(light, known.get(light.cluster))]
    if not tubes:
        return []
    return [
        f"light{'s' if len(tubes) > 1 else ''} {', '.join(str(light.cluster) for light in tubes)}: `fluorescent` has the "
        f"spectrum of halophosphate tubes (FL1 to FL6). For a three-band tube or a compact lamp it is some 2.5 times as wrong "
        f"as no declaration, and colours do not tell which it is. {TUBE_REMEDY[0].upper()}{TUBE_REMEDY[1:]}"
    ]


def _is_any_tube(light: Light, declared: Declared | None) -> bool:
    """Whether a light is fluorescent, of a tube that nobody named."""
    return light.type == "fluorescent" and (declared is None or declared.type not in NAMED_TYPES)


def not_like_an_led(light: Light, declared: Declared | None) -> list[str]:
    """Return a warning if a light that is said to be an LED, of no name, has no colour of white phosphor LEDs."""
    if light.type != "led" or (declared is not None and declared.type in NAMED_TYPES):
        return []
    off = light.duv_seen - light.duv
    if not abs(off) > max(LED_DUV, 2.0 * light.duv_sigma):
        return []
    return [
        f"light {light.cluster}: said to be an LED, but its colour is {abs(off):.4f} (Duv) to the {'green' if off > 0 else 'pink'} "
        f"side of white phosphor LEDs of {light.cct:.0f} K; it may be made of coloured LEDs or be another lamp, and the spectrum "
        "taken may do harm. Declare LED-RGB1 or its measured spectrum, leave the type away, or photograph the chart in its light"
    ]


def _apart(light: Light, emission: Floats, observer: Observer) -> float:
    """How far a spectrum's colour is from a light's, in units of what is still the same."""
    cct, duv = cct_duv_of(emission, observer)
    if not (np.isfinite(cct) and np.isfinite(light.cct_seen)):
        return float("inf")
    along = abs(1e6 / cct - 1e6 / light.cct_seen) / SAME_MIRED
    return float(np.hypot(along, abs(duv - light.duv_seen) / SAME_DUV))


def with_suggestion(light: Light, library: Sequence[tuple[str, Floats]], observer: Observer) -> Light:
    """Return the light, with the spectrum of the library that has its colour named in the remedy, where nothing is known of it."""
    if light.declared or not library:
        return light
    apart = [_apart(light, emission, observer) for _, emission in library]
    nearest = int(np.argmin(apart))
    if not apart[nearest] <= 1.0:
        return light
    place = f"at: [{light.at[0]:.3f}, {light.at[1]:.3f}]"
    more = f"it has the colour of {library[nearest][0]} of your library: if it is that lamp, declare {{{place}, spd: {library[nearest][0]}}}"
    return replace(light, remedy="; ".join(part for part in (light.remedy, more) if part))


def remedy_of(declared: Declared | None, kind: str, outdoor: bool, at: tuple[float, float], indoor: str) -> str:
    """Return what a person could do to make a light surer; "" where nothing is needed."""
    place = f"at: [{at[0]:.3f}, {at[1]:.3f}]"
    if kind == "fluorescent" and (declared is None or declared.type == kind):
        taken = "" if declared is not None else f"taken for fluorescent as all indoor lights; at {place[4:]}, "
        return taken + TUBE_REMEDY
    if declared is not None and (declared.emission is not None or declared.type is not None):
        return ""
    if outdoor:
        return "" if declared is not None else f"if this is no daylight, declare {{{place}, type: …}}"
    if indoor == "auto" or declared is not None:
        return f"declare {{{place}, type: led | fluorescent | incandescent | FL11 | …}}, or its measured spectrum (spd)"
    return f"taken for {indoor} as all indoor lights; if it is not, declare {{{place}, type: …}}"
