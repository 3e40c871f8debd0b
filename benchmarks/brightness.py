"""Which brightness factor of R relights best: the true spectra of rooms under many lamps against uplifted ones.

A pixel's true spectrum P is known, and so is its lamp's E. P's RGB is uplifted under E with one factor after the other;
then both spectra light a set of reflectances, as the pixel does when it lights a scene. ΔE2000 between the two, mean over
pixels and reflectances, is the relight error (the measure of Tódová and Wilkie 2024). The uplift is exact, so the two
agree on a white; what differs is everything else.

**Normalisation.** In CIELAB the white is the true pixel's own XYZ: an eye adapted to that pixel alone. With `--white
space` it is the working space's white at the pixel's luminance instead, an eye that stays adapted to D65.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from uplift.difference import delta_e_2000
from uplift.illuminants import FAMILIES, cct_duv_of, family_emission
from uplift.pixels import uplift_pixels
from uplift.radiance import spectra_of
from uplift.scaled import uplift_scaled
from uplift.spectrum import Observer, RGBSpace, illuminant, normalised, observer, rgb_space
from uplift.table import build_table

Float64 = npt.NDArray[np.float64]

FACTORS = (1.2, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0)
PAPER = 2.0
SPACES = ("ITU-R BT.2020", "sRGB")
_SINGLE = {
    "daylight": [f"D{n}" for n in (50, 55, 60, 65, 75)],
    "sunset": [],
    "led": [f"LED-{n}" for n in ("B1", "B2", "B3", "B4", "B5", "BH1", "RGB1", "V1", "V2")],
    "fluorescent": [f"FL{n}" for n in range(1, 13)] + [f"FL3.{n}" for n in range(1, 16)],
    "discharge": [f"HP{n}" for n in range(1, 6)],
    "incandescent": ["A"],
}
_BY_CCT = {
    "daylight": (8000.0, 12000.0, 20000.0),
    "sunset": (2200.0, 2600.0, 3200.0, 4000.0, 5000.0),
    "led": (1700.0, 2000.0, 9000.0, 15000.0),
    "incandescent": (1000.0, 1300.0, 1600.0, 2000.0, 2500.0, 3000.0),
}
LAMP_FAMILIES = tuple(_SINGLE)


@dataclass(frozen=True, slots=True)
class Lamp:
    """A lamp: its family, its name, and its emission [N]."""

    family: str
    name: str
    emission: Float64


@dataclass(frozen=True, slots=True)
class Error:
    """The mean ΔE2000 of one lamp in one space; `factor` None is the scaled uplift under D65."""

    lamp: Lamp
    space: str
    factor: float | None
    delta_e: float


def lamps(eyes: Observer, *, folder: Path | None = None, every: int = 1) -> list[Lamp]:
    """Return every n-th lamp of each family; `folder` may hold `led19_measured.csv` with more LEDs."""
    out = []
    for family in LAMP_FAMILIES:
        found = [Lamp(family, name, illuminant(name, eyes)) for name in _SINGLE[family]]
        for cct in _BY_CCT.get(family, ()):
            kelvin = float(np.clip(cct, FAMILIES[family].low_k, FAMILIES[family].high_k))
            found.append(Lamp(family, f"{family} {kelvin:.0f} K", family_emission(family, kelvin, eyes)))
        if family == "led" and folder is not None and (folder / "led19_measured.csv").is_file():
            found += _measured_leds(folder / "led19_measured.csv", eyes)
        out += found[::every]
    return out


def _measured_leds(path: Path, eyes: Observer) -> list[Lamp]:
    """The rows of a CSV whose columns are, among others, `name` and the wavelengths in nm."""
    import csv

    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    grid = [column for column in rows[0] if column and column.isdigit()]
    out = []
    for row in rows:
        values = np.interp(eyes.wavelengths_nm, [float(w) for w in grid], [float(row[w]) for w in grid])
        out.append(Lamp("led", f"measured {row['name']}", normalised(np.maximum(values, 0), eyes)))
    return out


def chart(eyes: Observer) -> Float64:
    """Return the 24 patches of a ColorChecker [24, N], held constant outside of what was measured."""
    from colour.characterisation import SDS_COLOURCHECKERS

    patches = SDS_COLOURCHECKERS["BabelColor Average"].values()
    return np.array([np.interp(eyes.wavelengths_nm, sd.wavelengths, sd.values) for sd in patches])


def reflectances(eyes: Observer, *, folder: Path | None = None, chips: int = 48) -> Float64:
    """Return what is lit [n, N]: the ColorChecker, and `chips` of the Munsell book, evenly through its pages."""
    out = chart(eyes)
    if folder is None:
        return out
    with np.load(folder / "munsell_glossy_1485.npz") as book:
        grid, every = book["wavelength"], book["reflectance"]
    chosen = every[np.linspace(0, len(every) - 1, chips).round().astype(int)]
    return np.concatenate([out, [np.interp(eyes.wavelengths_nm, grid, chip) for chip in chosen]])


def transports(eyes: Observer, *, folder: Path | None = None, stride: int = 8) -> Float64:
    """Return P/E [n, N] of pixels: those of every `stride`-th row and column of `folder`'s rooms.

    Without rooms: light that has met one patch of the ColorChecker, or two, one after the other.
    """
    if folder is None:
        one = chart(eyes)
        first, second = np.triu_indices(len(one))
        return np.concatenate([one, one[first] * one[second]])
    out = []
    for path in sorted((folder / "truth").glob("room*.npz")):
        with np.load(path) as room:
            # The lamp groups of a room, all with the same lamp.
            coarse = room["transport"][:, stride // 2 :: stride, stride // 2 :: stride].astype(np.float64).sum(axis=0)
            grid = room["wavelengths"]
        to_grid = np.stack([np.interp(eyes.wavelengths_nm, grid, row) for row in np.eye(grid.size)])
        out.append(coarse.reshape(-1, grid.size) @ to_grid)
    if not out:
        raise FileNotFoundError(f"{folder / 'truth'}: holds no room*.npz")
    return np.concatenate(out)


def relight_error(
    true: Float64, uplifted: Float64, surfaces: Float64, eyes: Observer, space: RGBSpace, *, white: str = "pixel"
) -> float:
    """Return the mean ΔE2000 of `surfaces` [m, N] lit by `true` and by `uplifted` [n, N]; see the module for `white`."""
    responses = (
        (surfaces[:, :, None] * eyes.cmfs * eyes.step_nm).transpose(1, 0, 2).reshape(eyes.wavelengths_nm.size, -1)
    )
    own = true @ eyes.cmfs * eyes.step_nm
    scale = space.xyz_from_rgb.sum(axis=1) / own if white == "pixel" else 1 / own[:, 1:2]
    lit = [(spectra @ responses).reshape(len(true), -1, 3) * scale[:, None] for spectra in (true, uplifted)]
    as_rgb = [xyz @ space.rgb_from_xyz.T for xyz in lit]
    return float(delta_e_2000(as_rgb[0], as_rgb[1], space).mean())


def errors(
    lamp: Lamp,
    paths: Float64,
    surfaces: Float64,
    eyes: Observer,
    space: RGBSpace,
    *,
    factors: Sequence[float] = FACTORS,
    white: str = "pixel",
    given: str = "true",
) -> Iterator[Error]:
    """Yield the error of one lamp for each factor, then that of the scaled uplift.

    `given` "true": the uplift knows the lamp's spectrum; "smooth": its colour temperature alone, as of an undeclared one.
    """
    true = paths * lamp.emission
    rgb = (true @ eyes.cmfs * eyes.step_nm @ space.rgb_from_xyz.T)[None]
    alone = np.zeros(rgb.shape[:2], np.uint32)
    emission = lamp.emission if given == "true" else _smooth(lamp, eyes)
    for factor in (*factors, None):
        if factor is None:
            found = uplift_scaled(rgb, observer=eyes, space=space)
        else:
            table = build_table(emission, observer=eyes, space=space, factor=factor)
            found = uplift_pixels(rgb, alone, [table])
        spectra = spectra_of(
            found.coefficients, found.scale, found.emission, found.emissions, eyes.wavelengths_nm, observer=eyes
        )[0]
        yield Error(lamp, space.name, factor, relight_error(true, spectra, surfaces, eyes, space, white=white))


def _smooth(lamp: Lamp, eyes: Observer) -> Float64:
    low, high = FAMILIES["smooth"].low_k, FAMILIES["smooth"].high_k
    return family_emission("smooth", float(np.clip(cct_duv_of(lamp.emission, eyes)[0], low, high)), eyes)


def by_family(found: Sequence[Error]) -> dict[tuple[str, str], dict[float | None, float]]:
    """Return (space, family) → factor → mean over the family's lamps."""
    out: dict[tuple[str, str], dict[float | None, list[float]]] = {}
    for error in found:
        out.setdefault((error.space, error.lamp.family), {}).setdefault(error.factor, []).append(error.delta_e)
    return {key: {factor: float(np.mean(each)) for factor, each in row.items()} for key, row in out.items()}


