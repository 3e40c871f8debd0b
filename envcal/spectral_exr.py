"""The spectral EXR layout of Fichet, Pacanowski and Wilkie, "An OpenEXR Layout for Spectral Images", JCGT 2021.

Emissive, unpolarised images: one channel `S0.<wavelength>nm` a band, the decimal sign being a comma since a point
separates layers; R, G and B stay for a preview.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

ATTRIBUTES: dict[str, Any] = {"spectralLayoutVersion": "1.0", "emissiveUnits": "W.m^-2.sr^-1"}


def channel(wavelength_nm: float) -> str:
    """Return the name of the channel of a band, such as `S0.550,000000nm`."""
    return f"S0.{wavelength_nm:.6f}nm".replace(".", ",").replace("S0,", "S0.")


def channels(wavelengths_nm: Sequence[float], *, half: bool, half_preview: bool = True) -> dict[str, str]:
    """Return the channels of a spectral image with their types: the bands and the preview.

    In cd/m² lamps are brighter than a half float can hold, hundreds of times more so than their bands in W.
    """
    kind, preview = "f2" if half else "f4", "f2" if half and half_preview else "f4"
    return dict.fromkeys((channel(w) for w in wavelengths_nm), kind) | dict.fromkeys("RGB", preview)
