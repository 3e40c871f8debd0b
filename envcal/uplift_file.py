"""The uplift file: one EXR that anybody can read, and that is all a renderer needs.

Format 1, of the methods `constrained` and `scaled`, has the channels c0, c1, c2 and scale (float32), cluster (uint32:
which emission), status (uint32: how the pixel was solved) and R, G, B for a preview; the header's `envcalUplift` holds
the wavelength grid and the emissions as JSON. Radiance at a wavelength λ in nm is
scale · E_cluster(λ) · S(c0 λ² + c1 λ + c2) with S(x) = ½ + x/(2√(1 + x²)).

Format 2, of the method `lattice`, has cell (uint32), u, v and w (float32) instead of coefficients, and the
lattice's nodes in its header; S is then mixed from the eight nodes around the cell. Its channels have other names so that
a reader which knows format 1 alone finds none, instead of taking positions for coefficients.
"""

from __future__ import annotations

import base64
import binascii
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from envcal import exr
from envcal.errors import EnvcalError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from uplift.lattice import Cube
    from uplift.spectrum import Observer

_COMMON = dict.fromkeys(("scale", "R", "G", "B"), "f4") | {"cluster": "u4", "status": "u4"}
CHANNELS = dict.fromkeys(("c0", "c1", "c2"), "f4") | _COMMON
LATTICE_CHANNELS = {"cell": "u4"} | dict.fromkeys("uvw", "f4") | _COMMON
ATTRIBUTE = "envcalUplift"


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Emission(_Record):
    """The light of one cluster."""

    type: str
    cct: float | None
    duv: float | None
    source: str
    confidence: float
    emission: list[float]


class _Head(_Record):
    """What every uplift file says."""

    space: str
    observer: str
    wavelengths_nm: list[float] = Field(min_length=4)
    clusters: list[Emission] = Field(max_length=64)
    status: dict[str, str]

    def emissions(self) -> npt.NDArray[np.float64]:
        """The emissions [clusters, wavelengths]; Σ ȳ·E·Δλ = 1."""
        return np.asarray([cluster.emission for cluster in self.clusters], np.float64)

    def seen(self) -> Observer:
        """The colour matching functions on the file's grid."""
        from uplift.spectrum import observer

        grid = self.wavelengths_nm
        return observer(grid[0], grid[-1], (grid[-1] - grid[0]) / (len(grid) - 1), self.observer)


class About(_Head):
    """What the header of a file of coefficients says."""

    format: Literal[1] = 1
    method: str
    model: str = "scale * E[cluster](w) * S(c0*w*w + c1*w + c2), S(x) = 1/2 + x / (2*sqrt(1 + x*x)), w in nm"


class CubeRecord(_Record):
    """The nodes of a lattice: `coefficients` are [size, size, size, 3] float64, little-endian, in base64."""

    size: int = Field(ge=3, le=128)
    coefficients: str

    @classmethod
    def of(cls, cube: Cube) -> CubeRecord:
        """Write down the nodes of a cube; empty ones are NaN."""
        values = np.where(cube.filled[..., np.newaxis], cube.coefficients, np.nan)
        return cls(size=len(values), coefficients=base64.b64encode(values.astype("<f8").tobytes()).decode("ascii"))

    def nodes(self) -> npt.NDArray[np.float64]:
        """The coefficients [size, size, size, 3]; ValueError where they are damaged."""
        try:
            data = base64.b64decode(self.coefficients, validate=True)
        except binascii.Error:
            raise ValueError("the nodes of the lattice are no base64") from None
        if len(data) != self.size**3 * 24:
            raise ValueError(f"the lattice has {len(data)} bytes of nodes, and {self.size}³ nodes need another number")
        return np.frombuffer(data, "<f8").reshape(self.size, self.size, self.size, 3).astype(np.float64)


class LatticeAbout(_Head):
    """What the header of a file of mixtures says."""

    format: Literal[2] = 2
    method: Literal["lattice"] = "lattice"
    model: str = (
        "scale * E[cluster](wavelength) * sum over i, j, k in {0, 1} of U[i]*V[j]*W[k]*S((A*t + B)*t + C), "
        "U = (1-u, u), V = (1-v, v), W = (1-w, w), A, B, C = coefficients[x+i, y+j, z+k], "
        "cell = (x*(size-1) + y)*(size-1) + z, S(x) = 1/2 + x / (2*sqrt(1 + x*x)), "
        "t from -1 at the first of wavelengths_nm to 1 at the last"
    )
    cube: CubeRecord

    def lattice_cube(self) -> Cube:
        """The nodes as `uplift.lattice` takes them; ValueError where they are damaged."""
        from uplift.lattice import Cube
        from uplift.spectrum import rgb_space

        nodes, seen = self.cube.nodes(), self.seen()
        t = np.linspace(-1.0, 1.0, len(self.wavelengths_nm))
        filled = np.asarray(np.isfinite(nodes).all(axis=3), np.bool_)
        return Cube(
            seen, rgb_space(self.space, observer=seen), t, np.where(filled[..., np.newaxis], nodes, 0.0), filled
        )


AnyAbout = Annotated[About | LatticeAbout, Field(discriminator="format")]
_ABOUT: TypeAdapter[About | LatticeAbout] = TypeAdapter(AnyAbout)


def read_about(path: Path) -> tuple[exr.Header, About]:
    """Read what an uplift file of coefficients says of itself; one of mixtures is refused."""
    header, about = read_any_about(path)
    if isinstance(about, LatticeAbout):
        raise EnvcalError(
            f"{path}: was made with the method lattice: each pixel is a mixture of eight spectra, and three coefficients "
            f"are needed here. Make it again with `envcal uplift --method constrained`, or get its bands with `envcal "
            f"spectra`."
        )
    return header, about


