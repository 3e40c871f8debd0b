"""Luminance: what a camera's settings, a meter or an illuminance say of the scene in cd/m².

Photometry as of the SI and CIE 15; speeds as of ISO 12232:2019. The saturation-based speed of a camera is S = 78 / H, H being
the focal-plane exposure in lx·s at which its samples clip, and the focal plane sees H = q · L · t / N² of a luminance L, with
q = 0.65 for an ordinary lens (ISO 12232, Annex A). So a sample clips at L = 78 · N² / (0.65 · S · t). That, and no other constant, is about the clipping of a
sensor: the constants of exposure meters, K = 12.5 and C = 250…330 (ISO 2720), say which exposure is advised, and tell a
luminance only together with where a picture puts its middle grey.

Left out: a lens's own transmission, bellows, and whatever a maker does with the number on the dial.
"""

import math

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError

#: lm/W at 540 THz: the definition of the candela.
LUMINOUS_EFFICACY = 683.0

#: lx·s · ISO at which samples clip, and the share of L·t/N² that the focal plane sees (ISO 12232:2019).
SATURATION_LX_S = 78.0
LENS_FACTOR = 0.65

#: Between these the true luminance lies, as multiples of that from the camera's settings. Makers mark standard output sensitivity
#: or a recommended index, and samples then clip 0…0.8 EV above what the number says (DxOMark, "Pushed ISO", 2011, and its measured
#: speeds); lenses differ from q by 0.2 EV, marked apertures from true ones by 0.1 EV.
EXPOSURE_RANGE = (0.85, 1.9)

_UP = (0.0, 1.0, 0.0)


def clipping_luminance(*, f_number: float, iso: float) -> float:
    """Return the luminance, in cd/m², at which a camera's samples clip in an exposure of one second.

    That is what 1 means in merged camera RGB, as far as the number on the dial is the saturation-based speed: the truth lies
    within `EXPOSURE_RANGE` times this.

    Raises
    ------
    CalibrateError
        An f-number or ISO that is not positive.
    """
    for word, value in (("f-number", f_number), ("ISO", iso)):
        if not (math.isfinite(value) and value > 0):
            raise CalibrateError(
                f"{word} {value:g}: a positive number is expected. Write it into the EXIF data, or measure a luminance or an "
                "illuminance instead."
            )
    return SATURATION_LX_S * f_number**2 / (LENS_FACTOR * iso)


def exposure_gain(
    *, iso: float | None, f_number: float | None, reference_iso: float | None, reference_f_number: float | None
) -> float | None:
    """Return by what radiance in camera RGB is multiplied to be in the unit of a reference shot, from the nominal settings.

    A unit of camera RGB is a luminance of N²/S. None where a setting is known of one shot only; what neither tells is taken
    for equal.
    """
    gain = 1.0
    for own, other, power in ((iso, reference_iso, -1), (f_number, reference_f_number, 2)):
        if own == other:
            continue
        if own is None or other is None:
            return None
        gain *= (own / other) ** power
    return gain


def diffuser_luminance(illuminance: float) -> float:
    """Return the luminance, in cd/m², of a perfect white diffuser under an illuminance in lx (Lambert)."""
    return illuminance / math.pi


def plane_normal(toward: float | None) -> tuple[float, float, float]:
    """Return the normal of a plane: up (+Y) for None, else horizontal, toward the map's column u (0…1, the middle is −Z)."""
    if toward is None:
        return _UP
    phi = 2 * math.pi * (toward - 0.5)
    return math.sin(phi), 0.0, -math.cos(phi)


def map_illuminance(luminance: npt.NDArray[np.floating], *, toward: float | None = None) -> tuple[float, float]:
    """Return the illuminance that a lat-long map casts on a plane at its middle, and the share of it that is not known.

    The integral of L·cos over the plane's half of the sphere, exact for a map that is constant in each pixel.

    Parameters
    ----------
    luminance
        Shape (H, 2H), any unit; NaN where it is not known, which counts as 0. Row 0 is the zenith.
    toward
        None for a horizontal plane that looks up; else the column, 0…1, which a vertical plane faces.

    Returns
    -------
    The illuminance, in lx for cd/m², and the missing pixels' share of ∫cos (0…1), whatever light they would bring.

    Raises
    ------
    CalibrateError
        No light on the plane.
    """
    height, width = luminance.shape
    theta = np.linspace(0.0, np.pi, height + 1)
    if toward is None:
        # ∫ cosθ sinθ dθ, upper half only.
        rows = np.diff(np.sin(np.minimum(theta, np.pi / 2)) ** 2) / 2
        columns = np.full(width, 2 * np.pi / width)
    else:
        # ∫ sin²θ dθ, and ∫ cos(φ − φ₀) dφ where that is positive.
        rows = np.diff(theta - np.sin(2 * theta) / 2) / 2
        phi = 2 * np.pi * (np.linspace(0.0, 1.0, width + 1) - toward)
        columns = np.diff(_positive_sine(phi))
    values = np.asarray(luminance, np.float64)
    known = np.isfinite(values)
    total = float(rows @ np.where(known, values, 0.0) @ columns)
    missing = float(rows @ ~known @ columns) / np.pi if not known.all() else 0.0
    if not total > 0:
        raise CalibrateError(
            f"illuminance on the {'horizontal' if toward is None else 'vertical'} plane: the map casts {total:.3g}; light is "
            "expected there. Name the other plane, or another way to the unit."
        )
    return total, missing


def _positive_sine(phi: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return an antiderivative of max(cos φ, 0): it grows by 2 with every turn."""
    turns = np.floor((phi + np.pi / 2) / (2 * np.pi))
    rest = phi - 2 * np.pi * turns
    return np.asarray(2 * turns + np.sin(np.minimum(rest, np.pi / 2)))
