"""Wavelength grid, observer, working spaces, and the integrals that join spectra to RGB.

Everything spectral in this package is sampled on one even grid, and **the grid's sum is the definition of
XYZ here**: XYZ = Σ_λ (x̄, ȳ, z̄)(λ) · P(λ) · Δλ over the grid's wavelengths (CIE 015:2018, section 7.1,
which allows the 5 nm sum). There is no other integral, so a spectrum found by one module is exact for every
other one.

A spectrum has "Y = 1" when that sum with ȳ is 1; `normalised` makes it so. RGB of a spectrum P in a space is
`space.rgb_from_xyz @ xyz_of(P)`.

Left out: fluorescence, ultraviolet, and any weighting of the ends of the grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from uplift import UpliftError

Float64 = npt.NDArray[np.float64]

CIE_1931_2 = "CIE 1931 2 Degree Standard Observer"

# Primaries (x, y) of R, G, B and the white: the name of a CIE illuminant, whose spectrum then defines it, or
# its (x, y) where the standard gives no spectrum. Rec. ITU-R BT.2020-2; IEC 61966-2-1; SMPTE EG 432-1;
# S-2014-004 and TB-2014-004 of the Academy; Adobe's Wide Gamut RGB profile.
_SPACES: dict[str, tuple[tuple[tuple[float, float], ...], str | tuple[float, float]]] = {
    "ITU-R BT.2020": (((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)), "D65"),
    "sRGB": (((0.64, 0.33), (0.30, 0.60), (0.15, 0.06)), "D65"),
    "P3-D65": (((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)), "D65"),
    "ACEScg": (((0.713, 0.293), (0.165, 0.830), (0.128, 0.044)), (0.32168, 0.33767)),
    "ACES2065-1": (((0.7347, 0.2653), (0.0, 1.0), (0.0001, -0.077)), (0.32168, 0.33767)),
    "Adobe Wide Gamut RGB": (((0.7347, 0.2653), (0.1152, 0.8264), (0.1566, 0.0177)), "D50"),
}

RGB_SPACES: tuple[str, ...] = tuple(_SPACES)


@dataclass(frozen=True, slots=True, eq=False)
class Observer:
    """Colour matching functions on an even wavelength grid.

    `wavelengths_nm` has shape (N,), ascending and even; `cmfs` has shape (N, 3): x̄, ȳ, z̄ at those
    wavelengths. Both are read-only. Two observers are equal only if they are the same object; `observer`
    caches, so equal arguments give it.
    """

    wavelengths_nm: Float64
    cmfs: Float64
    name: str = CIE_1931_2

    @property
    def step_nm(self) -> float:
        """Distance Δλ between neighbouring wavelengths, in nm."""
        return float(self.wavelengths_nm[1] - self.wavelengths_nm[0])


@dataclass(frozen=True, slots=True, eq=False)
class RGBSpace:
    """A linear RGB space: `primaries_xy` (3, 2), `white_xy` (2,), `xyz_from_rgb` and `rgb_from_xyz` (3, 3).

    The matrices come from the primaries and the white alone, with Y = 1 for RGB = (1, 1, 1); nothing is
    adapted. `luminance_weights` is the middle row of `xyz_from_rgb`.
    """

    name: str
    white_xy: Float64
    primaries_xy: Float64
    xyz_from_rgb: Float64
    rgb_from_xyz: Float64

    @property
    def luminance_weights(self) -> Float64:
        """Shape (3,): Y of a colour is this times its RGB."""
        weights: Float64 = self.xyz_from_rgb[1]
        return weights


def _frozen(array: npt.ArrayLike) -> Float64:
    out = np.array(array, dtype=np.float64)
    out.flags.writeable = False
    return out


@cache
def observer(start: float = 380.0, stop: float = 780.0, step: float = 5.0, name: str = CIE_1931_2) -> Observer:
    """Return the colour matching functions `name` at `start`, `start + step`, … `stop` nm.

    The functions are those of colour-science at 1 nm, sampled (between whole nanometres: interpolated).
    Raises UpliftError if the grid is empty, uneven at its end, or leaves the range of the published data.
    """
    return _observer(float(start), float(stop), float(step), name)


@cache
def _observer(start: float, stop: float, step: float, name: str) -> Observer:
    import colour

    if not (step > 0 and stop > start):
        raise UpliftError(f"observer: grid {start}:{stop}:{step} nm is empty; expected start < stop and step > 0")
    intervals = (stop - start) / step
    if abs(intervals - round(intervals)) > 1e-9 or round(intervals) < 3:
        raise UpliftError(
            f"observer: grid {start}:{stop}:{step} nm does not end on its stop or has fewer than 4 "
            "wavelengths; choose a step that divides stop - start, such as 380:780:5"
        )
    if name not in colour.MSDS_CMFS:
        known = ", ".join(sorted(key for key in colour.MSDS_CMFS if key.startswith("CIE")))
        raise UpliftError(f"observer: {name!r} is unknown; expected one of {known}")
    published = colour.MSDS_CMFS[name]
    if published.shape.start > start or published.shape.end < stop:
        raise UpliftError(
            f"observer: grid {start}:{stop}:{step} nm leaves the range of {name} "
            f"({published.shape.start:g}-{published.shape.end:g} nm); stay inside it"
        )
    wavelengths = start + step * np.arange(round(intervals) + 1)
    cmfs = [np.interp(wavelengths, published.wavelengths, published.values[:, i]) for i in range(3)]
    return Observer(_frozen(wavelengths), _frozen(np.stack(cmfs, axis=-1)), name)


def checked_emission(emission: npt.ArrayLike, observer: Observer, *, place: str = "emission") -> Float64:
    """Return `emission` as float64 after checking that it has one finite, non-negative value per wavelength.

    Raises UpliftError, naming `place`, if it has not, or if it is dark to the observer.
    """
    values = np.ascontiguousarray(emission, dtype=np.float64)
    if values.shape != observer.wavelengths_nm.shape:
        raise UpliftError(
            f"{place}: shape {values.shape}, expected one value for each of the observer's "
            f"{observer.wavelengths_nm.size} wavelengths; resample it first: illuminants.measured_emission(wavelengths_nm, power, observer)"
        )
    if not np.isfinite(values).all() or values.min() < 0:
        worst = observer.wavelengths_nm[int(np.argmin(np.where(np.isfinite(values), values, -np.inf)))]
        raise UpliftError(f"{place}: negative or not finite at {worst:g} nm; a light has finite power >= 0 everywhere")
    if not values @ observer.cmfs[:, 1] > 0:
        raise UpliftError(f"{place}: emits nothing the observer sees (Y = 0); give a visible light")
    return values


def normalised(emission: npt.ArrayLike, observer: Observer) -> Float64:
    """Return `emission` [N] scaled to Y = Σ ȳ · E · Δλ = 1. Raises UpliftError if it is no visible light."""
    values = checked_emission(emission, observer)
    # Divided by its peak first: spectra in arbitrary units may be so small or large that the sum leaves
    # float64.
    values = values / values.max()
    return np.asarray(values / (values @ observer.cmfs[:, 1] * observer.step_nm), dtype=np.float64)


def xyz_of(spectra: npt.ArrayLike, observer: Observer) -> Float64:
    """Return XYZ [..., 3] of spectra [..., N]: Σ cmfs · P · Δλ, so that a spectrum `normalised` to Y = 1 has
    Y = 1.
    """
    values = np.asarray(spectra, dtype=np.float64)
    if values.shape[-1:] != observer.wavelengths_nm.shape:
        raise UpliftError(
            f"xyz_of: spectra of shape {values.shape} on an observer of "
            f"{observer.wavelengths_nm.size} wavelengths; the last axes must agree"
        )
    return np.asarray(values @ observer.cmfs * observer.step_nm, dtype=np.float64)


def rgb_weights(emission: npt.ArrayLike, observer: Observer, space: RGBSpace) -> Float64:
    """Return W [3, N] with which RGB(E · R) = W @ R in `space`, where E is `emission` scaled to Y = 1.

    `W.sum(axis=1)` is w, the RGB of the emission itself; `space.luminance_weights @ w` is 1.
    """
    weights = (space.rgb_from_xyz @ observer.cmfs.T) * (normalised(emission, observer) * observer.step_nm)
    return np.ascontiguousarray(weights, dtype=np.float64)


@cache
def illuminant(name: str, observer: Observer) -> Float64:
    """Return the published illuminant `name` of colour-science ("D65", "A", "FL2", "LED-B3", …) [N], Y = 1,
    read-only.

    Linear between published wavelengths (CIE 015:2018 for D65), zero outside their range. Raises UpliftError
    for an unknown name.
    """
    import colour

    if name not in colour.SDS_ILLUMINANTS:
        raise UpliftError(
            f"illuminant {name!r} is unknown; expected one of {', '.join(sorted(colour.SDS_ILLUMINANTS))}"
        )
    published = colour.SDS_ILLUMINANTS[name]
    values = np.interp(observer.wavelengths_nm, published.wavelengths, published.values, left=0.0, right=0.0)
    return _frozen(normalised(values, observer))


def rgb_space(name: str, *, observer: Observer | None = None) -> RGBSpace:
    """Return the linear RGB space `name`, one of `RGB_SPACES`.

    Where the standard names its white as a CIE illuminant, the white here is that illuminant's spectrum as
    `observer` (default: `observer()`) sees it, as pbrt-v4 does, not the published chromaticity rounded to
    four digits. They differ by 3e-5, and with the rounded one the spectrum of D65 would not be exactly RGB =
    (1, 1, 1). Raises UpliftError for an unknown name.
    """
    return _rgb_space(name, observer if observer is not None else _observer(380.0, 780.0, 5.0, CIE_1931_2))


#: What the spaces are also called, in small letters without signs.
_ALIASES = {
    "rec2020": "ITU-R BT.2020",
    "bt2020": "ITU-R BT.2020",
    "rec709": "sRGB",
    "bt709": "sRGB",
    "p3": "P3-D65",
    "displayp3": "P3-D65",
    "ap0": "ACES2065-1",
    "aces": "ACES2065-1",
    "ap1": "ACEScg",
    "widegamut": "Adobe Wide Gamut RGB",
    "widegamutrgb": "Adobe Wide Gamut RGB",
}


def _meant(name: str) -> str | None:
    """Return the space that a misspelt name most likely means; None if none is near."""
    import difflib

    def plain(text: str) -> str:
        return "".join(letter for letter in text.casefold() if letter.isalnum())

    names = {plain(space): space for space in _SPACES} | _ALIASES
    asked = plain(name)
    for word in ("linear", "scene"):  # as in "Linear Rec.2020"
        asked = asked.removeprefix(word)
    near = difflib.get_close_matches(asked, names, n=1, cutoff=0.75)
    return names[near[0]] if near else None


@cache
def _rgb_space(name: str, observer: Observer) -> RGBSpace:
    if name not in _SPACES:
        near = _meant(name)
        raise UpliftError(
            f"colour space {name!r} is unknown; {f'did you mean {near!r}? Expected' if near else 'expected'} one of "
            f"{', '.join(_SPACES)}"
        )
    primaries_xy, white = _SPACES[name]
    if isinstance(white, str):
        white_xyz = xyz_of(illuminant(white, observer), observer)
    else:
        white_xyz = np.array([white[0] / white[1], 1.0, (1 - white[0] - white[1]) / white[1]])
    columns = np.array([[x, y, 1 - x - y] for x, y in primaries_xy]).T
    xyz_from_rgb = columns * np.linalg.solve(columns, white_xyz)
    return RGBSpace(
        name=name,
        white_xy=_frozen(white_xyz[:2] / white_xyz.sum()),
        primaries_xy=_frozen(primaries_xy),
        xyz_from_rgb=_frozen(xyz_from_rgb),
        rgb_from_xyz=_frozen(np.linalg.inv(xyz_from_rgb)),
    )
