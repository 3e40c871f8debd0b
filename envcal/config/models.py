"""The settings of every stage: what can be said, its default, and what it means."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from envcal.config.texts import Bands, LightType, Wavelengths, parse_bands, parse_wavelengths

WorkingSpace = Literal["ITU-R BT.2020", "sRGB", "P3-D65", "ACEScg", "ACES2065-1", "Adobe Wide Gamut RGB"]
Indoor = Literal["auto", "led", "fluorescent", "incandescent"]
Pixel = tuple[float, float]
Share = Annotated[float, Field(ge=0, le=1)]
Frames = str | list[str]
Level = Annotated[float, Field(gt=0, le=65_535)]
Seconds = Annotated[float, Field(gt=0, le=100_000)]
Transmission = Annotated[float, Field(gt=0, le=1)]
Radiance = Annotated[float, Field(ge=0, le=1e12)]
Luminance = Annotated[float, Field(gt=0, le=1e10)]
Illuminance = Annotated[float, Field(gt=0, le=1e7)]
Power = Annotated[float, Field(ge=-20, le=20)]
Powers = tuple[Power, Power, Power]


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
    lamp_off: Frames | None = None
    """The bracket of the reference's view with the D65 lamp switched off, from the same tripod in the same light: a pattern
    or a list. The difference of the two is the lamp, without what it reflects of the scene's light."""


class LensByName(Settings):
    """A lens of the Lensfun database, and what the files do not tell of it."""

    name: str
    """As the database has it."""
    camera: str | None = None
    """Maker and model as the database has them. Left out: from the files."""
    focal_length_mm: Annotated[float, Field(gt=0, le=5000)] | None = None
    """Left out: from the files."""
    f_number: Annotated[float, Field(gt=0, le=128)] | None = None
    """Left out: from the files."""
    distance_m: Annotated[float, Field(gt=0, le=100_000)] | None = None
    """Focus distance in metres. Left out: from the files, or infinity."""


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

    lens: Literal["off", "auto", "required"] | LensByName = "off"
    """The lens's fall-off from the Lensfun database (`envcal[lens]`): `auto` takes it where camera and lens are known, and says
    where they are not; with `required`, or a lens by name, that is a mistake."""
    lens_database: Path | None = None
    """A file or folder of Lensfun's XML that takes the place of the database that comes with the package."""

    @property
    def files(self) -> list[Path]:
        """The files that are read besides the frames and the lens database."""
        return [path for path in (self.dark_frame, self.flat_field) if path is not None]

    @model_validator(mode="after")
    def _one_fall_off(self) -> MergeSettings:
        if self.vignetting is not None and self.flat_field is not None:
            raise ValueError("give either `vignetting` or `flat_field`; not both")
        if self.lens != "off" and (self.vignetting is not None or self.flat_field is not None):
            raise ValueError("give `lens`, `vignetting` or `flat_field`; only one of them")
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


class PatchReading(Settings):
    """What a luminance meter read on a patch of the chart, where the reference was photographed."""

    patch: Annotated[int, Field(ge=1, le=24)] | str
    """Its number, row by row from dark skin (white is 19), or its name or the beginning of it."""
    luminance: Luminance
    """cd/m²."""


class VerticalIlluminance(Settings):
    """What an illuminance meter read at the camera's place, facing sideways."""

    lux: Illuminance
    """lx."""
    toward: Share
    """The column of the map that the meter faced, u from the left."""


class PhotometrySettings(Settings):
    """The unit of radiance: relative, or cd/m² by one of these. Two of the illuminances are of the map, not of the chart."""

    exposure: bool = False
    """From ISO, aperture and exposure time, as far as the ISO is a saturation-based speed: good to a factor of 0.85 to 1.9."""
    patch: PatchReading | None = None
    """From the luminance of a patch of the chart."""
    chart_illuminance: Illuminance | None = None
    """From the illuminance on the plane of the chart, in its middle, in lx."""
    horizontal_illuminance: Illuminance | None = None
    """From the illuminance, in lx, on a horizontal plane that looks up, where the map was taken."""
    vertical_illuminance: VerticalIlluminance | None = None
    """From the illuminance on a vertical plane, where the map was taken."""

    @property
    def of_map(self) -> tuple[float, float | None] | None:
        """The illuminance in lx at the map's place, and the column that the plane faces (None: it looks up)."""
        if self.horizontal_illuminance is not None:
            return self.horizontal_illuminance, None
        vertical = self.vertical_illuminance
        return None if vertical is None else (vertical.lux, vertical.toward)

    @model_validator(mode="after")
    def _one_way(self) -> PhotometrySettings:
        given = [name for name in type(self).model_fields if getattr(self, name) not in (None, False)]
        if len(given) > 1:
            raise ValueError(
                f"gives {' and '.join(f'`{name}`' for name in given)}; the unit comes from one of them alone"
            )
        return self


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
    mixtures: bool = True
    """Pixels that two lights of known spectra share get a mixture of both, in quarters, instead of the stronger one's
    alone, which harms where lamps share a room. Up to three emissions more a pair of lights: a render takes a tenth longer, and
    the export `basis` a pass for each. `constrained` alone."""


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
    photometry: PhotometrySettings = PhotometrySettings()
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
