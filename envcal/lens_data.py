"""The fall-off of known lenses, from the Lensfun database. The only module that imports lensfunpy.

A camera and its lens are looked up by the names that the photograph gives them; Lensfun interpolates between the focal
lengths, apertures and distances it was measured at (inverse distance weighting), and its polynomial is ours. Names have to be
the same but for letter case, signs and the maker's name: a lens that is merely called alike is another lens, and is named in
the message instead of being taken.

lensfunpy is MIT, Lensfun's library LGPL-3 and its database CC BY-SA 3.0; nothing of them is part of envcal.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from envcal.errors import EnvcalError

if TYPE_CHECKING:
    from calibrate.exposure import FrameInfo
    from calibrate.lens import Vignetting
    from envcal.config.models import LensByName

#: Where Lensfun puts infinity.
_FAR_M = 1000.0
#: Outside of what was measured by more than this share nothing is known.
_BEYOND = 0.05
#: A fall-off that depends on the unknown focus distance by more than this share in the corners is worth a word.
_UNSURE = 0.02
#: Lenses of which a crop factor differs by less are measured on the same format.
_SAME_CROP = 0.04
#: What makers put between the parts of a name, or leave out.
_FILLERS = frozenset({"zoom", "lens"})
_MOST_NAMED = 8


class UnknownLensError(EnvcalError):
    """A lens whose fall-off is not known; what `merge.lens: auto` tells instead of refusing."""


@dataclass(frozen=True, slots=True)
class KnownLens:
    """A lens of the database as it was set: `corner` is the share of light in the corners, `database` which one it is from,
    `warnings` doubts about it."""

    camera: str
    lens: str
    focal_length_mm: float
    f_number: float
    distance_m: float | None
    vignetting: Vignetting
    corner: float
    database: str
    warnings: tuple[str, ...] = ()


def known_lens(info: FrameInfo, asked: LensByName | None = None, *, database: Path | None = None) -> KnownLens:
    """Return the fall-off of the lens of a frame; `asked` names what the file does not tell, or tells wrongly.

    `database` is a file or folder of Lensfun's XML in place of the one that lensfunpy brings.

    Raises
    ------
    UnknownLensError
        lensfunpy is missing; camera or lens is not in the database, or several are; focal length or aperture is unknown or outside of
        what was measured; no fall-off was measured. The message names what comes nearest.
    EnvcalError
        `database` cannot be read.
    """
    from calibrate.lens import on_sensor

    entries = _entries(database)
    camera = _camera(entries, info, asked)
    lens = _lens(entries, camera, info, asked)
    focal = _set_to(
        "focal length", "focal_length_mm", asked.focal_length_mm if asked else None, info.focal_length_mm, info.name
    )
    f_number = _set_to("aperture", "f_number", asked.f_number if asked else None, info.f_number, info.name)
    distance = (asked.distance_m if asked else None) or info.focus_distance_m
    points = list(lens.calib_vignetting)
    place = f"{info.name}: {lens.model}"
    if not points:
        raise UnknownLensError(
            f"{place}: the lens is in the database, but nobody has measured its fall-off. Photograph a `merge.flat_field`, or set "
            "`merge.lens: off`."
        )
    _inside(place, "focal length", focal, [p.focal for p in points], unit=" mm")
    near = min({p.focal for p in points}, key=lambda value: abs(math.log(value / focal)))
    apertures = [p.aperture for p in points if p.focal == near]
    _inside(place, f"aperture at {near:g} mm", f_number, apertures, open_end=True, unit="", sign="f/")
    scale = lens.crop_factor / camera.crop_factor

    def at(metres: float) -> tuple[float, float, float]:
        found = lens.interpolate_vignetting(focal, min(f_number, max(apertures)), metres)
        if found is None or "PA" not in str(found.model):
            raise UnknownLensError(
                f"{place}: the database has no fall-off for {focal:g} mm, f/{f_number:g}, {metres:g} m. Photograph a "
                "`merge.flat_field`, or set `merge.lens: off`."
            )
        k1, k2, k3 = (float(v) for v in found.terms)
        return on_sensor((k1, k2, k3), scale)

    row = at(min(distance, _FAR_M) if distance else _FAR_M)
    corner = 1 + sum(row)
    warnings = []
    if distance is None:
        nearest = 1 + sum(at(min(p.distance for p in points)))
        if abs(nearest / corner - 1) > _UNSURE:
            warnings.append(
                f"{place}: the file tells no focus distance; infinity is taken. The corners have {corner:.0%} of the light there, and "
                f"{nearest:.0%} at the nearest distance measured. Give `merge.lens: {{name: …, distance_m: …}}`."
            )
    if scale > 1 + _SAME_CROP:
        warnings.append(
            f"{place}: its fall-off was measured on a sensor of crop factor {lens.crop_factor:.3g}, and this one is larger "
            f"({camera.crop_factor:.3g}): the corners are extrapolated. A `merge.flat_field` is surer."
        )
    return KnownLens(
        camera=_whole(camera),
        lens=lens.model,
        focal_length_mm=focal,
        f_number=f_number,
        distance_m=None if distance is None or math.isinf(distance) else distance,
        vignetting=(row, row, row),
        corner=corner,
        database=_version() if database is None else database.name,
        warnings=tuple(warnings),
    )


def database_files(database: Path) -> list[Path]:
    """Return the files of a database: itself, or the XML in a folder."""
    return sorted(database.glob("*.xml")) if database.is_dir() else [database]


def _entries(database: Path | None) -> Any:
    try:
        import lensfunpy  # type: ignore[import-untyped, unused-ignore]
    except ImportError:
        raise UnknownLensError(
            "merge.lens: the package lensfunpy is not installed; the data of known lenses come with it. Install it with `pip install "
            "'envcal[lens]'`, or set `merge.lens: off`."
        ) from None
    # What a system or a user has beside it would make the result depend on the machine.
    if database is None:
        return lensfunpy.Database(load_common=False, load_bundled=True)
    try:
        files = [str(file) for file in database_files(database)]
        entries = lensfunpy.Database(paths=files, load_common=False, load_bundled=False)
    except lensfunpy.LensfunError as error:
        raise EnvcalError(
            f"{database}: cannot be read as a Lensfun database ({error or type(error).__name__}). Give a file of its XML, or a "
            "folder of such files."
        ) from None
    if not entries.lenses:
        raise EnvcalError(f"{database}: holds no lens. Give a file of Lensfun's XML, or a folder of such files.")
    return entries


def _version() -> str:
    import lensfunpy  # type: ignore[import-untyped, unused-ignore]

    return f"lensfunpy {lensfunpy.__version__}"


def _camera(entries: Any, info: FrameInfo, asked: LensByName | None) -> Any:
    name = (asked.camera if asked else None) or info.camera
    found = [c for c in entries.cameras if name in (c.model, _whole(c))]
    found = found or [c for c in entries.cameras if name and _plain(_whole(c)) == _plain(name)]
    found = found or [c for c in entries.cameras if name and _plain(c.model) == _plain(name)]
    if len({(c.mount, c.crop_factor) for c in found}) == 1:
        return found[0]
    near = found or entries.find_cameras(None, name, loose_search=True) if name else []
    _refuse(
        info.name,
        f"the camera {name!r}" if name else "no camera in the file",
        found,
        [f"{_whole(c)} (crop factor {c.crop_factor:.3g})" for c in near],
        "camera",
    )
    return None


def _lens(entries: Any, camera: Any, info: FrameInfo, asked: LensByName | None) -> Any:
    name = asked.name if asked else info.lens
    fits = entries.find_lenses(camera, None, None)
    if name:
        found = [lens for lens in fits if lens.model == name]
        found = found or [lens for lens in fits if _bare(lens.model, lens.maker) == _bare(name, lens.maker)]
    else:
        # A camera with a lens that cannot be changed: its mount, written small, is its own.
        found = fits if camera.mount[:1].islower() else []
    # The same lens is often measured on several formats: that nearest to this one from below shows it to the corners.
    covering = [lens for lens in found if lens.crop_factor <= camera.crop_factor * (1 + _SAME_CROP)]
    if covering:
        largest = max(lens.crop_factor for lens in covering)
        found = [lens for lens in covering if lens.crop_factor >= largest * (1 - _SAME_CROP / 2)]
    measured = [lens for lens in found if lens.calib_vignetting]
    found = measured or found
    if len(found) == 1 or (found and len({_terms(lens) for lens in found}) == 1):
        return found[0]
    near = found or (entries.find_lenses(camera, None, name, loose_search=True) if name else [])
    _refuse(
        info.name,
        f"the lens {name!r} on {_whole(camera)}" if name else f"no lens in the file, on {_whole(camera)}",
        found,
        [lens.model for lens in near] if not found else sorted(lens.model for lens in found),
        "name",
    )
    return None


def _refuse(frame: str, what: str, found: Sequence[Any], near: Sequence[str], key: str) -> Any:
    names = list(dict.fromkeys(near))[:_MOST_NAMED]
    state = (
        f"is {len(found)} times in the lens database, with different data" if found else "is not in the lens database"
    )
    nearest = f" Nearest: {'; '.join(names)}." if names else " Nothing in it has a similar name."
    raise UnknownLensError(
        f"{frame}: {what}: {state}; one entry is expected.{nearest} Name it in `merge.lens: {{name: …"
        f"{', camera: …' if key == 'camera' else ''}}}`, photograph a `merge.flat_field`, or set `merge.lens: off`."
    )


def _set_to(word: str, key: str, asked: float | None, told: float | None, frame: str) -> float:
    value = asked or told
    if not value:
        raise UnknownLensError(
            f"{frame}: no {word} in the file; the fall-off depends on it. Give `merge.lens: {{name: …, {key}: …}}`."
        )
    return value


def _inside(
    place: str, word: str, value: float, measured: Sequence[float], *, open_end: bool = False, unit: str, sign: str = ""
) -> None:
    low, high = min(measured), max(measured)
    # Stopped down further, a lens's fall-off is the geometry's alone, and stays.
    if low * (1 - _BEYOND) <= value and (open_end or value <= high * (1 + _BEYOND)):
        return
    raise UnknownLensError(
        f"{place}: {word} {sign}{value:g}{unit}; its fall-off was measured from {sign}{low:.3g} to {sign}{high:.3g}{unit}. Correct it in "
        "`merge.lens`, photograph a `merge.flat_field`, or set `merge.lens: off`."
    )


def _whole(camera: Any) -> str:
    """Maker and model as `FrameInfo.camera` has them."""
    maker, model = str(camera.maker), str(camera.model)
    return model if model.casefold().startswith(maker.casefold()) else f"{maker} {model}"


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9*+]", "", name.casefold())


def _bare(name: str, maker: str) -> str:
    """A lens's name without its maker's and without fillers, which photographs and database write or leave out."""
    words = re.findall(r"[a-z0-9.*+]+", name.casefold().replace("f/", "f"))
    dropped = set(re.findall(r"[a-z0-9]+", maker.casefold())) | _FILLERS
    return "".join(re.sub(r"[.]", "", word) for word in words if word not in dropped)


def _terms(lens: Any) -> tuple[Any, ...]:
    return (
        lens.crop_factor,
        *sorted((p.focal, p.aperture, p.distance, *p.terms) for p in lens.calib_vignetting),
    )
