"""The unit of an image's radiance: relative, or cd/m², with where that comes from.

In cd/m² the pixels are such that luminance, the weighted sum of R, G and B, is in cd/m²: (1, 1, 1) is 1 cd/m².
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from envcal.errors import EnvcalError

RELATIVE = "relative"
CANDELAS = "cd.m^-2"
#: Of the bands of a spectral image in absolute units.
WATTS = "W.m^-2.sr^-1.nm^-1"
ATTRIBUTE = "envcalUnit"


class Unit(BaseModel):
    """Radiance in cd/m²: how a relative image came to be multiplied."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)

    name: Literal["cd.m^-2"] = "cd.m^-2"
    factor: float = Field(gt=0)
    """cd/m² of what was 1 before: the lamp, or a white diffuser at the chart."""
    source: str
    """Where the factor comes from."""
    likely: tuple[float, float] | None = None
    """The true luminance lies between these multiples of what is written; null: as good as the reading."""

    def told(self) -> str:
        """The unit in words."""
        if self.likely is None:
            return f"cd/m², from {self.source}"
        low, high = self.likely
        return f"cd/m², from {self.source}; the truth lies between {low:g} and {high:g} times that"


def attributes(unit: Unit | None) -> dict[str, Any]:
    """Return the header attributes that say the unit; None is relative."""
    if unit is None:
        return {"unit": RELATIVE}
    # whiteLuminance is OpenEXR's own: cd/m² of (1, 1, 1).
    return {"unit": CANDELAS, "whiteLuminance": 1.0, ATTRIBUTE: unit.model_dump(mode="json")}


def unit_of(path: Path, header: Mapping[str, Any]) -> Unit | None:
    """Return the unit that a header says; None is relative, which a header that says nothing means too."""
    import json

    if header.get("unit") != CANDELAS:
        return None
    text = header.get(ATTRIBUTE)
    if text is None:
        return Unit(factor=1.0, source="the header of the file it was made of")
    try:
        return Unit.model_validate(json.loads(str(text)))
    except (ValidationError, ValueError) as error:
        first = str(error).splitlines()[0]
        raise EnvcalError(f"{path}: `{ATTRIBUTE}` in its header is damaged ({first}). Make the file again.") from None
