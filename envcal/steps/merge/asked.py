"""What the settings of the merge ask for, in the words of `calibrate`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from envcal.config import MergeSettings
from envcal.errors import EnvcalError

if TYPE_CHECKING:
    from calibrate.merge import Asked
    from envcal.raw import RawFrame


def rooted(settings: MergeSettings, folder: Path) -> MergeSettings:
    """Return the settings with their paths starting from `folder`."""
    named = {
        "dark_frame": settings.dark_frame,
        "flat_field": settings.flat_field,
        "lens_database": settings.lens_database,
    }
    return settings.model_copy(update={key: folder / path for key, path in named.items() if path is not None})


def refuse_unknown_names(settings: MergeSettings, shots: Mapping[str, Sequence[Path]]) -> None:
    """Raise an `EnvcalError` for every frame that the settings name and no shot has."""
    names = {path.name for frames in shots.values() for path in frames}
    mistakes = [
        f"merge.{key}.{name}: no frame of any shot has this name. Correct it; the name is that of the file, without its folder."
        for key, given in (("exposures", settings.exposures), ("filters", settings.filters))
        for name in given
        if name not in names
    ]
    if mistakes:
        raise EnvcalError("\n".join(mistakes))


def changes_of(name: str, settings: MergeSettings) -> dict[str, Any]:
    """Return what the settings know better than a frame's file."""
    changes: dict[str, Any] = {}
    if name in settings.exposures:
        changes["exposure_s"] = Fraction(settings.exposures[name]).limit_denominator(10**9)
    if name in settings.filters:
        through = settings.filters[name]
        changes["transmission"] = through if isinstance(through, tuple) else (through,) * 3
    return changes


def asked_of(settings: MergeSettings, raws: Sequence[RawFrame]) -> Asked:
    """Return what is to be measured of a bracket, and what a person knows better."""
    from calibrate.merge import Asked
    from envcal.raw import read_mosaic

    return Asked(
        clip=settings.white_level,
        black=settings.black_level,
        dark=None if settings.dark_frame is None else read_mosaic(settings.dark_frame),
        exposures=settings.exposure_ratios,
        known=frozenset(raw.info.name for raw in raws if raw.path.name in settings.exposures),
        gain_e_per_dn=settings.gain_e_per_dn,
        read_noise_e=settings.read_noise_e,
        mixed_aperture=settings.mixed_aperture,
    )
