"""RAW bracket → radiance in camera RGB."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from envcal import exr, provenance
from envcal.atomic import digest
from envcal.config import MergeSettings
from envcal.errors import EnvcalError
from envcal.profile import Camera
from envcal.reporter import Progress, silent
from envcal.runner import Outcome

if TYPE_CHECKING:
    from calibrate.align import Displacement
    from calibrate.deghost import Ghosts
    from calibrate.exposure import FrameInfo
    from calibrate.lens import Vignetting
    from calibrate.merge import Measured, Merged, MosaicFrame
    from envcal.raw import RawFrame


def merge(frames: Sequence[Path], out: Path, settings: MergeSettings, *, progress: Progress = silent) -> Outcome:
    """Merge RAW `frames` in the mosaic, demosaic once, and write R, G, B and the mask `lost` to `out`.

    Values are camera RGB: 1 is a count at the white level in one second. A pixel clipped in every frame is NaN in
    the channels that need it, unless a fill is asked for, and 1 in `lost`.
    """
    from calibrate.demosaic import demosaic, lost_pixels
    from calibrate.exposure import check_bracket
    from calibrate.lens import remove_vignetting
    from calibrate.lost import lost_share
    from calibrate.merge import measure_bracket, merge_mosaics
    from envcal.raw import KEPT_IF_MOVED, KEPT_MOSAICS, camera_from_xyz, open_bracket

    opened = open_bracket(frames, keep=KEPT_IF_MOVED if settings.align else KEPT_MOSAICS)
    raws = [raw.described(**changes_of(raw.path.name, settings)) for raw in opened]
    del opened
    check_bracket([raw.info for raw in raws], mixed_iso=settings.mixed_iso, mixed_aperture=settings.mixed_aperture)
    infos = [raw.info for raw in raws]
    vignetting, lens, doubts = fall_off(settings, infos)
    # The merge uses one core at times; the files are read for their digests meanwhile.
    pool = ThreadPoolExecutor(1)
    digests = pool.submit(lambda: {path: digest(path) for path in frames})
    pool.shutdown(wait=False)
    asked = _asked(settings, raws)
    measured = measure_bracket(raws, asked)
    placed, displaced, moves = _placed(raws, measured, settings)
    if any(d.moved for d in displaced):
        measured = measure_bracket(placed, asked)
    ghosts = _ghosts(placed, measured, settings)
    merged = merge_mosaics(
        placed,
        measured=measured,
        defects=settings.defects,
        mixed_iso=settings.mixed_iso,
        mixed_aperture=settings.mixed_aperture,
        deviation=settings.deviation,
        ghosts=None if ghosts is None else ghosts.masks,
        progress=progress,
    )
    info = infos[0]
    # Mixed brackets are merged in units of the lowest ISO and the smallest opening.
    iso = min((one.iso for one in infos if one.iso), default=None)
    f_number = max((one.f_number for one in infos if one.f_number), default=None)
    del raws, placed
    image = demosaic(merged.mosaic, merged.cfa, method=settings.demosaic)
    lost = lost_pixels(image)
    share = lost_share(lost)
    image, warnings = _filled(image, merged, settings, share)
    warnings += doubts
    if vignetting is not None:
        image = remove_vignetting(image, vignetting)
    camera = Camera(model=info.camera, lens=info.lens, iso=iso, f_number=f_number, focal_length_mm=info.focal_length_mm)
    attributes = {
        **provenance.attributes(
            "merge", settings=settings.model_dump(mode="json"), inputs=frames, digests=digests.result()
        ),
        **provenance.colour_space(provenance.CAMERA_RGB),
        "envcalCamera": camera.model_dump(mode="json"),
    }
    matrix = camera_from_xyz(frames[0])
    if matrix is not None:
        attributes["envcalCameraFromXYZ"] = matrix
    planes: dict[str, npt.NDArray[Any]] = {**_views(image), "lost": lost}
    if merged.ghosts is not None:
        planes["ghost"] = merged.ghosts[:, :: merged.ghosts.shape[1] // lost.shape[1]]
    if merged.deviation is not None:
        from calibrate.demosaic import spread

        sigma = spread(merged.deviation, merged.cfa)
        sigma = sigma if vignetting is None else remove_vignetting(sigma, vignetting)
        planes |= {f"sigma.{name}": plane for name, plane in _views(sigma).items()}
    exr.write(out, planes, attributes=attributes, compression="rle")
    figures = {
        "shot": out.stem,
        "size": [image.shape[1], image.shape[0]],
        "camera": camera.model_dump(mode="json"),
        "cfa": merged.cfa,
        "frames": _frame_figures(merged, measured, lost.size),
        "lost": int(lost.sum()),
        "lost_share": share,
        "defects": merged.defect_count,
        "gain_e_per_dn": float(merged.noise.gain_e_per_dn),
        "read_noise_e": float(merged.noise.read_noise_e),
        "noise_from": measured.noise_from,
        "black_from": measured.black_from,
        "black_shift_dn": measured.black_shift_dn,
        "shifts": [[float(v) for v in d.shift] if d.moved else [0.0, 0.0] for d in displaced],
        "ghosts": None if ghosts is None else [float(share) for share in ghosts.shares],
        "vignetting": vignetting,
        "lens": lens,
        "clip_from": measured.clip_from,
        "clip_dn": [float(v) for v in _of_colours(measured.exposures[0].clip, merged.cfa)],
    }
    summary = (
        f"{len(frames)} frame{'s' if len(frames) != 1 else ''} → {image.shape[1]}×{image.shape[0]} pixels, {int(lost.sum())} lost, "
        f"{merged.defect_count} defects replaced"
    )
    return Outcome(summary, figures, [*moves, *merged.warnings, *warnings])


def rooted(settings: MergeSettings, folder: Path) -> MergeSettings:
    """Return the settings with their paths starting from `folder`."""
    named = {
        "dark_frame": settings.dark_frame,
        "flat_field": settings.flat_field,
        "lens_database": settings.lens_database,
    }
    return settings.model_copy(update={key: folder / path for key, path in named.items() if path is not None})


def refuse_unknown_names(settings: MergeSettings, shots: Mapping[str, Sequence[Path]]) -> None:
    """Raise an `EnvcalError` for every frame that the settings name and no shot has."""
    names = {path.name for frames in shots.values() for path in frames}
    mistakes = [
        f"merge.{key}.{name}: no frame of any shot has this name. Correct it; the name is that of the file, without its folder."
        for key, given in (("exposures", settings.exposures), ("filters", settings.filters))
        for name in given
        if name not in names
    ]
    if mistakes:
        raise EnvcalError("\n".join(mistakes))


def changes_of(name: str, settings: MergeSettings) -> dict[str, Any]:
    """Return what the settings know better than a frame's file."""
    changes: dict[str, Any] = {}
    if name in settings.exposures:
        changes["exposure_s"] = Fraction(settings.exposures[name]).limit_denominator(10**9)
    if name in settings.filters:
        through = settings.filters[name]
        changes["transmission"] = through if isinstance(through, tuple) else (through,) * 3
    return changes


