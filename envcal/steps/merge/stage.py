"""The stage: RAW files in, one EXR out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from envcal import exr, provenance
from envcal.atomic import digest
from envcal.config import MergeSettings
from envcal.profile import Camera
from envcal.reporter import Progress, silent
from envcal.runner import Outcome
from envcal.steps.merge.bracket import merged, opened
from envcal.steps.merge.fall_off import fall_off
from envcal.steps.merge.figures import camera_of, figures_of, of_colours

if TYPE_CHECKING:
    from calibrate.lens import Vignetting
    from calibrate.merge import Merged

Image = npt.NDArray[np.float32]


def merge(frames: Sequence[Path], out: Path, settings: MergeSettings, *, progress: Progress = silent) -> Outcome:
    """Merge RAW `frames` in the mosaic, demosaic once, and write R, G, B and the mask `lost` to `out`.

    Values are camera RGB: 1 is a count at the white level in one second. A pixel clipped in every frame is NaN in
    the channels that need it, unless a fill is asked for, and 1 in `lost`.
    """
    from calibrate.demosaic import demosaic, lost_pixels
    from calibrate.lens import remove_vignetting
    from calibrate.lost import lost_share

    raws = opened(frames, settings)
    infos = [raw.info for raw in raws]
    vignetting, lens, doubts = fall_off(settings, infos)
    # The merge uses one core at times; the files are read for their digests meanwhile.
    pool = ThreadPoolExecutor(1)
    digests = pool.submit(lambda: {path: digest(path) for path in frames})
    pool.shutdown(wait=False)
    bracket = merged(raws, settings, progress)
    del raws  # and the mosaics with them, before the image takes their place in memory
    mosaic = bracket.merged
    image = demosaic(mosaic.mosaic, mosaic.cfa, method=settings.demosaic)
    lost = lost_pixels(image)
    share = lost_share(lost)
    image, filling = _filled(image, mosaic, settings, share)
    if vignetting is not None:
        image = remove_vignetting(image, vignetting)
    camera = camera_of(infos)
    attributes = _attributes(frames, settings, camera, digests.result())
    # Of camera noise, compression saves a quarter and takes three times as long as the disk.
    exr.write(out, _planes(image, lost, mosaic, vignetting), attributes=attributes, compression="none")
    figures = {
        "shot": out.stem,
        "camera": camera.model_dump(mode="json"),
        **figures_of(bracket, lost, share),
        "vignetting": vignetting,
        "lens": lens,
    }
    summary = (
        f"{len(frames)} frame{'s' if len(frames) != 1 else ''} → {image.shape[1]}×{image.shape[0]} pixels, "
        f"{figures['lost']} lost, {mosaic.defect_count} defects replaced"
    )
    return Outcome(summary, figures, [*bracket.warnings, *filling, *doubts])


def _attributes(
    frames: Sequence[Path], settings: MergeSettings, camera: Camera, digests: Mapping[Path, str]
) -> dict[str, Any]:
    from envcal.raw import camera_from_xyz

    attributes = {
        **provenance.attributes("merge", settings=settings.model_dump(mode="json"), inputs=frames, digests=digests),
        **provenance.colour_space(provenance.CAMERA_RGB),
        "envcalCamera": camera.model_dump(mode="json"),
    }
    matrix = camera_from_xyz(frames[0])
    return attributes if matrix is None else attributes | {"envcalCameraFromXYZ": matrix}


def _planes(
    image: Image, lost: npt.NDArray[np.bool_], merged: Merged, vignetting: Vignetting | None
) -> dict[str, npt.NDArray[Any]]:
    planes: dict[str, npt.NDArray[Any]] = {**_views(image), "lost": lost}
    if merged.ghosts is not None:
        planes["ghost"] = merged.ghosts[:, :: merged.ghosts.shape[1] // lost.shape[1]]
    if merged.deviation is not None:
        from calibrate.demosaic import spread
        from calibrate.lens import remove_vignetting

        sigma = spread(merged.deviation, merged.cfa)
        sigma = sigma if vignetting is None else remove_vignetting(sigma, vignetting)
        planes |= {f"sigma.{name}": plane for name, plane in _views(sigma).items()}
    return planes


def _views(image: Image) -> dict[str, Image]:
    """Return the planes of an image without copying them: the writer does so band by band."""
    return {name: image[..., k] for k, name in enumerate("RGB")}


def _filled(image: Image, merged: Merged, settings: MergeSettings, share: float) -> tuple[Image, list[str]]:
    from calibrate.lost import fill_lost

    if settings.lost == "none" or not share:
        return image, []
    red, green, blue = of_colours(merged.ceiling, merged.cfa)
    done = fill_lost(image, settings.lost, ceiling=(red, green, blue))
    what = "the neighbours' colour" if settings.lost == "neighbour" else "the declared colour"
    text = (
        f"{done.filled} pixels ({share:.2g} of the picture) that every frame clips were filled with {what}, as "
        "`merge.lost` asks; their radiance is not measured. Add a shorter exposure to measure it."
    )
    if done.left:
        text += f" {done.left} more have no neighbour that is known, and stay NaN."
    return done.image, [text]
