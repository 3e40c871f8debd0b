"""Spectra that lamps have: the published ones, and many modelled after the physics of each kind.

A prior learned from a hundred published lamps alone takes what they have in common (all FL lamps share their mercury
lines' proportions, five white LEDs one pump wavelength) for laws. So each family is made of what such lamps are made
of, in random proportions, and the published ones stand among them:

- white LEDs: a blue or violet pump and one to three phosphors; the pump's and the phosphors' peaks and widths vary
  (shapes as in Y. Ohno, "Spectral design considerations for white LED color rendering", Opt. Eng. 44, 2005; red nitrides
  and the lines of K₂SiF₆:Mn⁴⁺ near 631 nm as in any textbook on phosphors);
- colour-mixed LEDs: three to five narrow ones;
- fluorescent lamps: the visible lines of mercury (404.7, 435.8, 546.1, 577.0 and 579.1 nm) and either halophosphate (broad
  bands of antimony and manganese) or three-band phosphors (europium near 450 nm, terbium, europium at 611 nm), or both
  with wide "de luxe" bands (S. Shionoya and W. M. Yen, Phosphor Handbook, 1998, chapter 5);
- discharge lamps: the published ones only, and mixtures of two;
- incandescent: Planck with a slowly varying emissivity and glass;
- daylight: the D series and the low sun's beam, with the same slow variations.

Every modelled lamp is white: its chromaticity is within about Duv ± 0.02 of the Planckian locus. Which lamp of
colour-science belongs to which family is said in `PUBLISHED`. The random numbers have a fixed seed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from uplift.spectrum import Observer, illuminant, normalised, xyz_of

Floats = npt.NDArray[np.float64]

FAMILIES = ("led", "fluorescent", "incandescent", "daylight", "discharge")
SEED = 20240617
#: Lamps of each kind that are drawn.
DRAWN = 1200

_FL = (*(f"FL{i}" for i in range(1, 13)), *(f"FL3.{i}" for i in range(1, 16)))
#: Published spectra by family, as colour-science names them (illuminants and light sources). Lamps of its list that stand
#: there twice, or are theoretical without being any kind of lamp, are left out.
PUBLISHED: dict[str, tuple[str, ...]] = {
    "led": (
        *(f"LED-{n}" for n in ("B1", "B2", "B3", "B4", "B5", "BH1", "RGB1", "V1", "V2")),
        "3-LED-1 (457/540/605)", "3-LED-2 (473/545/616)", "3-LED-2 Yellow", "3-LED-3 (465/546/614)",
        "3-LED-4 (455/547/623)", "4-LED No Yellow", "4-LED Yellow", "4-LED-1 (461/526/576/624)",
        "4-LED-2 (447/512/573/627)", "Luxeon WW 2880", "PHOS-1", "PHOS-2", "PHOS-3", "PHOS-4", "Phosphor LED YAG",
    ),
    "fluorescent": (
        *_FL, "Philips TL-84", "T8 Luxline Plus White", "T8 Polylux 3000", "T8 Polylux 4000", "Thorn Kolor-rite",
        "Cool White FL", "Daylight FL", "Triphosphor FL", "F32T8/TL830 (Triphosphor)", "F32T8/TL835 (Triphosphor)",
        "F32T8/TL841 (Triphosphor)", "F32T8/TL850 (Triphosphor)", "F32T8/TL865/PLUS (Triphosphor)",
        "F34/CW/RS/EW (Cool White FL)", "F34T12/LW/RS/EW", "F34T12WW/RS/EW (Warm White FL)", "F40/C50 (Broadband FL)",
        "F40/C75 (Broadband FL)", "F40/CWX (Broadband FL)", "F40/DX (Broadband FL)", "F40/DXTP (Delux FL)",
        "F40/N (Natural FL)",
    ),
    "incandescent": ("A", "Incandescent", "Neodimium Incandescent", "60 A/W (Soft White)"),
    "daylight": ("B", "C", "D50", "D55", "D60", "D65", "D75", "ID50", "ID65"),
    "discharge": (
        "HP1", "HP2", "HP3", "HP4", "HP5", "HPS", "LPS", "Mercury", "Metal Halide", "Super HPS", "C100S54 (HPS)",
        "C100S54C (HPS)", "H38HT-100 (Mercury)", "H38JA-100/DX (Mercury DX)", "MHC100/U/MP/3K", "MHC100/U/MP/4K",
        "SDW-T 100W/LV (Super HPS)", "Kinoton 75P",
    ),
}  # fmt: skip

# nm and relative power of lines; widths are those of the lamps as spectrometers of 5 nm see them.
MERCURY = ((404.7, 0.45), (435.8, 1.0), (546.1, 0.60), (577.0, 0.09), (579.1, 0.09))
TERBIUM = ((488.0, 0.28), (543.0, 1.0), (549.0, 0.28), (585.0, 0.20), (590.0, 0.10), (621.0, 0.10))
EUROPIUM = ((588.0, 0.10), (594.0, 0.12), (600.0, 0.08), (611.0, 1.0), (630.0, 0.14), (650.0, 0.05), (688.0, 0.04), (708.0, 0.09))  # fmt: skip
MANGANESE_FLUORIDE = ((609.0, 0.20), (613.5, 0.40), (631.0, 1.0), (635.0, 0.55), (648.0, 0.20))


def _neodymium(nm: Floats) -> Floats:
    """Optical depth of neodymium glass [N], 1 at its yellow band (A. A. Kaminskii, Laser Crystals, 1981: Nd³⁺ in glass)."""
    bands = ((525.0, 18.0, 0.35), (584.0, 24.0, 1.0), (748.0, 24.0, 0.7))
    return np.asarray(sum(depth * np.exp(-0.5 * ((nm - at) / (width / 2.3548)) ** 2) for at, width, depth in bands))


@dataclass(frozen=True, slots=True, eq=False)
class Lamps:
    """Lamps of one family: `emissions` [S, N], each of Y = 1; the first `published` of them are measured ones."""

    family: str
    emissions: Floats
    published: int


@cache
def lamps(observer: Observer, left_out: frozenset[str] = frozenset()) -> tuple[Lamps, ...]:
    """Return published and modelled lamps of each of `FAMILIES`; `left_out` names published ones not to use."""
    out = []
    for number, family in enumerate(FAMILIES):
        rng = np.random.default_rng((SEED, number))
        known = np.array([published(name, observer) for name in PUBLISHED[family] if name not in left_out])
        drawn = _DRAW[family](rng, observer, known)
        drawn = np.array([normalised(spectrum, observer) for spectrum in drawn])
        out.append(Lamps(family, np.concatenate([known, drawn]), len(known)))
    return tuple(out)


def published(name: str, observer: Observer) -> Floats:
    """Return a published lamp [N], Y = 1, by the name colour-science has for it."""
    import colour

    if name in colour.SDS_ILLUMINANTS:
        return illuminant(name, observer)
    found = colour.SDS_LIGHT_SOURCES[name]
    values = np.interp(observer.wavelengths_nm, found.wavelengths, found.values, left=0.0, right=0.0)
    return normalised(np.maximum(values, 0.0), observer)


# ---- parts of lamps ----


def _bump(nm: Floats, peak: Floats, low_nm: Floats, high_nm: Floats) -> Floats:
    """Bells [S, N] with full widths at half maximum `low_nm` towards blue and `high_nm` towards red (S values each)."""
    off = nm[np.newaxis, :] - peak[:, np.newaxis]
    width = np.where(off < 0, low_nm[:, np.newaxis], high_nm[:, np.newaxis]) / 2.3548
    return np.asarray(np.exp(-0.5 * (off / width) ** 2))


def _ohno(nm: Floats, peak: Floats, width_nm: Floats) -> Floats:
    """Narrow LEDs [S, N] after Ohno (2005): (g + 2 g⁵) / 3."""
    g = np.exp(-(((nm[np.newaxis, :] - peak[:, np.newaxis]) / width_nm[:, np.newaxis]) ** 2))
    return np.asarray((g + 2.0 * g**5) / 3.0)


def _lines(
    nm: Floats, lines: tuple[tuple[float, float], ...], width_nm: Floats, rng: np.random.Generator, spread: float
) -> Floats:
    """Lines [S, N], bells of the instrument's width, their powers varied by `spread` (logarithmic)."""
    out = np.zeros((width_nm.size, nm.size))
    for at, power in lines:
        factor = power * np.exp(spread * rng.standard_normal(width_nm.size)) / width_nm
        out += factor[:, np.newaxis] * _bump(nm, np.full(width_nm.size, at), width_nm, width_nm)
    return out


