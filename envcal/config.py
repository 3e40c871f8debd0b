"""pipeline.yaml → frozen settings. Every mistake is reported at once, with file and line.

YAML is read by ruamel.yaml in its round-trip mode: no tag constructs an object, a key given twice is a mistake and
every value keeps its line.
"""

from __future__ import annotations

import difflib
import io
import itertools
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic.fields import FieldInfo

from envcal.errors import EnvcalError

#: A settings file longer than this is not one.
MOST_BYTES = 1 << 20

WorkingSpace = Literal["ITU-R BT.2020", "sRGB", "P3-D65", "ACEScg", "ACES2065-1", "Adobe Wide Gamut RGB"]
LIGHT_TYPES = ("daylight", "sunset", "led", "fluorescent", "incandescent", "smooth")
#: What else people call them.
OTHER_NAMES = {"tungsten": "incandescent", "halogen": "incandescent", "bulb": "incandescent", "tube": "fluorescent"}
#: Lamps whose spectra the CIE publishes, as colour-science names them.
CIE_LAMP = re.compile(r"(FL([1-9]|1[0-2])|FL3\.([1-9]|1[0-5])|HP[1-5]|LED-(B[1-5]|BH1|RGB1|V1|V2))")
Indoor = Literal["auto", "led", "fluorescent", "incandescent"]


def parse_wavelengths(text: str) -> tuple[float, float, float]:
    """Return (start, stop, step) in nm of a text such as `380:780:5`; ValueError with a remedy otherwise."""
    try:
        start, stop, step = (float(part) for part in text.split(":"))
    except ValueError:
        raise ValueError(f"{text!r} is not start:stop:step in nm, such as 380:780:5") from None
    if not (360 <= start < stop <= 830 and 1 <= step <= 50):
        raise ValueError(f"{text!r} should rise within 360 to 830 nm in steps of 1 to 50 nm, such as 380:780:5")
    if abs((stop - start) / step - round((stop - start) / step)) > 1e-9:
        raise ValueError(f"{text!r}: the steps do not end on {stop:g} nm; change the step or an end")
    return start, stop, step


def parse_bands(text: str) -> tuple[float, ...]:
    """Return wavelengths in nm: a grid such as `380:780:5`, or a list such as `450,532.5,650`; else a ValueError."""
    if ":" in text:
        start, stop, step = parse_wavelengths(text)
        count = round((stop - start) / step) + 1
        return tuple(start + (stop - start) * k / (count - 1) for k in range(count))
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{text!r} is neither start:stop:step nor a list of nm, such as 450,532.5,650") from None
    apart = all(upper - lower >= 1e-3 for lower, upper in itertools.pairwise(values))
    if not apart or not all(360 <= value <= 830 for value in values):
        raise ValueError(f"{text!r} should rise within 360 to 830 nm, at least 0.001 apart, such as 450,532.5,650")
    return values


def _bands(text: str) -> str:
    parse_bands(text)
    return text


def _wavelengths(text: str) -> str:
    parse_wavelengths(text)
    return text


def _light_type(text: str) -> str:
    if text not in LIGHT_TYPES and not CIE_LAMP.fullmatch(text):
        near = (
            [OTHER_NAMES[text.lower()]]
            if text.lower() in OTHER_NAMES
            else difflib.get_close_matches(text, LIGHT_TYPES, n=1)
        )
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"{text!r} is no kind of light: {', '.join(LIGHT_TYPES)} or a CIE lamp such as FL11{hint}")
    return text


LightType = Annotated[str, AfterValidator(_light_type)]
Wavelengths = Annotated[str, AfterValidator(_wavelengths)]
Bands = Annotated[str, AfterValidator(_bands)]
Pixel = tuple[float, float]
Share = Annotated[float, Field(ge=0, le=1)]
Frames = str | list[str]


