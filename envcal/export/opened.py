"""An uplift file opened for export, and its pixels by bands of rows: their coefficients, colours and light."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from envcal import exr
from envcal.errors import EnvcalError
from envcal.unit import Unit, unit_of
from envcal.uplift_file import About, read_about
from uplift.radiance import rgb_of
from uplift.spectrum import Observer, RGBSpace, observer, rgb_space

Float64 = npt.NDArray[np.float64]

#: The largest finite half float.
LARGEST_HALF = 65504.0
#: Pixels that are held at a time.
TILE_PIXELS = 1 << 20


@dataclass(frozen=True, slots=True, eq=False)
class Opened:
    """An uplift file: its header, what it says of itself, and the observer and space in which its RGB is exact."""

    path: Path
    header: exr.Header
    about: About
    observer: Observer
    space: RGBSpace

    @property
    def size(self) -> tuple[int, int]:
        """(height, width)."""
        return self.header.size

    @property
    def unit(self) -> Unit | None:
        """The unit of its RGB; None is relative."""
        return unit_of(self.path, self.header.attributes)

    @property
    def wavelengths_nm(self) -> Float64:
        """The grid [N] of the emissions."""
        return self.observer.wavelengths_nm


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """Rows from `top`: `coefficients` [rows, W, 3] for λ in nm, `scale` [rows, W], `cluster` [rows, W]."""

    top: int
    coefficients: npt.NDArray[np.float32]
    scale: npt.NDArray[np.float32]
    cluster: npt.NDArray[np.uint32]

    def rgb(self, opened: Opened) -> Float64:
        """Linear RGB [rows, W, 3] of the spectra, in the file's own space; 0 where there is no radiance."""
        return rgb_of(
            self.coefficients,
            self.scale,
            self.cluster,
            opened.about.emissions(),
            observer=opened.observer,
            space=opened.space,
        )


def open_uplift(path: Path) -> Opened:
    """Read what an uplift file says of itself; an `EnvcalError` if it is none, or if there is no light in it."""
    header, about = read_about(path)
    grid = about.wavelengths_nm
    seen = observer(grid[0], grid[-1], (grid[-1] - grid[0]) / (len(grid) - 1), about.observer)
    # The first rows of most maps shine, so this ends at once.
    if not any((planes["scale"] > 0).any() for _, planes in exr.bands(path, ["scale"], rows=64)):
        raise EnvcalError(
            f"{path}: there is no light in it: no pixel has radiance, so nothing would be lit. Look at the map it was made of: "
            f"black, or without data, everywhere?"
        )
    return Opened(path, header, about, seen, rgb_space(about.space, observer=seen))


def guesses(about: About, consequence: str) -> str:
    """Return a paragraph for a README, with a blank line before it, where the kind of no light is known; else nothing."""
    if not undeclared(about):
        return ""
    return f"""
**The kind of no light of this map is known**: all its spectra are smooth guesses. {consequence} If you know the lamps, declare
them (`envcal uplift MAP --lights lights.yaml`, or `cluster: lights` in pipeline.yaml) and export again.
"""


def refuse_overwriting(source: Path, folder: Path, names: Iterable[str]) -> None:
    """Refuse a folder in which a file of one of these names is the uplift file itself, also by way of links."""
    for name in names:
        out = folder / name
        if out.exists() and out.samefile(source):
            raise EnvcalError(
                f"{source}: the output {out} is the input, and would overwrite it. Give another folder to -o."
            )


def kelvin(cct: float | None) -> str:
    """Return a colour temperature for a table; a dash where there is none."""
    return "–" if cct is None else f"{cct:.0f} K"


def undeclared(about: About) -> list[str]:
    """Return a hint to declare the lights if the kind of none of them is known: their spectra are then guesses."""
    lights = [cluster for cluster in about.clusters if cluster.type != "fallback"]
    if about.method != "constrained" or not lights or any(light.type != "smooth" for light in lights):
        return []
    return [
        "the kind of no light is known, so all spectra are smooth guesses. If you know the lamps, declare them (`envcal "
        "uplift MAP --lights lights.yaml`, or `cluster: lights` in pipeline.yaml; docs/stages/cluster.md says how)."
    ]


def bands(opened: Opened) -> Iterator[Band]:
    """Yield the map from the top, some rows at a time."""
    rows = max(1, TILE_PIXELS // opened.size[1])
    count = len(opened.about.clusters)
    for top, planes in exr.bands(opened.path, ["c0", "c1", "c2", "scale", "cluster"], rows=rows):
        if int(planes["cluster"].max()) >= count:
            raise EnvcalError(
                f"{opened.path}: names emission {int(planes['cluster'].max())}, but holds {count}. Run `envcal uplift` "
                f"again."
            )
        coefficients = np.stack([planes["c0"], planes["c1"], planes["c2"]], axis=-1)
        yield Band(top, coefficients, planes["scale"], planes["cluster"])


def conversion(source: RGBSpace, target: RGBSpace) -> Float64:
    """Linear RGB [3, 3] of `target` from that of `source`, white to white by Bradford's adaptation.

    White stays white, as in the conversions of the ACES configurations of OpenColorIO: a light of D65 is (1, 1, 1) in
    every space. Between spaces of the same white the adaptation is the identity.
    """
    from calibrate.adapt import CONE_FROM_XYZ

    cones = CONE_FROM_XYZ["Bradford"]
    white = source.xyz_from_rgb.sum(axis=1)
    wanted = target.xyz_from_rgb.sum(axis=1)
    adapted = np.linalg.inv(cones) @ np.diag((cones @ wanted) / (cones @ white)) @ cones
    return np.asarray(target.rgb_from_xyz @ adapted @ source.xyz_from_rgb)