def read_any_about(path: Path) -> tuple[exr.Header, About | LatticeAbout]:
    """Read what an uplift file of either format says of itself."""
    if path.is_dir():
        raise EnvcalError(f"{path}: is a folder; an uplift file is expected. {_file_within(path)}")
    if path.suffix.lower() == ".hdr" and path.is_file():
        raise EnvcalError(f"{path}: is not an uplift file, which is an .exr. {_made_of(path)}")
    header = exr.header(path)
    if ATTRIBUTE not in header.attributes:
        raise EnvcalError(f"{path}: is not an uplift file: it has no `{ATTRIBUTE}` in its header. {_remedy(header)}")
    value = header.json(ATTRIBUTE)
    if isinstance(value, dict) and isinstance(value.get("format"), int) and value["format"] not in (1, 2):
        raise EnvcalError(
            f"{path}: has the format {value['format']}, and this version of envcal reads 1 and 2. Update envcal, or make "
            f"the file again with `envcal uplift`."
        )
    try:
        about = _ABOUT.validate_python(value)
        if any(len(cluster.emission) != len(about.wavelengths_nm) for cluster in about.clusters):
            raise ValueError("an emission has not one value per wavelength")
        if isinstance(about, LatticeAbout):
            about.cube.nodes()
    except (ValidationError, ValueError) as error:
        first = str(error).splitlines()[0]
        raise EnvcalError(
            f"{path}: its `{ATTRIBUTE}` is damaged ({first}). Make it again with `envcal uplift`."
        ) from None
    absent = [name for name in channels(about) if name not in header.channels and name != "status"]
    if absent:
        raise EnvcalError(
            f"{path}: is damaged: it has no channel {', '.join(absent)}. Make it again with `envcal uplift`."
        )
    return header, about


def _file_within(folder: Path) -> str:
    """Say which file of a folder was probably meant."""
    meant = (folder / "uplift" / "environment.exr", folder / "environment.exr")
    found = next((path for path in meant if path.is_file() and ATTRIBUTE in exr.header(path).attributes), None)
    return (
        f"Give {found}." if found else "Give the file that `envcal uplift` writes (of a run: uplift/environment.exr)."
    )


def _made_of(path: Path) -> str:
    return f"Make one of it: `envcal uplift {path} -o {path.with_name(path.stem + '_uplift.exr')}`."


def _remedy(header: exr.Header) -> str:
    """Say how to come to an uplift file from another file of ours, or from a map."""
    path, planes = header.path, header.channels
    if "cluster" in planes:
        return (
            "It holds the lights that `envcal cluster` found in a map: give both to the uplift, `envcal uplift MAP "
            f"--clusters {path} -o {path.with_name(path.stem + '_uplift.exr')}`, and what that writes here."
        )
    if "spectralLayoutVersion" in header.attributes or any(name.startswith("S0.") for name in planes):
        return (
            "It is a spectral image, as `envcal spectra` makes it of an uplift file: give the uplift file itself (of a "
            "run: uplift/environment.exr)."
        )
    if set("RGB") <= set(planes):
        return _made_of(path)
    return "Give the file that `envcal uplift` writes (of a run: uplift/environment.exr)."


def channels(about: About | LatticeAbout) -> dict[str, str]:
    """The channels of a file, with their types."""
    return LATTICE_CHANNELS if isinstance(about, LatticeAbout) else CHANNELS


class Radiance:
    """Spectral radiance of the pixels of an uplift file of either format.

    `channels` are those that it needs. Raises EnvcalError if the header's lattice is damaged.
    """

    def __init__(self, path: Path, about: About | LatticeAbout, wavelengths_nm: npt.ArrayLike) -> None:
        self._path, self._seen, self._emissions = path, about.seen(), about.emissions()
        self._wavelengths = np.asarray(wavelengths_nm, dtype=np.float64)
        self._cube = about.lattice_cube() if isinstance(about, LatticeAbout) else None
        self.channels = [name for name in channels(about) if name not in ("R", "G", "B", "status")]

    def __call__(self, planes: Mapping[str, npt.NDArray[Any]]) -> npt.NDArray[np.float32]:
        """Return [..., wavelengths] of the pixels in `planes` [...]; EnvcalError where they name what is not there."""
        from uplift.radiance import spectra_of

        cluster = planes["cluster"]
        if cluster.size and int(cluster.max()) >= len(self._emissions):
            raise EnvcalError(f"{self._path}: names an emission it does not hold. Run `envcal uplift` again.")
        if self._cube is None:
            coefficients = np.stack([planes["c0"], planes["c1"], planes["c2"]], axis=-1)
            return np.asarray(
                spectra_of(
                    coefficients,
                    planes["scale"],
                    cluster,
                    self._emissions,
                    self._wavelengths,
                    observer=self._seen,
                    dtype=np.float32,
                )
            )
        from uplift.lattice import spectra_of_lattice

        cell, position = planes["cell"], np.stack([planes["u"], planes["v"], planes["w"]], axis=-1)
        if cell.size and int(cell.max()) >= (len(self._cube.filled) - 1) ** 3:
            raise EnvcalError(f"{self._path}: names a cell its lattice does not have. Run `envcal uplift` again.")
        return np.asarray(
            spectra_of_lattice(
                cell,
                position,
                planes["scale"],
                cluster,
                self._emissions,
                self._cube,
                wavelengths_nm=self._wavelengths,
                dtype=np.float32,
            )
        )
