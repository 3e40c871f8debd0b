"""How many cd/m² the unit of a balanced image is: from the exposure, a meter's reading, or an illuminance.

Something in the reference carries it: the lamp, whose merged green says a luminance if ISO and aperture are believed; a patch of the
chart that a meter read; the chart itself, if the illuminance on it is known. The same thing has a luminance in the image's own
unit, and their ratio is the factor. An illuminance at the place of the map is compared with the integral of the map.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from envcal.config import PhotometrySettings
from envcal.errors import EnvcalError
from envcal.unit import Unit

if TYPE_CHECKING:
    from envcal.config.models import PatchReading
    from envcal.profile import Patch, Profile

#: A reading this many times beyond what the exposure allows is not a matter of meters: another patch, lux for cd/m², a digit.
_BEYOND = 1.5
#: Published colours whose components are this alike are those of neutral patches.
_NEUTRAL = 1.2


def unit_of_chart(profile: Profile, settings: PhotometrySettings) -> tuple[Unit | None, list[str]]:
    """Return the unit that the chart of a balanced profile gives, None if it is not asked to, and warnings."""
    from calibrate.photometry import EXPOSURE_RANGE, diffuser_luminance

    warnings: list[str] = []
    if settings.exposure:
        factor = by_exposure(profile)
        if factor is None:
            camera = profile.camera
            raise EnvcalError(
                f"photometry.exposure: the reference shot says ISO {_said(camera.iso)} and f/{_said(camera.f_number)}; both are needed. "
                "Write ISOSpeedRatings and FNumber into the EXIF data of its frames, or measure a luminance or an illuminance."
            )
        camera = profile.camera
        source = f"ISO {camera.iso:g} at f/{camera.f_number:g}, saturation-based speed (ISO 12232): 78 N²/(0.65 S t)"
        return Unit(factor=factor, source=source, likely=EXPOSURE_RANGE), warnings
    if settings.patch is not None:
        patch = _patch(profile, settings.patch)
        if patch.left_out:
            warnings.append(
                f"photometry.patch: {patch.name} was left out of the chart's fit as spoilt (glare, dirt), and yet gives the unit. "
                "Give the reading of another patch, or photograph the chart without glare."
            )
        if max(patch.target_rgb) > _NEUTRAL * min(patch.target_rgb):
            warnings.append(
                f"photometry.patch: {patch.name} is coloured, and the camera's colour error enters the unit (10 % on a blue patch). "
                "Give the reading of a neutral patch, best the white one."
            )
        seen = _luminance(profile, patch)
        if not seen > 0:
            raise EnvcalError(
                f"photometry.patch: {patch.name} has the luminance {seen:.3g} in the balanced image; a positive one is expected. "
                "Give the reading of a brighter patch."
            )
        unit = Unit(
            factor=settings.patch.luminance / seen,
            source=f"a reading of {settings.patch.luminance:g} cd/m² on the patch {patch.name}",
        )
    elif settings.chart_illuminance is not None:
        unit = Unit(
            factor=diffuser_luminance(settings.chart_illuminance) / _diffuser(profile),
            source=f"an illuminance of {settings.chart_illuminance:g} lx on the chart",
        )
    else:
        return None, warnings
    return unit, [*warnings, *doubts(unit, profile)]


def unit_of_map(
    image: npt.NDArray[np.float32], weights: npt.NDArray[np.float64], settings: PhotometrySettings, *, place: Path
) -> tuple[Unit | None, list[str]]:
    """Return the unit that an illuminance gives a relative lat-long map [H, 2H, 3], None if there is none, and warnings.

    `weights` [3] are those of luminance.
    """
    from calibrate.photometry import map_illuminance

    asked = settings.of_map
    if asked is None:
        return None, []
    lux, toward = asked
    seen, missing = map_illuminance(np.asarray(image, np.float64) @ weights, toward=toward)
    where = "a horizontal plane" if toward is None else f"a vertical plane toward u = {toward:g}"
    warnings = []
    if missing:
        warnings.append(
            f"{place.name}: {missing:.3%} of what {where} sees is clipped in every frame, and counts as dark in its illuminance: "
            "the lamps there make every other luminance come out too high. Add a shorter exposure to the bracket."
        )
    return Unit(factor=lux / seen, source=f"an illuminance of {lux:g} lx on {where}"), warnings


def by_exposure(profile: Profile) -> float | None:
    """Return the factor that ISO and aperture of the reference give; None where they are not known.

    The lamp carries it: speeds are defined for daylight, and the lamp is nearly that. A lamp whose green clips in one second
    has the clipping luminance. Under another light green and luminance part (by 13 % under a warm LED).
    """
    from calibrate.photometry import clipping_luminance

    camera, lamp = profile.camera, profile.lamp
    if not camera.iso or not camera.f_number or lamp is None:
        return None
    rgb = np.asarray(lamp.rgb, np.float64)
    green = float(_camera_rgb(profile, rgb)[1])
    return clipping_luminance(f_number=camera.f_number, iso=camera.iso) * green / _balanced(profile, rgb)


def _camera_rgb(profile: Profile, corrected: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the camera RGB [3] that the chart's fit takes to `corrected`: the matrix inverted, roots by Newton's method."""
    matrix = profile.full_matrix()
    linear, roots = matrix[:, :3], matrix[:, 3:]
    camera = np.linalg.solve(linear + (roots.sum(axis=1)[:, np.newaxis] / 3 if roots.size else 0.0), corrected)
    for _ in range(30 if roots.size else 0):
        r = np.maximum(camera, 1e-12)
        pairs = np.sqrt(r * np.roll(r, -1))
        # d√(rg)/dr = √(rg)/2r, and so on round the three.
        slope = np.diag(pairs / (2 * r)) + np.roll(np.diag(np.roll(pairs / (2 * np.roll(r, -1)), 1)), -1, axis=0)
        camera = r - np.linalg.solve(linear + roots @ slope, linear @ r + roots @ pairs - corrected)
    return np.asarray(camera)


