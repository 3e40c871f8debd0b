"""The uplift file: one EXR that anybody can read, and that is all a renderer needs.

Channels c0, c1, c2 and scale (float32), cluster (uint32: which emission), status (uint32: how the pixel was solved) and
R, G, B for a preview; the header's `envcalUplift` holds the wavelength grid and the emissions as JSON. Radiance at a
wavelength λ in nm is scale · E_cluster(λ) · S(c0 λ² + c1 λ + c2) with S(x) = ½ + x/(2√(1 + x²)).
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from envcal import exr
from envcal.errors import EnvcalError

CHANNELS = dict.fromkeys(("c0", "c1", "c2", "scale", "R", "G", "B"), "f4") | {"cluster": "u4", "status": "u4"}
ATTRIBUTE = "envcalUplift"


class Emission(BaseModel):
    """The light of one cluster."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    type: str
    cct: float | None
    duv: float | None
    source: str
    confidence: float
    emission: list[float]


class About(BaseModel):
    """What the header says."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    format: Literal[1] = 1
    method: str
    model: str = "scale * E[cluster](w) * S(c0*w*w + c1*w + c2), S(x) = 1/2 + x / (2*sqrt(1 + x*x)), w in nm"
    space: str
    observer: str
    wavelengths_nm: list[float]
    clusters: list[Emission] = Field(max_length=64)
    status: dict[str, str]

    def emissions(self) -> npt.NDArray[np.float64]:
        """The emissions [clusters, wavelengths]; Σ ȳ·E·Δλ = 1."""
        return np.asarray([cluster.emission for cluster in self.clusters], np.float64)


def read_about(path: Path) -> tuple[exr.Header, About]:
    """Read what an uplift file says of itself."""
    header = exr.header(path)
    absent = [name for name in CHANNELS if name not in header.channels and name != "status"]
    if absent or ATTRIBUTE not in header.attributes:
        what = f"no channel {', '.join(absent)}" if absent else f"no `{ATTRIBUTE}` in its header"
        raise EnvcalError(
            f"{path}: is not an uplift file: it has {what}. Make one with `envcal uplift MAP -o {path.name}`."
        )
    try:
        about = About.model_validate(header.json(ATTRIBUTE))
        if any(len(cluster.emission) != len(about.wavelengths_nm) for cluster in about.clusters):
            raise ValueError("an emission has not one value per wavelength")
    except (ValidationError, ValueError) as error:
        first = str(error).splitlines()[0]
        raise EnvcalError(
            f"{path}: its `{ATTRIBUTE}` is damaged ({first}). Make it again with `envcal uplift`."
        ) from None
    return header, about