def _slow(nm: Floats, rng: np.random.Generator, count: int, spread: float) -> Floats:
    """Slowly varying factors [count, N] about 1: a tilt, a bow and a third-order wave."""
    t = (nm - 570.0) / 200.0
    waves = np.stack([t, t**2 - 1 / 3, t**3 - 0.6 * t])
    weights = rng.standard_normal((count, 3)) * spread * np.array([1.0, 0.6, 0.4])
    return np.asarray(np.exp(weights @ waves))


def planck(cct: Floats, nm: Floats) -> Floats:
    """Black bodies [S, N] of temperatures `cct` [S] in K, in arbitrary units."""
    return np.asarray((560.0 / nm) ** 5 / np.expm1(1.438776877e7 / (nm[np.newaxis, :] * cct[:, np.newaxis])))


def _targets(rng: np.random.Generator, count: int, observer: Observer, low_k: float, high_k: float) -> Floats:
    """Tristimulus values [S, 3], Y = 1, of whites: even in mired, Duv with a standard deviation of 0.006."""
    cct = 1e6 / rng.uniform(1e6 / high_k, 1e6 / low_k, count)
    uv = _uv(planck(cct, observer.wavelengths_nm), observer)
    along = _uv(planck(cct * 1.01, observer.wavelengths_nm), observer) - uv
    across = np.stack([along[:, 1], -along[:, 0]], axis=-1) / np.linalg.norm(along, axis=1, keepdims=True)
    u, v = (uv + np.clip(0.006 * rng.standard_normal(count), -0.018, 0.018)[:, np.newaxis] * across).T
    x, y = 3 * u / (2 * u - 8 * v + 4), 2 * v / (2 * u - 8 * v + 4)
    return np.stack([x / y, np.ones(count), (1 - x - y) / y], axis=-1)


