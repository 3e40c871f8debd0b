"""Lights of every family, from colour-science, on the observer's grid."""

from functools import cache

from uplift.spectrum import illuminant, normalised, observer

NAMES = ("D65", "A", "LED-B1", "LED-B3", "LED-RGB1", "FL2", "FL11", "2200 K", "1200 K")


@cache
def light(name):
    """Return the light `name`, an illuminant or a black body ("2200 K"), [81], Y = 1."""
    import colour

    eyes = observer()
    if not name.endswith(" K"):
        return illuminant(name, eyes)
    return normalised(colour.sd_blackbody(float(name[:-2]), colour.SpectralShape(380, 780, 5)).values, eyes)
