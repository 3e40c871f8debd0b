"""The lamps that are measured, and of each the published ones that its prior must not know."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks import rooms
from uplift.spectrometer import FAMILIES
from uplift.spectrometer.lamps import PUBLISHED, planck, published
from uplift.spectrum import normalised, observer

Float64 = npt.NDArray[np.float64]
EYES = observer()
ALIKE = 0.05  # rms difference over rms: nearer ones are the same lamp
#: The set's labels that say what a lamp is; what fits none (theoretical spectra, names without a meaning) is left out.
KINDS = (
    ("led", r"LED|NGL|Cree|Lumileds|Soraa|Xicato|RGB model|RGB product|4 peak|Booth|B-Y|Luxeon|PHOS-\d"),
    ("fluorescent", r"FL\b|CIE F\d|F3\.\d|FL3|F32|F34|F40|luoresc|TL8|TL9|TL7"),
    ("incandescent", r"ncandesc|alogen|60WA19|Reveal|75W Soft|75 W Rough|MCRI-35: A$|Tru Aim|Houser: 2|Houser: 3000"),
    ("discharge", r"HPS|Mercury|Metal Halide|HP\d$|MHC|SDW|CDM|cdm|MH100W|White SON|C100S|H38"),
    ("daylight", r"D65|Houser: [5-8]"),
)
#: Products that colour-science has from the same catalogue, whatever their distance.
SAME_PRODUCT = r"AE 9200|TL830|TL835|TL841|TL850|TL865|C50|C75|F40CWX|F40DX|F40N"


@dataclass(frozen=True, slots=True, eq=False)
class Tested:
    """A lamp to be measured, and the published lamps that its prior must not know."""

    family: str
    name: str
    emission: Float64
    left_out: frozenset[str] = frozenset()


@cache
def _published() -> tuple[tuple[str, str, Float64], ...]:
    return tuple((family, name, published(name, EYES)) for family, names in PUBLISHED.items() for name in names)


def alike(emission: Float64) -> frozenset[str]:
    """Names of the published lamps that are this lamp."""
    size = np.linalg.norm(emission)
    return frozenset(name for _, name, known in _published() if np.linalg.norm(known - emission) < ALIKE * size)


def measured_leds(folder: Path) -> list[Tested]:
    """The measured LEDs of the folder that are no CIE illuminants."""
    return [
        Tested("led", lamp.name, lamp.emission)
        for lamp in rooms.lamps(folder, EYES)
        if lamp.kind == "led" and not lamp.name.startswith("LED-") and lamp.cct < 12_000 and not alike(lamp.emission)
    ]


def left_out_lamps() -> list[Tested]:
    """Every published lamp, once each, with a prior that does not know it."""
    return [Tested(family, name, known, alike(known)) for family, name, known in _published()]


def houser(path: Path) -> list[Tested]:
    """The lamps of the set that the prior does not know."""
    from scipy.io import loadmat

    data = loadmat(path)
    out = []
    for label, values in zip(data["labels_houser"][0], data["spd_houser"].T, strict=True):
        name = " ".join(str(label[0]).split())
        kind = next((kind for kind, pattern in KINDS if re.search(pattern, name)), None)
        wavelengths = np.arange(380.0, 781.0, 5.0)
        emission = normalised(np.maximum(np.interp(EYES.wavelengths_nm, wavelengths, values), 0.0), EYES)
        if kind and not re.search(SAME_PRODUCT, name) and not alike(emission):
            out.append(Tested(kind, name, emission))
    return out


def natural(folder: Path) -> list[Tested]:
    """Daylight of another model than the prior's (Hosek and Wilkie's skies, and sun and sky together), and filaments.

    The filaments are Planck's with an emissivity that falls by up to 12 % over the visible; the prior's vary alike, so they test
    the noise rather than the prior.
    """
    out = []
    for path in sorted((folder / "truth").glob("outdoor*.npz")):
        with np.load(path) as file:
            grid, radiance = file["wavelengths"], file["radiance"].astype(np.float64)
            spectra = [("total", file["total_spd"].astype(np.float64))]
        height, width = radiance.shape[:2]
        rng = np.random.default_rng(1)
        for _ in range(8):
            row, column = rng.integers(0, height // 2), rng.integers(0, width)
            spectra.append((f"sky at {row}, {column}", radiance[row, column]))
        for name, values in spectra:
            on_grid = np.maximum(np.interp(EYES.wavelengths_nm, grid, values), 0.0)
            out.append(Tested("daylight", f"{path.stem}: {name}", normalised(on_grid, EYES)))
    rng = np.random.default_rng(5)
    for kelvin in rng.uniform(1900.0, 3400.0, 20):
        fall = 1.0 - 0.12 * rng.random() * (EYES.wavelengths_nm - 570.0) / 200.0
        filament = planck(np.array([kelvin]), EYES.wavelengths_nm)[0] * fall
        out.append(Tested("incandescent", f"filament {kelvin:.0f} K", normalised(filament, EYES)))
    return out


def spread(every: list[Tested], most: int) -> list[Tested]:
    """At most so many lamps of each family, evenly over the list."""
    out = []
    for family in FAMILIES:
        own = [lamp for lamp in every if lamp.family == family]
        out += own[:: max(1, -(-len(own) // most))]
    return out
