"""Read a lat-long map, .exr or .hdr, whoever made it."""

from __future__ import annotations

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
    """A lat-long map: `image` [height, 2·height, 3] linear RGB in `space`, as it was named by `said_by`; `unit` None: relative."""

    path: Path
    image: npt.NDArray[np.float32]
    space: str
    said_by: str
    unit: Unit | None = None


def read_map(path: Path, *, space: str | None = None) -> Map:
    """Read a map; without chromaticities in its header it is linear sRGB unless `space` says otherwise."""
    unit = None
    if path.suffix.lower() == ".hdr":
        image, chromaticities = read_hdr(path)
    elif path.suffix.lower() == ".exr":
        header, image = exr.read_rgb(path)
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
    return Map(path, image, provenance.space_of(path, chromaticities, asked=space), said_by, unit)
