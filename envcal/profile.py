"""The calibration profile: what was learned on the reference shot, to be applied to other shots of the same camera.

One JSON file. `correct` finds the chart and starts it, `balance` finds the lamp and completes it. Applying it is one
3×3 matrix (and root terms, where such a fit was asked for): camera RGB → working RGB whose (1, 1, 1) is the D65 lamp.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from envcal import __version__, atomic
from envcal.errors import EnvcalError
from envcal.unit import Unit

Row = tuple[float, float, float]
Matrix = tuple[Row, Row, Row]
MOST_BYTES = 1 << 22


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)


class Camera(_Part):
    """The camera of the reference shot; a profile fits no other one."""

    model: str
    lens: str
    iso: float | None
    f_number: float | None
    focal_length_mm: float | None = None


class Patch(_Part):
    """One patch of the chart as the camera saw it."""

    name: str
    camera_rgb: Row
    """Mean, camera RGB."""
    noise: Row
    """Standard error of the mean."""
    pixels: int
    light: float
    """Light on the patch; the geometric mean over the chart is 1."""
    left_out: bool = False
    """Whether it was spoilt, and has no part in the fit."""
    target_rgb: Row
    """Published colour under D65 in linear working RGB."""
    fitted_rgb: Row
    delta_e: float
    """CIEDE2000 of the fit."""
    delta_e_left_out: float
    """CIEDE2000 when the fit has not seen this patch."""
    reflectance: list[float] = Field(default_factory=list)
    """As measured, at the chart's `wavelengths_nm`; empty where only colours are known."""


class OtherChart(_Part):
    """A further chart in the reference shot, under the fit of the first."""

    corners: list[tuple[float, float]]
    """Pixels of the reference shot, as of the first."""
    score: float
    """Mean CIEDE2000 of a fit of its own."""
    delta_e: float
    """Mean CIEDE2000 of its patches under the first one's fit, the brightness of its light and a fall-off taken out."""
    delta_e_balanced: float
    """The same, the colour of its light taken out too."""
    level: float
    """How bright the light on it is, relative to that on the first."""
    light_uv: float
    """How far the colours of the two lights are apart in u'v'."""


class Chart(_Part):
    """Where the chart was and what was fitted to it."""

    reference: str
    found: Literal["auto", "settings"]
    corners: list[tuple[float, float]]
    """Pixels of the reference shot: top left (dark skin), top right, bottom right, bottom left."""
    quads: list[list[tuple[float, float]]]
    """The sampled part of each patch."""
    cost: float | None = None
    """Of the detector, in profiles of earlier versions."""
    score: float | None = None
    """Mean CIEDE2000 by which the chart was known; None for corners from the settings."""
    fit: str
    patches: list[Patch]
    wavelengths_nm: list[float] = Field(default_factory=list)
    """Of the patches' reflectances, where a file of measured ones was given."""
    others: list[OtherChart] = Field(default_factory=list)
    """Further charts that were found; they have no part in the fit."""

    @property
    def white(self) -> Patch:
        """The brightest patch that was not spoilt."""
        usable = [patch for patch in self.patches if not patch.left_out] or self.patches
        return max(usable, key=lambda patch: sum(patch.target_rgb))


class Lamp(_Part):
    """Where the lamp was and what it read."""

    found: Literal["auto", "settings", "pair"]
    """By a search, named by the settings, or lit between two brackets."""
    polygon: list[tuple[float, float]]
    pixels: int
    clipped: int
    rgb: Row
    """Working RGB before the balance."""
    noise: Row
    transform: str
    """Cone space, or `camera RGB` where the matrix comes from the camera's sensitivities."""
    luminance: str
    cone_gains: Row
    """Gains along the axes of that space."""
    spectrum: str | None = None
    """File of the lamp's measured spectrum; None: D65."""
    camera: str | None = None
    """Sensitivities the matrix comes from, `estimated` if from chart and lamp; None: the matrix is the chart's."""


class ChartLight(_Part):
    """The light on the chart, as the chart measured it."""

    camera: str
    """Whose sensitivities were used; empty: unknown, fitted together with the light."""
    camera_loss: float
    """How many times larger the standard deviation is for not knowing the camera."""
    camera_unlikely: float | None = None
    """How far the camera estimated is from what cameras are like: mean square of standard deviations, 1 is common."""
    sensitivities: list[Row] = Field(default_factory=list)
    """Of the camera, given or estimated, at `wavelengths_nm`; each channel's response to the lamp is 1."""
    wavelengths_nm: list[float]
    emission: list[float]
    """Relative spectral power to be used, Y = 1."""
    sigma: list[float]
    """Standard deviation of `emission`."""
    measured: list[float] = Field(default_factory=list)
    """What the chart measured, Y = 1, before a smooth spectrum was mixed in; empty in profiles of earlier versions."""
    trusted: float | None = Field(default=None, ge=0, le=1)
    """Share of `measured` in `emission`, the rest being smooth; null in profiles of earlier versions."""
    readings: list[Row] = Field(default_factory=list)
    """Camera RGB of each patch, without the fall-off, over that of the lamp: what was fitted."""
    fitted: list[Row] = Field(default_factory=list)
    """What the fit says they should have read."""
    cct: float | None
    """Kelvin."""
    duv: float | None
    cct_sigma: float
    duv_sigma: float
    families: dict[str, float]
    """Probability of each family of lamps."""
    chi2: float
    """Misfit of the patches per degree of freedom."""
    refused: str
    """Why it must not be used; empty: it may."""

    @property
    def family(self) -> str:
        """The most probable family."""
        return max(self.families, key=lambda name: self.families[name])