def _asked(settings: MergeSettings, raws: Sequence[RawFrame]) -> Any:
    from calibrate.merge import Asked
    from envcal.raw import read_mosaic

    return Asked(
        clip=settings.white_level,
        black=settings.black_level,
        dark=None if settings.dark_frame is None else read_mosaic(settings.dark_frame),
        exposures=settings.exposure_ratios,
        known=frozenset(raw.info.name for raw in raws if raw.path.name in settings.exposures),
        gain_e_per_dn=settings.gain_e_per_dn,
        read_noise_e=settings.read_noise_e,
        mixed_aperture=settings.mixed_aperture,
    )


def fall_off(
    settings: MergeSettings, infos: Sequence[FrameInfo]
) -> tuple[Vignetting | None, Mapping[str, Any] | None, list[str]]:
    """Return the lens's fall-off, the lens where it is known from the database, and what a person should know."""
    if settings.lens == "off":
        return _own_vignetting(settings), None, []
    from envcal.lens_data import UnknownLensError, known_lens

    asked = None if isinstance(settings.lens, str) else settings.lens
    try:
        apertures = sorted({info.f_number for info in infos if info.f_number})
        if len(apertures) > 1:
            raise UnknownLensError(
                f"{infos[0].name}: the bracket has apertures from f/{apertures[0]:g} to f/{apertures[-1]:g}, and the fall-off is another at "
                "each; one aperture is expected. Set `merge.lens: off`, or photograph with one aperture."
            )
        found = known_lens(infos[0], asked, database=settings.lens_database)
    except UnknownLensError as error:
        if settings.lens != "auto":
            raise
        return None, None, [f"merge.lens auto: no fall-off was taken out. {error}"]
    lens = dataclasses.asdict(found)
    return lens.pop("vignetting"), lens, list(lens.pop("warnings"))


