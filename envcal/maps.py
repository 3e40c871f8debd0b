"""Read a lat-long map, .exr or .hdr, whoever made it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from envcal import exr, provenance
from envcal.errors import EnvcalError
from envcal.hdr import read_hdr
from envcal.unit import Unit, unit_of


@dataclass(frozen=True, slots=True)
class Map:
    """A lat-long map: `image` [height, 2·height, 3] linear RGB in `space`, as it was named by `said_by`; `unit` None: relative.

    `photographed`: made by this program of brackets, so that NaN is what was clipped in every frame.
    """

    path: Path
    image: npt.NDArray[np.float32]
    space: str
    said_by: str
    unit: Unit | None = None
    photographed: bool = False


def read_map(path: Path, *, space: str | None = None) -> Map:
    """Read a map; without chromaticities in its header it is linear sRGB unless `space` says otherwise."""
    unit, photographed = None, False
    if path.is_dir():
        raise EnvcalError(f"{path}: is a folder; a map, .exr or .hdr, is expected.{_map_in(path)}")
    if path.suffix.lower() == ".hdr":
        image, chromaticities = read_hdr(path)
    elif path.suffix.lower() == ".exr":
        _refuse_what_came_of_a_map(path)
        header, image = exr.read_rgb(path)
        photographed = header.attributes.get("envcalStage") in _OF_PHOTOGRAPHS
        chromaticities, unit = header.chromaticities, unit_of(path, header.attributes)
        if header.attributes.get("envcalSpace") == provenance.CAMERA_RGB and space is None:
            raise EnvcalError(
                f"{path}: is in camera RGB, which has no meaning yet. Run `envcal correct` and `envcal balance` on it, "
                f"or name its space with --space."
            )
    else:
        raise EnvcalError(f"{path}: is neither .exr nor .hdr. Convert the map to one of them.")
    height, width = image.shape[:2]
    if width != 2 * height:
        raise EnvcalError(
            f"{path}: {width}×{height} pixels; a lat-long map is exactly twice as wide as high. Crop or remap it."
        )
    said_by = "--space" if space else "its chromaticities" if chromaticities else "default"
    return Map(path, image, provenance.space_of(path, chromaticities, asked=space), said_by, unit, photographed)


_OF_PHOTOGRAPHS = ("balance", "panorama")
#: Stage → what its file is, and what to do with it.
_MADE_OF_MAPS = {
    "cluster": (
        "what `envcal cluster` found in a map, and no map",
        "Give the map itself; `envcal uplift` takes this file besides, with --clusters.",
    ),
    "uplift": (
        "an uplift file already, and no map",
        "`envcal spectra`, `envcal export` and `envcal mitsuba` go on with it; to uplift anew, give the map it was made of.",
    ),
    "spectra": (
        "a spectral image already, and no map",
        "Renderers that read spectral EXR take it as it is; to uplift anew, give the map it was made of.",
    ),
}


def _refuse_what_came_of_a_map(path: Path) -> None:
    """Refuse files of the later stages, which carry the map's R, G and B along and would pass for it."""
    attributes = exr.header(path).attributes
    stage = attributes.get("envcalStage")
    if stage not in _MADE_OF_MAPS:
        return
    what, remedy = _MADE_OF_MAPS[stage]
    try:
        made_of = [name for name in json.loads(str(attributes.get("envcalInputs", "{}"))) if name != path.name]
    except ValueError:
        made_of = []
    raise EnvcalError(f"{path}: is {what}{f' (made of {made_of[0]})' if made_of else ''}. {remedy}")


def _map_in(folder: Path) -> str:
    """The map of a folder that a run left, or its only image, as a remedy."""
    images = [path for path in sorted(folder.iterdir()) if path.suffix.lower() in (".exr", ".hdr") and path.is_file()]
    of_run = folder / "panorama" / "environment.exr"
    one = of_run if of_run.is_file() else images[0] if len(images) == 1 else None
    return " Give the file in it." if one is None else f" Give {one}."


#: So many places of pixels are named in a message.
NAMED = 3


def places_told(places: Sequence[tuple[int, int]], count: int) -> str:
    """The first of `count` pixels in words, of their (row, column)s."""
    told = "; ".join(f"x {column}, y {row}" for row, column in places[:NAMED])
    return told if count <= min(len(places), NAMED) else f"the first at {told}"


def lost_told(source: Map) -> str | None:
    """What is wrong with a map of which pixels are lost, for who looks for lights in it; None if none is."""
    lost = ~np.isfinite(source.image).all(axis=2)
    count = int(lost.sum())
    if not count:
        return None
    if source.photographed:
        return (
            f"{count / lost.size:.2%} of the map is lost (clipped in every frame), and lamps are the first to be: the lights "
            f"found may be others than those of the place. Add a shorter exposure to the bracket."
        )
    first = [
        (int(row), int(column))
        for row, column in zip(*np.unravel_index(np.flatnonzero(lost)[:NAMED], lost.shape), strict=True)
    ]
    return (
        f"{count} pixel{'s' if count > 1 else ''} ({places_told(first, count)}): NaN or infinite in the file; no light was looked for "
        f"there. If a lamp stood there, write the map again with its values."
    )