def doubts(unit: Unit, profile: Profile) -> list[str]:
    """Return a warning if a unit is far from what the exposure of the profile's reference says."""
    from calibrate.photometry import EXPOSURE_RANGE

    exposure = by_exposure(profile)
    if exposure is None:
        return []
    ratio = unit.factor / exposure
    low, high = EXPOSURE_RANGE[0] / _BEYOND, EXPOSURE_RANGE[1] * _BEYOND
    if low <= ratio <= high:
        return []
    return [
        f"photometry: {unit.source} makes the scene {ratio:.3g} times as bright as ISO {profile.camera.iso:g} and "
        f"f/{profile.camera.f_number:g} of the reference say; {low:.2g} to {high:.2g} times is expected. Check the reading and its unit, "
        "the patch, filters before the lens, and the EXIF data."
    ]


def _patch(profile: Profile, reading: PatchReading) -> Patch:
    patches = profile.chart.patches
    if isinstance(reading.patch, int):
        if reading.patch <= len(patches):
            return patches[reading.patch - 1]
        found = []
    else:
        name = reading.patch.casefold().strip()
        found = [p for p in patches if p.name.casefold() == name] or [
            p for p in patches if name and p.name.casefold().startswith(name)
        ]
    if len(found) != 1:
        listed = ", ".join(f"{k} {patch.name}" for k, patch in enumerate(patches, 1))
        raise EnvcalError(
            f"photometry.patch: {reading.patch!r} names {len(found) or 'no'} patch{'es' if len(found) > 1 else ''} of the chart; one of these is expected: "
            f"{listed}."
        )
    return found[0]


def _balanced(profile: Profile, corrected: npt.NDArray[np.float64]) -> float:
    """Return the luminance, in the image's unit, of a colour in corrected RGB."""
    from uplift.spectrum import rgb_space

    weights = rgb_space(profile.working_space).luminance_weights
    return float(weights @ np.asarray(profile.balance_matrix, np.float64) @ corrected)


def _luminance(profile: Profile, patch: Patch) -> float:
    from calibrate.correct import apply_matrix

    seen = np.asarray(patch.camera_rgb, np.float32)[np.newaxis, np.newaxis]
    return _balanced(profile, apply_matrix(seen, profile.full_matrix())[0, 0].astype(np.float64))


def _diffuser(profile: Profile) -> float:
    return _balanced(profile, np.ones(3))


def _said(value: float | None) -> str:
    return "unknown" if value is None else f"{value:g}"
