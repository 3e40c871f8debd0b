"""Texts that a setting may be: wavelengths, kinds of light."""

from __future__ import annotations

import difflib
import itertools
import re
from typing import Annotated

from pydantic import AfterValidator

LIGHT_TYPES = ("daylight", "sunset", "led", "fluorescent", "incandescent", "smooth")
#: What else people call them.
OTHER_NAMES = {"tungsten": "incandescent", "halogen": "incandescent", "bulb": "incandescent", "tube": "fluorescent"}
#: Lamps whose spectra the CIE publishes, as colour-science names them.
CIE_LAMP = re.compile(r"(FL([1-9]|1[0-2])|FL3\.([1-9]|1[0-5])|HP[1-5]|LED-(B[1-5]|BH1|RGB1|V1|V2))")


def parse_wavelengths(text: str) -> tuple[float, float, float]:
    """Return (start, stop, step) in nm of a text such as `380:780:5`; ValueError with a remedy otherwise."""
    try:
        start, stop, step = (float(part) for part in text.split(":"))
    except ValueError:
        raise ValueError(f"{text!r} is not start:stop:step in nm, such as 380:780:5") from None
    if not (360 <= start < stop <= 830 and 1 <= step <= 50):
        raise ValueError(f"{text!r} should rise within 360 to 830 nm in steps of 1 to 50 nm, such as 380:780:5")
    if abs((stop - start) / step - round((stop - start) / step)) > 1e-9:
        raise ValueError(f"{text!r}: the steps do not end on {stop:g} nm; change the step or an end")
    return start, stop, step


def parse_bands(text: str) -> tuple[float, ...]:
    """Return wavelengths in nm: a grid such as `380:780:5`, or a list such as `450,532.5,650`; else a ValueError."""
    if ":" in text:
        start, stop, step = parse_wavelengths(text)
        count = round((stop - start) / step) + 1
        return tuple(start + (stop - start) * k / (count - 1) for k in range(count))
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{text!r} is neither start:stop:step nor a list of nm, such as 450,532.5,650") from None
    apart = all(upper - lower >= 1e-3 for lower, upper in itertools.pairwise(values))
    if not apart or not all(360 <= value <= 830 for value in values):
        raise ValueError(f"{text!r} should rise within 360 to 830 nm, at least 0.001 apart, such as 450,532.5,650")
    return values


def _bands(text: str) -> str:
    parse_bands(text)
    return text


def _wavelengths(text: str) -> str:
    parse_wavelengths(text)
    return text


def _light_type(text: str) -> str:
    if text not in LIGHT_TYPES and not CIE_LAMP.fullmatch(text):
        near = (
            [OTHER_NAMES[text.lower()]]
            if text.lower() in OTHER_NAMES
            else difflib.get_close_matches(text, LIGHT_TYPES, n=1)
        )
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"{text!r} is no kind of light: {', '.join(LIGHT_TYPES)} or a CIE lamp such as FL11{hint}")
    return text


LightType = Annotated[str, AfterValidator(_light_type)]
Wavelengths = Annotated[str, AfterValidator(_wavelengths)]
Bands = Annotated[str, AfterValidator(_bands)]
