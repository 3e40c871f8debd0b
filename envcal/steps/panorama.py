"""Shots → one latitude-longitude map."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from envcal import exr, provenance
from envcal.config import PanoramaSettings, PhotometrySettings
from envcal.errors import EnvcalError
from envcal.profile import parse
from envcal.runner import Outcome
from envcal.steps.absolute import doubts, unit_of_map
from envcal.unit import Unit, unit_of


def panorama(
    shots: Sequence[Path], out: Path, settings: PanoramaSettings, photometry: PhotometrySettings | None = None
) -> Outcome:
    """Write the lat-long map that `shots` show to `out`; a single shot of 2:1 passes through.

    An illuminance measured at the map's place gives a relative map its unit.
    """
    from calibrate.panorama import latlong_from_shots
    from uplift.spectrum import rgb_space

    headers, images = zip(*(exr.read_rgb(shot) for shot in shots), strict=True)
    image = latlong_from_shots(images)
    space = headers[0].attributes.get("envcalSpace")
    if not isinstance(space, str) or space == provenance.CAMERA_RGB:
        raise EnvcalError(
            f"{shots[0]}: is not in a working RGB space yet ({space or 'unknown'}). Run `envcal correct` and "
            f"`envcal balance` on it first."
        )
    photometry = photometry or PhotometrySettings()
    unit = _shared_unit(shots, headers)
    warnings: list[str] = []
    if photometry.of_map is not None:
        if unit is not None:
            raise EnvcalError(
                f"{shots[0]}: is in cd/m² already, from {unit.source}; an illuminance of the map would be a second unit. Balance it "
                "without `photometry`, or leave the illuminance out."
            )
        unit, warnings = unit_of_map(image, rgb_space(space).luminance_weights, photometry, place=shots[0])
        assert unit is not None
        image = image * np.float32(unit.factor)
        told = headers[0].attributes.get("envcalProfile")
        if told is not None:
            warnings += doubts(unit, parse(str(told), place=f"{shots[0]}: its envcalProfile"))
    attributes = {
        **provenance.attributes("panorama", settings=settings.model_dump(mode="json"), inputs=shots, unit=unit),
        **provenance.colour_space(space),
        "envmap": True,
    }
    lost = np.isnan(image).any(axis=2)
    exr.write(out, exr.with_lost(image), attributes=attributes)
    height, width = lost.shape
    weight = np.sin(np.pi * (np.arange(height) + 0.5) / height)
    share = float((lost.mean(axis=1) * weight).sum() / weight.sum())
    if lost.any():
        warnings.append(
            f"{int(lost.sum())} pixels of the map ({share:.2%} of the sphere) are clipped in every frame and stay NaN. "
            f"Add a shorter exposure to the bracket."
        )
    figures = {
        "size": [width, height],
        "lost_share": share,
        "unit": None if unit is None else unit.model_dump(mode="json"),
    }
    return Outcome(f"{width}×{height} pixels, {'relative' if unit is None else unit.told()}", figures, warnings)


def _shared_unit(shots: Sequence[Path], headers: Sequence[exr.Header]) -> Unit | None:
    """Return the unit of all shots; shots of different units make no map."""
    units = [unit_of(shot, header.attributes) for shot, header in zip(shots, headers, strict=True)]
    for shot, unit in zip(shots, units, strict=True):
        if (unit is None) != (units[0] is None):
            words = ["relative" if u is None else "in cd/m²" for u in (unit, units[0])]
            raise EnvcalError(
                f"{shot}: is {words[0]}, but {shots[0]} is {words[1]}; the shots of a map have one unit. Balance all of them with "
                "the same profile."
            )
    return units[0]