class Settings(BaseModel):
    """Settings are frozen, and an unknown one is a mistake."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True, allow_inf_nan=False)


class CaptureSettings(Settings):
    """Which photographs there are."""

    reference: Frames
    """The RAW bracket with the colour chart and the D65 lamp in view: a pattern such as `shots/*.dng`, or a list."""
    environment: Frames | dict[str, Frames] | None = None
    """The bracket to turn into a map: a pattern or a list, or name → pattern for several shots. Left out: the
    reference itself is the map."""


Level = Annotated[float, Field(gt=0, le=65_535)]
Seconds = Annotated[float, Field(gt=0, le=100_000)]
Transmission = Annotated[float, Field(gt=0, le=1)]
Radiance = Annotated[float, Field(ge=0, le=1e12)]
Power = Annotated[float, Field(ge=-20, le=20)]
Powers = tuple[Power, Power, Power]


class MergeSettings(Settings):
    """RAW bracket → radiance in camera RGB."""

    white_level: Literal["data", "file"] | Level = "data"
    """Where samples count as clipped: `data`, on the plateau that the clipped samples of the longest frame make, never
    above the file's level; `file`; or a number of raw counts."""
    black_level: Literal["data", "file"] = "data"
    """`data`: from masked photosites, else from the bracket itself, where they are sure; `file`: as the files say."""
    dark_frame: Path | None = None
    """A RAW frame taken under the lens cap; its levels are black."""
    exposure_ratios: Literal["data", "file"] = "data"
    """`data`: the light of each frame is fitted to the pixels where that is sure to 0.3 %; `file`: times are believed."""
    exposures: dict[str, Seconds] = {}
    """Name of a frame's file → its true exposure in seconds, where the file is wrong."""
    filters: dict[str, Transmission | tuple[Transmission, Transmission, Transmission]] = {}
    """Name of a frame's file → share of the light that a grey filter lets through: one number, or red, green and blue."""
    mixed_iso: bool = False
    """Let the frames of a bracket differ in ISO; radiance is then in units of the lowest."""
    mixed_aperture: bool = False
    """Let the frames differ in aperture; radiance is then in units of the smallest opening."""
    gain_e_per_dn: Annotated[float, Field(gt=0, le=1000)] | None = None
    """Electrons per raw count at the lowest ISO. Left out: measured on the bracket, or guessed from levels and ISO."""
    read_noise_e: Annotated[float, Field(gt=0, le=1000)] | None = None
    """Read noise in electrons. Left out: measured on the bracket, or 3."""
    deviation: bool = False
    """Write the standard deviation of every sample too."""
    align: bool = False
    """Find frames that were not taken from quite the same place, and shift them; a set from a tripod stays as it is. Bayer
    and monochrome frames."""
    deghost: bool = False
    """Leave frames out where something moved in them, as far as noise does not explain the difference. Bayer and monochrome
    frames."""
    defects: bool = True
    """Replace hot and dead photosites by their neighbours of the same colour."""
    demosaic: Literal["edges", "malvar"] = "edges"
    """`edges`: along edges, in a logarithmic scale, which leaves no coloured rims around lamps; `malvar`: linear filters,
    faster. Bayer mosaics only."""
    lost: Literal["none", "neighbour"] | tuple[Radiance, Radiance, Radiance] = "none"
    """What stands where every frame is clipped: nothing (NaN), the colour of the neighbours at the smallest radiance
    that explains the clipping, or a declared camera RGB, such as the sun's."""

    vignetting: Powers | tuple[Powers, Powers, Powers] | None = None
    """The lens's fall-off 1 + k1 r² + k2 r⁴ + k3 r⁶, r being 1 in the corners: k1, k2, k3, or three of each for red, green
    and blue."""
    flat_field: Path | None = None
    """A RAW frame of an evenly bright surface with the same lens and aperture; the fall-off is measured on it."""

    @property
    def files(self) -> list[Path]:
        """The files that are read besides the frames."""
        return [path for path in (self.dark_frame, self.flat_field) if path is not None]

    @model_validator(mode="after")
    def _one_fall_off(self) -> MergeSettings:
        if self.vignetting is not None and self.flat_field is not None:
            raise ValueError("give either `vignetting` or `flat_field`; not both")
        return self