def _uv(spectra: Floats, observer: Observer) -> Floats:
    """CIE 1960 u, v [..., 2] of spectra [..., N]."""
    x, y, z = np.moveaxis(xyz_of(spectra, observer), -1, 0)
    return np.asarray(np.stack([4 * x, 6 * y], axis=-1) / (x + 15 * y + 3 * z)[..., np.newaxis])


def _white(parts: Floats, targets: Floats, observer: Observer) -> Floats:
    """Mixtures [M, N] of three parts [S, 3, N] that have the colours `targets` [S, 3]; impossible ones are left out."""
    xyz = xyz_of(parts, observer)
    weights = np.linalg.solve(np.swapaxes(xyz, 1, 2), targets[..., np.newaxis])[..., 0]
    good = (weights > 0).all(axis=1)
    return np.asarray(np.einsum("sp,spn->sn", weights[good], parts[good]))


def _share(rng: np.random.Generator, *parts: Floats, concentration: float = 0.7) -> Floats:
    """Random mixtures [S, N] of parts [S, N], each of unit sum before."""
    weights = rng.dirichlet(np.full(len(parts), concentration), parts[0].shape[0])
    return np.asarray(sum(weights[:, k, np.newaxis] * p / p.sum(axis=1, keepdims=True) for k, p in enumerate(parts)))


# ---- families ----