def admissible(found: Sequence[Error]) -> list[float]:
    """Return the factors whose error is no higher than at 2 in any family and space."""
    rows = by_family(found).values()
    factors = [factor for factor in next(iter(rows)) if factor is not None]
    return [factor for factor in factors if all(row[factor] <= row[PAPER] for row in rows)]


def report(found: Sequence[Error]) -> str:
    """The table: a row a space and family, a column a factor; then how each factor stands to 2."""
    rows = by_family(found)
    factors = [factor for factor in next(iter(rows.values())) if factor is not None]
    head = " ".join(f"{factor:>6g}" for factor in factors)
    lines = [f"{'':14} {'':13} {'lamps':>5}  {head}  {'scaled':>6}"]
    for (space, family), row in rows.items():
        count = len({e.lamp.name for e in found if (e.space, e.lamp.family) == (space, family)})
        cells = " ".join(f"{row[factor]:6.3f}" for factor in factors)
        lines.append(f"{space:14} {family:13} {count:5d}  {cells}  {row[None]:6.3f}")
    for space in dict.fromkeys(space for space, _ in rows):
        own = [row for (name, _), row in rows.items() if name == space]
        cells = " ".join(f"{np.mean([row[f] for row in own]):6.3f}" for f in factors)
        lines.append(f"{space:14} {'all families':13} {'':5}  {cells}  {np.mean([row[None] for row in own]):6.3f}")
    ratios = " ".join(f"{np.exp(np.mean([np.log(r[f] / r[PAPER]) for r in rows.values()])):6.3f}" for f in factors)
    worst = " ".join(f"{max(r[f] / r[PAPER] for r in rows.values()):6.3f}" for f in factors)
    lines.append(f"{'ratio to 2':14} {'families':13} {'mean':>5}  {ratios}")
    lines.append(f"{'':14} {'':13} {'worst':>5}  {worst}")
    single: dict[tuple[str, str], dict[float | None, float]] = {}
    for error in found:
        single.setdefault((error.space, error.lamp.name), {})[error.factor] = error.delta_e
    worst = " ".join(f"{max(r[f] / r[PAPER] for r in single.values()):6.3f}" for f in factors)
    lines.append(f"{'':14} {'single lamps':13} {'worst':>5}  {worst}")
    lines.append(f"no higher than at 2 in any family: {', '.join(f'{f:g}' for f in admissible(found))}")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Measure, print the table; return 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks brightness", description=__doc__.splitlines()[0])
    parser.add_argument("--every", type=int, default=1, help="take every n-th lamp of a family")
    parser.add_argument("--stride", type=int, default=8, help="take every n-th row and column of a room")
    parser.add_argument("--factors", default=",".join(f"{f:g}" for f in FACTORS), help="comma-separated; 2 is added")
    parser.add_argument("--white", choices=["pixel", "space"], default="pixel", help="CIELAB's white")
    parser.add_argument("--given", choices=["true", "smooth"], default="true", help="what the uplift knows of the lamp")
    parser.add_argument("--family", choices=LAMP_FAMILIES, help="one family alone")
    parser.add_argument("--json", type=Path, help="also write the figures there")
    options = parser.parse_args(arguments)
    given = os.environ.get("ENVCAL_DATA")
    folder = Path(given) if given else None
    print(
        "rooms and Munsell chips of ENVCAL_DATA" if folder else "ENVCAL_DATA is not set: products of chart patches only"
    )
    factors = sorted({PAPER, *(float(f) for f in options.factors.split(","))})
    eyes = observer()
    paths = transports(eyes, folder=folder, stride=options.stride)
    surfaces = reflectances(eyes, folder=folder)
    chosen = [lamp for lamp in lamps(eyes, folder=folder, every=options.every) if options.family in (None, lamp.family)]
    print(
        f"{len(chosen)} lamps, {len(paths)} pixels, {len(surfaces)} reflectances, white: {options.white}, spectrum: {options.given}\n"
    )
    found: list[Error] = []
    for name in SPACES:
        space = rgb_space(name, observer=eyes)
        for done, lamp in enumerate(chosen):
            found += errors(
                lamp, paths, surfaces, eyes, space, factors=factors, white=options.white, given=options.given
            )
            if sys.stderr.isatty():
                print(f"\r{name}: {done + 1} of {len(chosen)}", end="", file=sys.stderr)
    print(report(found))
    if options.json:
        rows = [
            {"space": e.space, "family": e.lamp.family, "lamp": e.lamp.name, "factor": e.factor, "delta_e": e.delta_e}
            for e in found
        ]
        options.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    return 0