class CorrectSettings(Settings):
    """Chart found in the reference → camera RGB to working RGB."""

    chart: Literal["auto"] | tuple[Pixel, Pixel, Pixel, Pixel] = "auto"
    """`auto`, or the chart's corners in pixels: top left (dark skin), top right, bottom right, bottom left; the
    corners of the box around the patches with the width of one gap about them."""
    reference: Literal["ColorChecker24 - After November 2014", "ColorChecker24 - Before November 2014"] = (
        "ColorChecker24 - After November 2014"
    )
    """The published data of the chart's patches."""
    patches: Path | None = None
    """The chart's own patches as measured: CSV or CGATS (.ti3) with XYZ, L*a*b* or reflectances of 24 patches, row by row
    from dark skin. Takes the place of `reference`."""
    fit: Literal["linear", "white-preserving", "root-polynomial", "auto"] = "linear"
    """3×3 matrix by least squares, the same with a white met exactly, a root-polynomial of degree 2, or `auto`: that or
    the 3×3 matrix, whichever predicts patches it has not seen better."""
    spoilt: Literal["leave out", "keep"] = "leave out"
    """Whether patches with glare or dirt, which the others' fit misses by far, are left out of the fit."""
    white: Literal["patch", "neutrals"] = "patch"
    """The white that a white-preserving fit meets: the white patch, or the mean of the six neutral ones."""
    weighting: Literal["linear", "lightness"] = "linear"
    """What the fit makes small: errors of radiance, or errors as CIELAB counts them, which favours dark patches."""
    shading: Literal["plane", "none"] = "plane"
    """Whether the light may fall off across the chart; the fall-off is estimated with the matrix."""


class LampRectangle(Settings):
    """Where the lamp is, in pixels of the reference shot."""

    rectangle: tuple[float, float, float, float]
    """x, y, width, height in pixels; inside the lit area."""


class LampOnChart(Settings):
    """Where the lamp is, seen from the chart."""

    chart_rectangle: tuple[float, float, float, float]
    """x, y, width, height; 1 is the chart's width (for x) or height (for y), from its top left corner."""


class BalanceSettings(Settings):
    """Lamp of known spectrum found in the reference → von Kries adaptation."""

    lamp: Literal["auto"] | LampRectangle | LampOnChart = "auto"
    """`auto`, or where the D65 module is."""
    spectrum: Path | None = None
    """CSV of the lamp's own measured spectrum: wavelength in nm, value; one line each. Left out: the lamp is D65."""
    camera: str | None = None
    """The camera's spectral sensitivities: a file (CSV, or JSON as of rawtoaces) or a name that colour-science knows. The
    lamp is then balanced in camera RGB, the matrix comes from the sensitivities instead of from the chart (`correct.fit`
    has to be linear), and the chart measures its light's spectrum with them; left out, that fits the camera along."""
    transform: Literal["CAT16", "Bradford", "CAT02", "Von Kries", "XYZ Scaling", "RGB"] = "CAT16"
    """The cone space in which the gains act."""
    luminance: Literal["lamp", "keep"] = "lamp"
    """`lamp`: the lamp reads exactly as D65 of luminance 1, which is (1, 1, 1) where the working space's white is D65.
    `keep`: only its colour becomes that of D65; 1 stays a white diffuser at the chart."""


class PanoramaSettings(Settings):
    """Shots → one latitude-longitude map."""


class DeclaredLight(Settings):
    """What a person knows of one light."""

    at: tuple[Share, Share]
    """u, v from the top left of the map; the light is that of the cluster there."""
    type: LightType | None = None
    """daylight, sunset, led, fluorescent, incandescent, smooth, or a CIE lamp by name: FL1 to FL12, FL3.1 to FL3.15,
    HP1 to HP5, LED-B1 to LED-B5, LED-BH1, LED-RGB1, LED-V1, LED-V2."""
    cct: Annotated[float, Field(ge=500, le=200_000)] | None = None
    """Correlated colour temperature in kelvin. Left out: taken from the map."""
    spd: Path | None = None
    """Measured spectrum: text of wavelength in nm and value, one line each, or IES TM-27 (`.spdx`); a path, or the name
    of a file in `cluster.library`."""
    name: str = ""
    """A name for the report."""

    @model_validator(mode="after")
    def _says_something(self) -> DeclaredLight:
        if self.spd is not None and (self.type or self.cct):
            raise ValueError("give either `spd`, a measured spectrum, or `type` and `cct`; not both")
        if self.spd is None and self.type is None and self.cct is None:
            raise ValueError("says nothing of the light: give `type`, `cct` or `spd`")
        return self


