"""Which kind of lamp a colour speaks for: a probability for each kind, from CCT and Duv.

Lamps of one kind gather on the chromaticity plane: filaments on the Planckian locus below 3400 K, daylight above it from
4000 K up, halophosphate tubes on the green side, sodium lamps far below 2200 K. White LEDs and fluorescent tubes are
designed to have the colours of all of them, so the colour alone decides seldom, and the probabilities say so.

Method: kernel density estimate over 120 published and tabulated spectra, one kind as likely as another beforehand. Widths
and floor were chosen by likelihood with each lamp left out in turn (`left_out` repeats it), and so that the probabilities
are no more confident than right: the kind named most likely is the right one in 50 % (the mean over kinds), and its mean
probability is 47 %; by chance it would be 20 %. A light's colour is weak evidence of its kind.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

from uplift.cct import planck
from uplift.illuminants.daylight import d_series
from uplift.illuminants.measured import resampled
from uplift.illuminants.nodes import cct_duv_of
from uplift.spectrum import Observer, normalised

Floats = npt.NDArray[np.float64]

KINDS = ("led", "fluorescent", "incandescent", "daylight", "discharge")
WIDTH_MIRED, WIDTH_DUV = 50.0, 0.0022
FLOOR = 0.15  # of each kind's density, spread evenly: no lamp of the list need be like the one in the room
PLANE_MIRED, PLANE_DUV = 650.0, 0.06  # over which it is spread

# colour-science's illuminants and light sources, by kind.
_PUBLISHED: dict[str, tuple[str, ...]] = {
    "led": (
        *(f"LED-B{i}" for i in range(1, 6)), "LED-BH1", "LED-RGB1", "LED-V1", "LED-V2", "3-LED-1 (457/540/605)",
        "3-LED-2 (473/545/616)", "3-LED-3 (465/546/614)", "3-LED-4 (455/547/623)", "4-LED No Yellow", "4-LED Yellow",
        "4-LED-1 (461/526/576/624)", "4-LED-2 (447/512/573/627)", "Luxeon WW 2880", "PHOS-1", "PHOS-2", "PHOS-3",
        "PHOS-4", "Phosphor LED YAG",
    ),
    "fluorescent": (
        *(f"FL{i}" for i in range(1, 13)), *(f"FL3.{i}" for i in range(1, 16)), "Philips TL-84",
        "T8 Luxline Plus White", "T8 Polylux 3000", "T8 Polylux 4000", "Thorn Kolor-rite", "Cool White FL",
        "Daylight FL", "Triphosphor FL", "F32T8/TL830 (Triphosphor)", "F32T8/TL835 (Triphosphor)",
        "F32T8/TL841 (Triphosphor)", "F32T8/TL850 (Triphosphor)", "F32T8/TL865/PLUS (Triphosphor)",
        "F34/CW/RS/EW (Cool White FL)", "F34T12/LW/RS/EW", "F34T12WW/RS/EW (Warm White FL)", "F40/C50 (Broadband FL)",
        "F40/C75 (Broadband FL)", "F40/CWX (Broadband FL)", "F40/DX (Broadband FL)", "F40/DXTP (Delux FL)",
        "F40/N (Natural FL)",
    ),
    "incandescent": ("A", "Incandescent", "Neodimium Incandescent", "60 A/W (Soft White)", "ISO 7589 Studio Tungsten", "ISO 7589 Photoflood"),
    "daylight": ("D50", "D55", "D60", "D65", "D75", "ID50", "ID65", "Natural"),
    "discharge": (
        *(f"HP{i}" for i in range(1, 6)), "HPS", "Super HPS", "C100S54 (HPS)", "C100S54C (HPS)", "SDW-T 100W/LV (Super HPS)",
        "Mercury", "Metal Halide", "H38HT-100 (Mercury)", "H38JA-100/DX (Mercury DX)", "MHC100/U/MP/3K", "MHC100/U/MP/4K",
    ),
}  # fmt: skip
FILAMENTS_K = (1900, 2200, 2400, 2600, 2700, 2800, 2950, 3050, 3200)
SKIES_K = (4000, 4500, 5500, 6000, 7000, 8500, 10_000, 13_000, 18_000)


@cache
def known_lamps(observer: Observer) -> tuple[npt.NDArray[np.int64], Floats]:
    """Return kind [L], an index into `KINDS`, and (mired, Duv) [L, 2] of the lamps that the probabilities rest on."""
    import colour

    kinds: list[int] = []
    where: list[tuple[float, float]] = []

    def add(kind: int, emission: Floats) -> None:
        cct, duv = cct_duv_of(normalised(emission, observer), observer)
        if np.isfinite(cct):
            kinds.append(kind)
            where.append((1e6 / cct, duv))

    for number, kind in enumerate(KINDS):
        for name in _PUBLISHED[kind]:
            published = (colour.SDS_ILLUMINANTS if name in colour.SDS_ILLUMINANTS else colour.SDS_LIGHT_SOURCES)[name]
            add(number, np.maximum(resampled(published.wavelengths, published.values, observer), 0.0))
    for kelvin in FILAMENTS_K:
        add(KINDS.index("incandescent"), planck(observer.wavelengths_nm, kelvin))
    for kelvin in SKIES_K:
        add(KINDS.index("daylight"), d_series(float(kelvin), observer))
    return np.array(kinds), np.array(where)


def kind_probabilities(
    cct: float, duv: float, observer: Observer, *, sigma_mired: float = 0.0, sigma_duv: float = 0.0
) -> dict[str, float]:
    """Return the probability of each of `KINDS` for a light of this CCT (K) and Duv; they sum to 1.

    `sigma_mired` and `sigma_duv` are the standard deviations of the measurement. Without a CCT (NaN) all kinds are alike.
    """
    if not (np.isfinite(cct) and np.isfinite(duv)):
        return dict.fromkeys(KINDS, 1.0 / len(KINDS))
    kinds, where = known_lamps(observer)
    widths = (float(np.hypot(WIDTH_MIRED, sigma_mired)), float(np.hypot(WIDTH_DUV, sigma_duv)))
    found = _probabilities(np.array([1e6 / cct, duv]), kinds, where, widths)
    return {kind: float(value) for kind, value in zip(KINDS, found, strict=True)}


def _probabilities(
    at: Floats, kinds: npt.NDArray[np.int64], where: Floats, widths: tuple[float, float], weight: Floats | None = None
) -> Floats:
    offset = (where - at) / np.array(widths)
    kernel = np.exp(-0.5 * (offset**2).sum(axis=1)) / (2.0 * np.pi * widths[0] * widths[1])
    one = np.ones(len(kinds)) if weight is None else weight
    density = np.bincount(kinds, kernel * one, len(KINDS)) / np.bincount(kinds, one, len(KINDS))
    density = (1.0 - FLOOR) * density + FLOOR / (PLANE_MIRED * PLANE_DUV)
    out: Floats = density / density.sum()
    return out


def left_out(
    observer: Observer, widths: tuple[float, float] = (WIDTH_MIRED, WIDTH_DUV)
) -> tuple[npt.NDArray[np.int64], Floats]:
    """Return kind [L] and probabilities [L, kinds] of each known lamp, as the others tell them."""
    kinds, where = known_lamps(observer)
    rows = []
    for number in range(len(kinds)):
        weight = np.ones(len(kinds))
        weight[number] = 0.0
        rows.append(_probabilities(where[number], kinds, where, widths, weight))
    return kinds, np.stack(rows)