def _draw_led(rng: np.random.Generator, observer: Observer, _known: Floats) -> Floats:
    nm, s = observer.wavelengths_nm, DRAWN

    def normal(mean: float, deviation: float) -> Floats:
        return mean + deviation * rng.standard_normal(s)

    violet = rng.random(s) < 0.12
    pump_at = np.where(violet, normal(415.0, 7.0), normal(452.0, 7.0))
    pump = _bump(nm, pump_at, np.abs(normal(17.0, 3.0)) + 5, np.abs(normal(21.0, 4.0)) + 5)
    second = _bump(nm, normal(455.0, 8.0), normal(40.0, 4.0), normal(60.0, 5.0))  # blue phosphor over a violet pump
    blue = np.where(violet[:, np.newaxis], 0.7 * pump + rng.uniform(0.2, 1.2, (s, 1)) * second, pump)
    green = _bump(nm, normal(535.0, 12.0), np.abs(normal(75.0, 12.0)), np.abs(normal(110.0, 15.0)))
    red = _bump(nm, normal(620.0, 16.0), np.abs(normal(75.0, 10.0)), np.abs(normal(100.0, 12.0)))
    narrow = np.where(
        (rng.random(s) < 0.5)[:, np.newaxis],
        _lines(nm, MANGANESE_FLUORIDE, np.full(s, 6.0), rng, 0.1),
        _ohno(nm, normal(628.0, 7.0), np.abs(normal(13.0, 3.0)) + 5),
    )
    some = (rng.random((s, 1)) < 0.2) * rng.random((s, 1))
    red = (1 - some) * red / red.sum(1, keepdims=True) + some * narrow / narrow.sum(1, keepdims=True)
    white = _white(np.stack([blue, green, red], axis=1), _targets(rng, s, observer, 2000.0, 12000.0), observer)

    peaks = [normal(457.0, 9.0), normal(528.0, 12.0), normal(626.0, 10.0)]
    blue, green, red = (
        _ohno(nm, at, np.abs(normal(w, 5.0)) + 7) for at, w in zip(peaks, (15.0, 22.0, 12.0), strict=True)
    )
    amber = _ohno(nm, normal(592.0, 10.0), np.abs(normal(12.0, 4.0)) + 6)
    lime = _bump(nm, normal(550.0, 12.0), normal(85.0, 8.0), normal(110.0, 8.0))
    few = (rng.random((s, 1)) < 0.5).astype(float)
    green = _share(rng, green, few * lime + (1 - few) * green)
    red = _share(rng, red, few * amber + (1 - few) * red)
    mixed = _white(np.stack([blue, green, red], axis=1), _targets(rng, s, observer, 2200.0, 8000.0), observer)
    return np.concatenate([white, mixed[: len(white) // 2]])


def _draw_fluorescent(rng: np.random.Generator, observer: Observer, known: Floats) -> Floats:
    nm, s = observer.wavelengths_nm, DRAWN

    def normal(mean: float, deviation: float) -> Floats:
        return mean + deviation * rng.standard_normal(s)

    width = rng.uniform(5.0, 9.0, s)
    mercury = _lines(nm, MERCURY, width, rng, 0.15)
    antimony = _bump(nm, normal(482.0, 5.0), normal(105.0, 8.0), normal(120.0, 8.0))
    manganese = _bump(nm, normal(582.0, 5.0), normal(70.0, 5.0), normal(80.0, 5.0))
    europium_2 = _bump(nm, normal(450.0, 4.0), normal(40.0, 5.0), normal(55.0, 6.0))
    strontium = _bump(nm, normal(490.0, 4.0), normal(50.0, 5.0), normal(70.0, 6.0))
    terbium, europium = _lines(nm, TERBIUM, width, rng, 0.12), _lines(nm, EUROPIUM, width, rng, 0.12)
    de_luxe = _bump(nm, normal(625.0, 15.0), normal(85.0, 10.0), normal(90.0, 12.0))
    far = _bump(nm, normal(658.0, 4.0), normal(20.0, 4.0), normal(25.0, 5.0))

    three = rng.random((s, 1)) < 0.5
    blue = np.where(three, europium_2, _share(rng, antimony, europium_2, strontium, concentration=0.5))
    green = np.where(three, terbium, _share(rng, antimony, strontium, terbium, manganese, concentration=0.4))
    red = np.where(three, europium, _share(rng, manganese, de_luxe, europium, far + 1e-9, concentration=0.4))
    parts = np.stack([blue, green, red], axis=1)
    parts /= parts.sum(axis=2, keepdims=True)
    # The mercury's share of the power is a property of the discharge, not of the colour: 4 to 16 % over the lines' sum.
    lines = rng.uniform(0.04, 0.16, (s, 1)) * mercury / mercury.sum(axis=1, keepdims=True)
    targets = _targets(rng, s, observer, 2500.0, 8000.0)
    lines_xyz = xyz_of(lines, observer)
    brightness = xyz_of(parts, observer)[:, :, 1].mean(axis=1)
    scale = brightness[:, np.newaxis] * targets
    weights = np.linalg.solve(np.swapaxes(xyz_of(parts, observer), 1, 2), (scale - lines_xyz)[..., np.newaxis])[..., 0]
    good = (weights > 0).all(axis=1)
    made = lines[good] + np.einsum("sp,spn->sn", weights[good], parts[good])
    return np.concatenate([made, _mixed(rng, known, DRAWN // 3)])


def _draw_incandescent(rng: np.random.Generator, observer: Observer, _known: Floats) -> Floats:
    nm = observer.wavelengths_nm
    cct = 1e6 / rng.uniform(1e6 / 3500.0, 1e6 / 1500.0, DRAWN // 2)
    filtered = (rng.random((cct.size, 1)) < 0.15).astype(float)
    glass = np.exp(
        -filtered * rng.uniform(0.2, 1.4, (cct.size, 1)) * (_neodymium(nm) + 0.05 * _slow(nm, rng, cct.size, 0.5))
    )
    return np.asarray(planck(cct, nm) * _slow(nm, rng, cct.size, 0.06) * glass)


def _draw_daylight(rng: np.random.Generator, observer: Observer, _known: Floats) -> Floats:
    from uplift.illuminants.daylight import RANGE_K, daylight
    from uplift.illuminants.sunset import RANGE_K as SUNSET_K
    from uplift.illuminants.sunset import sunset

    day = [daylight(float(1e6 / m), observer) for m in np.linspace(1e6 / 20000.0, 1e6 / RANGE_K[0] - 1e-6, 40)]
    low = [sunset(float(k), observer) for k in np.linspace(SUNSET_K[0], SUNSET_K[1], 12)]
    between = _mixed(rng, np.array([day[-1], low[-1], *low[6:]]), 20)
    base = np.concatenate([np.array(day), np.array(low), between])
    chosen = base[np.concatenate([np.arange(len(base)), rng.integers(0, len(base), DRAWN // 2 - len(base))])]
    # A clear sky away from the sun is bluer than any D illuminant: scattering by molecules goes with λ⁻⁴.
    blue = np.where(rng.random(len(chosen)) < 0.3, rng.uniform(0.0, 2.5, len(chosen)), 0.0)
    scattered = (560.0 / observer.wavelengths_nm) ** blue[:, np.newaxis]
    return np.asarray(chosen * scattered * _slow(observer.wavelengths_nm, rng, len(chosen), 0.05))


def _draw_discharge(rng: np.random.Generator, observer: Observer, known: Floats) -> Floats:
    return _mixed(rng, known, DRAWN // 4) * _slow(observer.wavelengths_nm, rng, DRAWN // 4, 0.05)


def _mixed(rng: np.random.Generator, known: Floats, count: int) -> Floats:
    """Mixtures [count, N] of two of the known lamps, mostly of the one."""
    one, other = rng.integers(0, len(known), (2, count))
    weight = rng.beta(0.6, 0.6, count)[:, np.newaxis]
    return np.asarray(weight * known[one] + (1 - weight) * known[other])


_DRAW = {
    "led": _draw_led,
    "fluorescent": _draw_fluorescent,
    "incandescent": _draw_incandescent,
    "daylight": _draw_daylight,
    "discharge": _draw_discharge,
}