class ClusterSettings(Settings):
    """Map → sky, clusters, colour temperatures, light spectra."""

    indoor: Indoor = "auto"
    """What undeclared indoor lights are. `auto` does not guess: such a light gets a smooth spectrum of its colour
    temperature, which is the choice that harms least."""
    most: Annotated[int, Field(ge=1, le=6)] = 6
    """The largest number of clusters."""
    estimator: Literal["lamps", "paper"] = "lamps"
    """How clusters and their colour temperatures are found: from the lamps seen directly where they are, or as in the
    paper from all bright pixels and the cluster's mean."""
    library: Path | None = None
    """Folder of measured spectra of your own; a light's `spd` may name one of its files."""
    sky_model: Path | None = None
    """Data file of the Prague sky model (`.dat`); low suns then get the spectra of its skies, not the sun's beam."""
    lights: list[DeclaredLight] = []
    """What is known of the lights."""
    chart_spectrum: Literal["auto", "off"] = "auto"
    """`auto`: a light of the chart's colour gets the spectrum that the chart measured, if it could be. `off`: none does."""
    profiles: list[Path] = []
    """Profiles of further chart shots, each under another light of the place (`envcal correct`, then `envcal balance`)."""


class UpliftSettings(Settings):
    """Map and lights → three coefficients and a scale per pixel."""

    method: Literal["constrained", "scaled", "lattice"] = "constrained"
    """`constrained`: under the emission spectrum of each pixel's light. For comparison, `scaled`: the usual uplift
    under D65, as renderers do it; `lattice`: the paper's own, a mixture of eight spectra a pixel."""
    precision: Literal["exact", "float", "preview"] = "exact"
    """How far the solver goes: to double precision, to ΔE2000 1e-4 or to 0.05; the lower ones are faster."""
    nodes: Annotated[int, Field(ge=8, le=512)] = 64
    """Nodes along a side of the look-up table; it only sets the starting point of the solver."""
    brightness: Annotated[float, Field(ge=1.05, le=64)] = 3.0
    """The brightest component of a pixel is 1/brightness of what a white reflectance would give: 2 in the paper; 3
    relights rooms better under every family of lamps. `constrained` alone; the others keep 2."""


class SpectraSettings(Settings):
    """Coefficients → spectral radiance."""

    wavelengths: Bands = "380:780:10"
    """start:stop:step, or a list such as `450,532.5,650`, in nm, within the grid of the emissions."""
    half: bool = True
    """16-bit floats, half the size; more than 65504 is refused."""


class Pipeline(Settings):
    """The settings of a whole run."""

    capture: CaptureSettings
    output: Path = Path("output")
    """Folder of everything that is written."""
    working_space: WorkingSpace = "ITU-R BT.2020"
    """Linear RGB space of all images after `correct`."""
    wavelengths: Wavelengths = "380:780:5"
    """Grid on which spectra are integrated, start:stop:step in nm."""
    observer: Literal["CIE 1931 2 Degree Standard Observer", "CIE 1964 10 Degree Standard Observer"] = (
        "CIE 1931 2 Degree Standard Observer"
    )
    """The observer under whom spectra have the map's colours."""
    merge: MergeSettings = MergeSettings()
    correct: CorrectSettings = CorrectSettings()
    balance: BalanceSettings = BalanceSettings()
    panorama: PanoramaSettings = PanoramaSettings()
    cluster: ClusterSettings = ClusterSettings()
    uplift: UpliftSettings = UpliftSettings()
    spectra: SpectraSettings = SpectraSettings()

    @model_validator(mode="after")
    def _bands_lie_on_the_grid(self) -> Pipeline:
        low, high, _ = parse_wavelengths(self.wavelengths)
        bands = parse_bands(self.spectra.wavelengths)
        if bands[0] < low or bands[-1] > high:
            raise ValueError(
                f"spectra.wavelengths {self.spectra.wavelengths} leaves the grid {self.wavelengths}, outside which "
                f"no emission is known; narrow it, or widen `wavelengths`"
            )
        return self


@dataclass(frozen=True, slots=True)
class Loaded:
    """A pipeline file as read: its settings, and the frames of each shot, every path absolute."""

    path: Path
    settings: Pipeline
    output: Path
    reference: tuple[Path, ...]
    environments: Mapping[str, tuple[Path, ...]]
    lights: tuple[DeclaredLight, ...]

    @property
    def folder(self) -> Path:
        """The folder of the file, from which its relative paths start."""
        return self.path.resolve().parent

    @property
    def shots(self) -> dict[str, tuple[Path, ...]]:
        """Shot name → frames, the reference first."""
        return {"reference": self.reference, **self.environments}


def schema() -> str:
    """The JSON schema of pipeline.yaml, for editors."""
    return json.dumps(Pipeline.model_json_schema(), indent=1, ensure_ascii=False) + "\n"


