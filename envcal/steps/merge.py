"""RAW bracket → radiance in camera RGB."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from envcal import exr, provenance
from envcal.config import MergeSettings
from envcal.profile import Camera
from envcal.reporter import Progress, silent
from envcal.runner import Outcome


def merge(frames: Sequence[Path], out: Path, settings: MergeSettings, *, progress: Progress = silent) -> Outcome:
    """Merge RAW `frames` in the mosaic, demosaic once, and write R, G, B and the mask `lost` to `out`.

    Values are camera RGB: 1 is a count at the white level in one second. A pixel clipped in every frame is NaN in
    the channels that need it and 1 in `lost`.
    """
    from calibrate.demosaic import demosaic, lost_pixels
    from calibrate.merge import NoiseModel, guess_noise, merge_mosaics
    from envcal.raw import RawFrame

    raws = [RawFrame(path) for path in frames]
    noise = None
    if settings.gain_e_per_dn is not None or settings.read_noise_e is not None:
        guess = guess_noise(raws[0].info)
        noise = NoiseModel(settings.gain_e_per_dn or guess.gain_e_per_dn, settings.read_noise_e or guess.read_noise_e)
    merged = merge_mosaics(raws, noise=noise, defects=settings.defects, mixed_iso=settings.mixed_iso, progress=progress)
    image = demosaic(merged.mosaic, merged.cfa)
    lost = lost_pixels(image)
    info = raws[0].info
    camera = Camera(model=info.camera, lens=info.lens, iso=info.iso, f_number=info.f_number)
    attributes = {
        **provenance.attributes("merge", settings=settings.model_dump(mode="json"), inputs=frames),
        **provenance.colour_space(provenance.CAMERA_RGB),
        "envcalCamera": camera.model_dump(mode="json"),
    }
    exr.write(out, exr.with_lost(image), attributes=attributes)
    figures = {
        "shot": out.stem,
        "size": [image.shape[1], image.shape[0]],
        "camera": camera.model_dump(mode="json"),
        "cfa": merged.cfa,
        "frames": [
            {
                "name": Path(use.name).name,
                "exposure_s": float(use.exposure_s),
                "exposure": str(use.exposure_s),
                "clipped": use.clipped / lost.size,
                "share": use.share,
            }
            for use in merged.frames
        ],
        "lost": int(lost.sum()),
        "defects": merged.defect_count,
        "gain_e_per_dn": merged.noise.gain_e_per_dn,
        "read_noise_e": merged.noise.read_noise_e,
    }
    summary = (
        f"{len(frames)} frame{'s' if len(frames) != 1 else ''} → {image.shape[1]}×{image.shape[0]} pixels, {int(lost.sum())} lost, "
        f"{merged.defect_count} defects replaced"
    )
    return Outcome(summary, figures, merged.warnings)