def _own_vignetting(settings: MergeSettings) -> Vignetting | None:
    if settings.flat_field is not None:
        from calibrate.lens import measure_vignetting
        from envcal.raw import read_frame

        info, mosaic = read_frame(settings.flat_field)
        return measure_vignetting(mosaic, info)
    given = settings.vignetting
    if given is None:
        return None
    first, second, third = given
    if isinstance(first, tuple) and isinstance(second, tuple) and isinstance(third, tuple):
        return first, second, third
    assert not (isinstance(first, tuple) or isinstance(second, tuple) or isinstance(third, tuple))
    return ((first, second, third),) * 3


def _placed(
    raws: Sequence[RawFrame], measured: Measured, settings: MergeSettings
) -> tuple[Sequence[MosaicFrame], Sequence[Displacement], list[str]]:
    """Return the frames, moved where that proves a gain, how they stood, and what a person should know."""
    if not settings.align or len(raws) == 1:
        return raws, (), []
    from calibrate.align import FEWEST_TILES, AlignedFrame, find_displacements

    found = find_displacements(raws, measured.exposures)
    frames: list[MosaicFrame] = [
        AlignedFrame(raw, d.shift, e.clip) if d.moved else raw
        for raw, d, e in zip(raws, found, measured.exposures, strict=True)
    ]
    if not any(d.moved for d in found):
        return frames, found, []
    reach = max(float(np.hypot(*d.shift)) for d in found if d.moved)
    warnings = [
        f"{sum(d.moved for d in found)} of {len(raws)} frames were shifted by up to {reach:.1f} photosites, as `merge.align` "
        "asks. Use a tripod for the sharpest result."
    ]
    warnings += [
        f"{raw.info.name}: too little is seen in it and its neighbour alike to tell how it stands; it keeps its neighbour's "
        "place. Leave it out if edges are double."
        for raw, d in zip(raws, found, strict=True)
        if d.tiles < FEWEST_TILES and d.agreement < 1.0
    ]
    return frames, found, warnings


def _ghosts(frames: Sequence[MosaicFrame], measured: Measured, settings: MergeSettings) -> Ghosts | None:
    if not settings.deghost or len(frames) == 1:
        return None
    from calibrate.deghost import find_ghosts

    return find_ghosts(frames, measured.exposures)


def _views(image: npt.NDArray[np.float32]) -> dict[str, npt.NDArray[np.float32]]:
    """Return the planes of an image without copying them: the writer does so band by band."""
    return {name: image[..., k] for k, name in enumerate("RGB")}


def _of_colours(values: npt.NDArray[np.float64], cfa: str) -> list[float]:
    """Return the smallest value of each of red, green and blue."""
    if cfa == "W":
        return [float(values[0])] * 3
    return [min(float(v) for v, c in zip(values, cfa, strict=True) if c == colour) for colour in "RGB"]


def _filled(
    image: npt.NDArray[np.float32], merged: Merged, settings: MergeSettings, share: float
) -> tuple[npt.NDArray[np.float32], list[str]]:
    from calibrate.lost import fill_lost

    if settings.lost == "none" or not share:
        return image, []
    red, green, blue = _of_colours(merged.ceiling, merged.cfa)
    done = fill_lost(image, settings.lost, ceiling=(red, green, blue))
    what = "the neighbours' colour" if settings.lost == "neighbour" else "the declared colour"
    text = (
        f"{done.filled} pixels ({share:.2g} of the picture) that every frame clips were filled with {what}, as "
        "`merge.lost` asks; their radiance is not measured. Add a shorter exposure to measure it."
    )
    if done.left:
        text += f" {done.left} more have no neighbour that is known, and stay NaN."
    return done.image, [text]


def _frame_figures(merged: Merged, measured: Measured, pixels: int) -> list[Mapping[str, Any]]:
    ratios = dict(zip(measured.names, measured.ratios, strict=True))
    return [
        {
            "name": Path(use.name).name,
            "exposure_s": float(use.exposure_s),
            "exposure": str(use.exposure_s),
            "clipped": use.clipped / pixels,
            "share": use.share,
            "factor": ratios[use.name].factor,
            "factor_error": ratios[use.name].error if np.isfinite(ratios[use.name].error) else None,
            "factor_used": ratios[use.name].applied,
            "uneven": ratios[use.name].uneven,
        }
        for use in merged.frames
    ]