def load(path: Path, *, overrides: Sequence[str] = ()) -> Loaded:
    """Read a pipeline file; `overrides` are `key.key=value` with the value in YAML, as `--set` gives them.

    Relative paths in the file start from the file's own folder. Raises an `EnvcalError` listing every mistake.
    """
    tree = _read_yaml(path)
    if tree is None or not isinstance(tree, dict):
        raise EnvcalError(f"{path}: holds no settings; at least `capture: {{reference: shots/*.dng}}` is needed.")
    set_by: dict[tuple[str, ...], str] = {}
    for text in overrides:
        set_by[_override(tree, text)] = text
    try:
        settings = Pipeline.model_validate(_plain(tree))
    except ValidationError as error:
        raise EnvcalError("\n".join(_mistakes(path, tree, error, set_by))) from None
    return _resolve(path, tree, settings)


def load_lights(path: Path, library: Path | None = None) -> tuple[DeclaredLight, ...]:
    """Read a `lights.yaml`: `lights: [...]`, as under `cluster` in a pipeline file."""

    class Lights(Settings):
        lights: list[DeclaredLight]

    tree = _read_yaml(path)
    try:
        found = Lights.model_validate(_plain(tree) if isinstance(tree, dict) else {})
    except ValidationError as error:
        raise EnvcalError("\n".join(_mistakes(path, tree, error, {}, model=Lights))) from None
    return tuple(_rooted(light, path.parent, library) for light in found.lights)


def _rooted(light: DeclaredLight, folder: Path, library: Path | None) -> DeclaredLight:
    from envcal.spd import resolved

    if light.spd is None:
        return light
    return light.model_copy(update={"spd": resolved(folder / light.spd, library)})


def _read_yaml(path: Path) -> Any:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        if path.stat().st_size > MOST_BYTES:
            raise EnvcalError(f"{path}: is larger than {MOST_BYTES >> 20} MiB; that is no settings file.")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise EnvcalError(f"{path}: cannot be read ({error.strerror}). Give the path of a pipeline.yaml.") from error
    except UnicodeDecodeError as error:
        raise EnvcalError(
            f"{path}: is not UTF-8 text ({error.reason} at byte {error.start}). Save it as UTF-8."
        ) from error
    try:
        return YAML(typ="rt").load(io.StringIO(text))
    except YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark else ""
        problem = " ".join(str(getattr(error, "problem", None) or error).split())
        raise EnvcalError(f"{path}{line}: is not YAML: {problem}.") from error
    except RecursionError as error:
        raise EnvcalError(f"{path}: is nested too deeply for a settings file.") from error


def _plain(node: Any, depth: int = 0) -> Any:
    """Ruamel's own types → plain ones, so that messages and validation see what the person wrote."""
    if depth > 12:
        raise EnvcalError("the settings are nested more than 12 deep; no setting is.")
    if isinstance(node, dict):
        return {str(k): _plain(v, depth + 1) for k, v in node.items()}
    if isinstance(node, list):
        return [_plain(v, depth + 1) for v in node]
    for kind in (bool, int, float, str):
        if isinstance(node, kind):
            return kind(node)
    return node if node is None else str(node)


def _override(tree: dict[str, Any], text: str) -> tuple[str, ...]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    name, equals, value = text.partition("=")
    keys = tuple(part.strip() for part in name.split("."))
    if not equals or not all(keys):
        raise EnvcalError(f"--set {text}: expected key.key=value, such as --set uplift.method=scaled.")
    try:
        parsed = YAML(typ="safe").load(value)
    except YAMLError:
        raise EnvcalError(f"--set {text}: the value is not YAML; put quotes around it.") from None
    node = tree
    for key in keys[:-1]:
        if not isinstance(node.get(key), dict):
            node[key] = {}
        node = node[key]
    node[keys[-1]] = parsed
    return keys


