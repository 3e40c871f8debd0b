"""What a file says of its making: stage, version, settings and digests of inputs; never a time or a place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from envcal import __version__
from envcal import unit as units
from envcal.atomic import digest
from envcal.errors import EnvcalError

#: What `R`, `G` and `B` are before the chart has been seen.
CAMERA_RGB = "camera RGB"


def attributes(
    stage: str,
    *,
    settings: Mapping[str, Any],
    inputs: Sequence[Path],
    digests: Mapping[Path, str] | None = None,
    unit: units.Unit | None = None,
) -> dict[str, Any]:
    """Return the header attributes of a file that `stage` makes of `inputs` under `settings`; `unit` None is relative."""
    known = digests or {}
    return {
        "envcalStage": stage,
        "envcalVersion": __version__,
        "envcalSettings": dict(settings),
        "envcalInputs": {path.name: known.get(path) or digest(path) for path in inputs},
        **units.attributes(unit),
    }


def colour_space(name: str) -> dict[str, Any]:
    """Return the header attributes that say which linear RGB space the pixels are in."""
    from uplift.spectrum import rgb_space

    if name == CAMERA_RGB:
        return {"envcalSpace": CAMERA_RGB}
    space = rgb_space(name)
    xy = [*space.primaries_xy.ravel().tolist(), *space.white_xy.ravel().tolist()]
    return {"envcalSpace": name, "chromaticities": tuple(float(v) for v in xy)}


#: Chromaticities closer than this to a known space's are that space's: published values have four digits.
_SAME_XY = 1e-3


def space_of(path: Path, chromaticities: Sequence[float] | None, *, asked: str | None) -> str:
    """Return the name of the RGB space of a map from its chromaticities, from what was asked, or linear sRGB."""
    from uplift.spectrum import RGB_SPACES, rgb_space

    if asked is not None:
        return asked
    if chromaticities is None:
        return "sRGB"
    for name in RGB_SPACES:
        space = rgb_space(name)
        xy = [*space.primaries_xy.ravel(), *space.white_xy.ravel()]
        if max(abs(float(a) - float(b)) for a, b in zip(xy, chromaticities, strict=True)) < _SAME_XY:
            return name
    listed = ", ".join(f"{v:.4f}" for v in chromaticities)
    raise EnvcalError(
        f"{path}: its chromaticities ({listed}) are those of none of {', '.join(RGB_SPACES)}. Convert the map to one "
        f"of them, or say which one it is in with --space."
    )
