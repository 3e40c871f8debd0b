"""The lens's fall-off of light: of a known lens, measured on a flat field, or declared."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from envcal.config import MergeSettings

if TYPE_CHECKING:
    from calibrate.exposure import FrameInfo
    from calibrate.lens import Vignetting


def fall_off(
    settings: MergeSettings, infos: Sequence[FrameInfo]
) -> tuple[Vignetting | None, Mapping[str, Any] | None, list[str]]:
    """Return the lens's fall-off, the lens where it is known from the database, and what a person should know."""
    if settings.lens == "off":
        return _own_vignetting(settings), None, []
    from envcal.lens_data import UnknownLensError, known_lens

    asked = None if isinstance(settings.lens, str) else settings.lens
    try:
        apertures = sorted({info.f_number for info in infos if info.f_number})
        if len(apertures) > 1:
            raise UnknownLensError(
                f"{infos[0].name}: the bracket has apertures from f/{apertures[0]:g} to f/{apertures[-1]:g}, and the fall-off is another at "
                "each; one aperture is expected. Set `merge.lens: off`, or photograph with one aperture."
            )
        found = known_lens(infos[0], asked, database=settings.lens_database)
    except UnknownLensError as error:
        if settings.lens != "auto":
            raise
        return None, None, [f"merge.lens auto: no fall-off was taken out. {error}"]
    lens = dataclasses.asdict(found)
    return lens.pop("vignetting"), lens, list(lens.pop("warnings"))


def _own_vignetting(settings: MergeSettings) -> Vignetting | None:
    if settings.flat_field is not None:
        from calibrate.lens import measure_vignetting
        from envcal.raw import read_frame

        info, mosaic = read_frame(settings.flat_field)
        return measure_vignetting(mosaic, info)
    given = settings.vignetting
    if given is None:
        return None
    first, second, third = given
    if isinstance(first, tuple) and isinstance(second, tuple) and isinstance(third, tuple):
        return first, second, third
    assert not (isinstance(first, tuple) or isinstance(second, tuple) or isinstance(third, tuple))
    return ((first, second, third),) * 3