class Profile(_Part):
    """Camera RGB → working RGB, and how it was found."""

    format: Literal[1, 2] = 2
    """1, which has neither root terms nor the chart's light, is read too."""
    envcal: str = __version__
    working_space: str
    camera: Camera
    reference_shot: str
    """File name of the merged reference."""
    reference_digest: str
    """SHA-256 of the merged reference."""
    chart: Chart
    matrix: Matrix
    """Working RGB from camera RGB; 1 is a perfect white diffuser at the chart."""
    root_terms: Matrix | None = None
    """Working RGB from √rg, √gb, √br of camera RGB, to be added to that from r, g, b; None for a linear fit."""
    lamp: Lamp | None = None
    balance_matrix: Matrix | None = None
    """Balanced working RGB from working RGB; (1, 1, 1) is the lamp."""
    light: ChartLight | None = None
    """The light on the chart; null if it was not measured."""
    unit: Unit | None = None
    """cd/m² of the balanced image's (1, 1, 1), by which `balance` multiplies; null: it stays relative."""
    warnings: list[str] = Field(default_factory=list)

    def full_matrix(self) -> npt.NDArray[np.float64]:
        """The chart's matrix [3, 3], or [3, 6] with root terms, as `calibrate.correct.apply_matrix` takes it."""
        linear = np.asarray(self.matrix, np.float64)
        return linear if self.root_terms is None else np.hstack([linear, np.asarray(self.root_terms, np.float64)])

    def delta_e(self) -> dict[str, float]:
        """Mean and largest CIEDE2000 of the patches, fitted and left out."""
        fitted = [patch.delta_e for patch in self.chart.patches]
        left_out = [patch.delta_e_left_out for patch in self.chart.patches]
        return {
            "mean": round(float(np.mean(fitted)), 4),
            "max": round(max(fitted), 4),
            "left_out_mean": round(float(np.mean(left_out)), 4),
            "left_out_max": round(max(left_out), 4),
        }

    def write(self, path: Path) -> None:
        """Write the profile as JSON, whole or not at all."""
        atomic.write_text(path, self.model_dump_json(indent=1) + "\n")


def read(path: Path) -> Profile:
    """Read a profile; an `EnvcalError` names what is wrong with it."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise EnvcalError(f"{path}: is larger than {MOST_BYTES >> 20} MiB; that is no profile.")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise EnvcalError(
            f"{path}: cannot be read ({error.strerror}). Give the profile.json of a calibration."
        ) from error
    except UnicodeDecodeError as error:
        raise EnvcalError(f"{path}: is not a profile: not UTF-8 text. Make it again with `envcal correct`.") from error
    return parse(text, place=str(path))


def parse(text: str, *, place: str) -> Profile:
    """Read a profile from JSON text; `place` names it in messages."""
    try:
        return Profile.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        raise EnvcalError(
            f"{place}: is not a profile: {where}: {first['msg']}{more}. Make it again with `envcal correct` and "
            f"`envcal balance`."
        ) from None


def mismatches(profile: Profile, camera: Camera) -> list[str]:
    """Return a warning for each way in which a shot's camera is not the profile's."""
    theirs, sure = profile.camera, exposure_gain(profile, camera) is not None
    iso = "radiance was scaled by their nominal ratio, good to some per cent" if sure else _UNSCALED
    aperture = "radiance was scaled by the square of their nominal ratio, good to 15 %" if sure else _UNSCALED
    zoomed = "the fall-off changes, and with some zooms the light"
    effects = (
        ("camera", theirs.model, camera.model, "its colours are wrong"),
        ("lens", theirs.lens, camera.lens, "its colours, its fall-off and the light it lets through may be others"),
        ("ISO", theirs.iso, camera.iso, iso),
        ("f-number", theirs.f_number, camera.f_number, f"{aperture}; the fall-off changes too"),
        # Profiles of earlier versions do not tell theirs.
        ("focal length", theirs.focal_length_mm or camera.focal_length_mm, camera.focal_length_mm, zoomed),
    )
    return [
        f"the profile was made with {word} {_said(expected)}, this shot with {_said(value)}: {effect}. "
        f"Photograph a reference with the same {word}."
        for word, expected, value, effect in effects
        if not _alike(expected, value)
    ]


#: What is said where one of the shots does not tell: then nothing can be scaled.
_UNSCALED = "radiance is off by their unknown ratio"
#: Lenses report their focal length to this share.
_SAME_LENGTH = 0.02


def exposure_gain(profile: Profile, camera: Camera) -> float | None:
    """Return by what a shot's radiance is multiplied to be in the profile's unit; None where it cannot be known."""
    from calibrate.photometry import exposure_gain as gain

    return gain(
        iso=camera.iso,
        f_number=camera.f_number,
        reference_iso=profile.camera.iso,
        reference_f_number=profile.camera.f_number,
    )


def _alike(expected: str | float | None, value: str | float | None) -> bool:
    if isinstance(expected, float) and isinstance(value, float):
        return abs(value - expected) <= _SAME_LENGTH * expected
    return expected == value


def _said(value: str | float | None) -> str:
    return f"{value:g}" if isinstance(value, float) else value or "unknown"


def matrix_rows(matrix: npt.NDArray[Any]) -> Matrix:
    """A 3×3 array as nested tuples of floats."""
    a, b, c = np.asarray(matrix)
    return (row(a), row(b), row(c))


def row(values: Any) -> Row:
    """Three numbers as a tuple of floats."""
    x, y, z = (float(v) for v in values)
    return (x, y, z)