def _mistakes(
    path: Path,
    tree: Any,
    error: ValidationError,
    set_by: Mapping[tuple[str, ...], str],
    model: type[Settings] = Pipeline,
) -> list[str]:
    """One line per mistake, in the order of the file. A value that fails every branch of a union is told once."""
    found: dict[tuple[str | int, ...], list[str]] = {}
    for item in error.errors(include_url=False, include_context=True):
        where = _path_in(tree, item["loc"])
        if item["type"] == "extra_forbidden" or item["type"] == "missing":
            where = tuple(item["loc"]) if _exists(tree, item["loc"][:-1]) else where
        found.setdefault(where, []).append(_explain(item, where, model))
    lines = []
    for where, texts in found.items():
        if any(other[: len(where)] == where and other != where for other in found):
            continue  # the union as a whole fails because of the mistake inside it, which has a line of its own
        keys = tuple(str(k) for k in where)
        source = next((t for k, t in set_by.items() if keys[: len(k)] == k), None)
        place = f"--set {source}" if source else f"{path}:{_line(tree, where)}"
        name = ".".join(keys) or "the file as a whole"
        told = dict.fromkeys(texts if len(texts) == 1 else [t for t in texts if t != "is missing"])
        message = f"{place}: {name}: {', or '.join(told)}"
        lines.append((_line(tree, where), message if message.endswith("?") else message + "."))
    return [text for _, text in sorted(lines, key=lambda pair: pair[0])]


def _exists(tree: Any, loc: Sequence[str | int]) -> bool:
    return len(_path_in(tree, loc)) == len(loc)


def _path_in(tree: Any, loc: Sequence[str | int]) -> tuple[str | int, ...]:
    """The part of pydantic's location that is in the file: it also names branches of unions and models."""
    node: Any = tree
    path: list[str | int] = []
    for key in loc:
        if (isinstance(node, dict) and key in node) or (isinstance(node, list) and key in range(len(node))):
            node = node[key]  # type: ignore[index, unused-ignore]
            path.append(key)
    return tuple(path)


def _line(tree: Any, where: Sequence[str | int]) -> int:
    node: Any = tree
    line = 1
    for key in where:
        try:
            position = node.lc
            line = (position.key(key) if isinstance(node, dict) else position.item(key))[0] + 1
            node = node[key]
        except (KeyError, AttributeError, IndexError, TypeError):
            break
    return int(line)


def _explain(item: Mapping[str, Any], where: Sequence[str | int], model: type[Settings]) -> str:
    kind = item["type"]
    if kind == "extra_forbidden":
        known = _known(model, where[:-1])
        near = difflib.get_close_matches(str(where[-1]), known, n=1, cutoff=0.5)
        hint = f"did you mean `{near[0]}`?" if near else f"known here: {', '.join(known)}"
        return f"is not a setting; {hint}"
    if kind == "missing":
        return "is missing"
    if kind == "value_error":
        return str(item["ctx"]["error"])
    if kind == "literal_error" and not isinstance(item["input"], str):
        field = _field(model, where)
        expected = " ".join((field.description or "").split()).rstrip(".") if field else item["ctx"]["expected"]
        return f"is {_short(item['input'])}; expected {expected}"
    if kind == "literal_error":
        choices = item["ctx"]["expected"]
        near = difflib.get_close_matches(
            str(item["input"]), [c.strip("'") for c in choices.replace(" or ", ", ").split(", ")], n=1
        )
        return f"is {item['input']!r}; it can be {choices}" + (f"; did you mean {near[0]!r}?" if near else "")
    message = item["msg"][0].lower() + item["msg"][1:]
    return f"{message}, not {_short(item['input'])}"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "…"


def _model_at(model: type[BaseModel], where: Sequence[str | int]) -> type[BaseModel] | None:
    """The model of the settings at a place of the tree."""
    current: type[BaseModel] | None = model
    for key in where:
        if current is not None and not isinstance(key, int):
            field = current.model_fields.get(key)
            current = None if field is None else _inner_model(field.annotation)
    return current


def _known(model: type[BaseModel], where: Sequence[str | int]) -> list[str]:
    inner = _model_at(model, where)
    return [] if inner is None else list(inner.model_fields)


def _field(model: type[BaseModel], where: Sequence[str | int]) -> FieldInfo | None:
    inner = _model_at(model, where[:-1]) if where else None
    return None if inner is None else inner.model_fields.get(str(where[-1]))


def _inner_model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((m for part in get_args(annotation) if (m := _inner_model(part)) is not None), None)


