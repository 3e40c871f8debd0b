"""lights.json: the clusters of a map and the light of each, for people, and for the uplift that follows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from envcal.errors import EnvcalError

if TYPE_CHECKING:
    from uplift.lights import Light


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)


class LightRecord(_Part):
    """One light of the map."""

    cluster: int
    type: str
    name: str = ""
    cct: float | None
    """Kelvin, of the light: of its spectrum if that was declared, measured or follows from its kind, else `cct_seen`;
    null where there is none."""
    duv: float | None
    emission_cct: float | None = None
    """Kelvin, of `emission`. Of a light of unknown kind (`smooth`, not declared) it stands half-way between `cct` and D65."""
    emission_duv: float | None = None
    cct_seen: float | None
    """Kelvin, of the light itself: of its colour in the map."""
    cct_sigma: float | None
    """Standard deviation of `cct_seen`, from the spread of the evidence."""
    duv_seen: float | None
    duv_sigma: float | None = None
    """Standard deviation of `duv_seen`."""
    outdoor: bool
    share: float
    """Of the map's luminance × solid angle."""
    at: tuple[float, float]
    """u, v of its brightest region."""
    source: str
    """How the spectrum was found."""
    confidence: float
    declared: bool
    kinds: dict[str, float] = Field(default_factory=dict, max_length=16)
    """Probability of each kind of lamp, from sky and colour, or from a chart; it sums to 1."""
    remedy: str
    """What a person could do to make it surer."""
    emission: list[float]
    """Spectrum, Σ ȳ·E·Δλ = 1."""


class Lights(_Part):
    """The lights of a map."""

    format: Literal[1] = 1
    wavelengths: str
    """start:stop:step in nm of the emissions."""
    observer: str
    space: str
    sky: bool
    """Whether the map shows the sky."""
    lights: list[LightRecord] = Field(max_length=64)


def record(light: Light) -> LightRecord:
    """Return the record of a light."""
    import math

    def finite(value: float) -> float | None:
        return float(value) if math.isfinite(value) else None

    unknown = light.type == "smooth" and not light.declared
    return LightRecord(
        cluster=light.cluster,
        type=light.type,
        name=light.name,
        cct=finite(light.cct_seen if unknown else light.cct),
        duv=finite(light.duv_seen if unknown else light.duv),
        emission_cct=finite(light.cct),
        emission_duv=finite(light.duv),
        cct_sigma=finite(light.cct_sigma),
        cct_seen=finite(light.cct_seen),
        duv_seen=finite(light.duv_seen),
        duv_sigma=finite(light.duv_sigma),
        kinds={kind: float(value) for kind, value in light.kinds.items()},
        outdoor=light.outdoor,
        share=light.share,
        at=light.at,
        source=light.source,
        confidence=light.confidence,
        declared=light.declared,
        remedy=light.remedy,
        emission=[float(v) for v in light.emission],
    )


def parse(value: Any, *, place: Path) -> Lights:
    """Read lights from parsed JSON; an `EnvcalError` names what is wrong."""
    try:
        return Lights.model_validate(value)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise EnvcalError(
            f"{place}: its lights are damaged: {where}: {first['msg']}. Run `envcal cluster` again."
        ) from None


def summary(lights: Sequence[LightRecord]) -> str:
    """One line about all lights."""
    parts = [f"{_kind_of(light)} ({light.share:.0%})" for light in lights]
    return f"{len(lights)} light{'s' if len(lights) != 1 else ''}: " + ", ".join(parts)


def _kind_of(light: LightRecord) -> str:
    kind = "of unknown kind" if light.type == "smooth" and not light.declared else light.type
    return f"{kind} {light.cct:.0f} K" if light.cct else kind