def _resolve(path: Path, tree: Any, settings: Pipeline) -> Loaded:
    folder = path.resolve().parent
    mistakes: list[str] = []

    def frames(patterns: Frames, where: tuple[str, ...]) -> tuple[Path, ...]:
        found: dict[Path, None] = {}
        for pattern in [patterns] if isinstance(patterns, str) else patterns:
            matches = _matches(folder, pattern)
            if not matches:
                line = _line(tree, where)
                mistakes.append(
                    f"{path}:{line}: {'.'.join(where)}: no file matches {pattern!r} in {folder}. Correct the pattern; "
                    f"it starts from the folder of the settings file."
                )
            found.update(dict.fromkeys(matches))
        return tuple(found)

    capture = settings.capture
    reference = frames(capture.reference, ("capture", "reference"))
    environments: dict[str, tuple[Path, ...]] = {}
    if isinstance(capture.environment, dict):
        for name, patterns in capture.environment.items():
            if name == "reference" or not name.replace("_", "").replace("-", "").isalnum():
                line = _line(tree, ("capture", "environment", name))
                mistakes.append(
                    f"{path}:{line}: capture.environment.{name}: a shot's name is made of letters, "
                    f"digits, - and _, and is not `reference`; it becomes a file's name."
                )
            environments[name] = frames(patterns, ("capture", "environment", name))
    elif capture.environment is not None:
        environments["environment"] = frames(capture.environment, ("capture", "environment"))
    absent = _absent_files(path, tree, settings)
    mistakes += absent.values()
    owned = {
        name: folder / value
        for name in ("library", "sky_model")
        if (value := getattr(settings.cluster, name)) is not None and ("cluster", name) not in absent
    }
    library = owned.get("library")
    settings = settings.model_copy(update={"cluster": settings.cluster.model_copy(update=dict(owned))})
    lights = []
    for number, light in enumerate(settings.cluster.lights):
        rooted = _rooted(light, folder, library)
        if rooted.spd is not None and not rooted.spd.is_file():
            line = _line(tree, ("cluster", "lights", number, "spd"))
            mistakes.append(
                f"{path}:{line}: cluster.lights.{number}.spd: there is no file {rooted.spd}. Correct the path."
            )
        lights.append(rooted)
    mistakes += _camera_mistakes(path, tree, settings.balance.camera, folder)
    for number, further in enumerate(settings.cluster.profiles):
        if not (folder / further).is_file():
            line = _line(tree, ("cluster", "profiles", number))
            mistakes.append(
                f"{path}:{line}: cluster.profiles.{number}: there is no file {folder / further}. Correct the path."
            )
    if mistakes:
        raise EnvcalError("\n".join(mistakes))
    return Loaded(path, settings, folder / settings.output, reference, environments, tuple(lights))


def _absent_files(path: Path, tree: Any, settings: Pipeline) -> dict[tuple[str, str], str]:
    """Mistakes for files and folders that the settings name and that do not exist, by the place of the setting."""
    folder, out = path.resolve().parent, {}
    named = (
        ("merge", "dark_frame", settings.merge.dark_frame),
        ("merge", "flat_field", settings.merge.flat_field),
        ("correct", "patches", settings.correct.patches),
        ("balance", "spectrum", settings.balance.spectrum),
        ("cluster", "library", settings.cluster.library),
        ("cluster", "sky_model", settings.cluster.sky_model),
    )
    for stage, key, value in named:
        if value is None:
            continue
        what = "folder" if key == "library" else "file"
        if not ((folder / value).is_dir() if key == "library" else (folder / value).is_file()):
            out[stage, key] = (
                f"{path}:{_line(tree, (stage, key))}: {stage}.{key}: there is no {what} {folder / value}. Correct the path."
            )
    return out


def _camera_mistakes(path: Path, tree: Any, camera: str | None, folder: Path) -> list[str]:
    if camera is None or (folder / camera).is_file():
        return []
    from envcal.cameras import is_known, known_cameras

    if is_known(camera):
        return []
    return [
        f"{path}:{_line(tree, ('balance', 'camera'))}: balance.camera: {camera!r} is neither a file in {folder} nor a camera known "
        f"by name ({', '.join(known_cameras())}). Correct it, or leave it out."
    ]


def _matches(folder: Path, pattern: str) -> list[Path]:
    """Files that match a pattern, relative to `folder` or absolute, in the order of their names."""
    whole = Path(pattern)
    base = Path(whole.anchor) if whole.is_absolute() else folder
    relative = str(whole.relative_to(whole.anchor)) if whole.is_absolute() else pattern
    if not relative or relative == ".":
        return []
    try:
        return sorted(p for p in base.glob(relative) if p.is_file())
    except (ValueError, NotImplementedError, OSError):
        return []
