"""Shots → one latitude-longitude map."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from envcal import exr, provenance
from envcal.config import PanoramaSettings
from envcal.errors import EnvcalError
from envcal.runner import Outcome


def panorama(shots: Sequence[Path], out: Path, settings: PanoramaSettings) -> Outcome:
    """Write the lat-long map that `shots` show to `out`; a single shot of 2:1 passes through."""
    from calibrate.panorama import latlong_from_shots

    headers, images = zip(*(exr.read_rgb(shot) for shot in shots), strict=True)
    image = latlong_from_shots(images)
    space = headers[0].attributes.get("envcalSpace")
    if not isinstance(space, str) or space == provenance.CAMERA_RGB:
        raise EnvcalError(
            f"{shots[0]}: is not in a working RGB space yet ({space or 'unknown'}). Run `envcal correct` and "
            f"`envcal balance` on it first."
        )
    attributes = {
        **provenance.attributes("panorama", settings=settings.model_dump(mode="json"), inputs=shots),
        **provenance.colour_space(space),
        "envmap": True,
    }
    lost = np.isnan(image).any(axis=2)
    exr.write(out, exr.with_lost(image), attributes=attributes)
    height, width = lost.shape
    weight = np.sin(np.pi * (np.arange(height) + 0.5) / height)
    share = float((lost.mean(axis=1) * weight).sum() / weight.sum())
    warnings = []
    if lost.any():
        warnings.append(
            f"{int(lost.sum())} pixels of the map ({share:.2%} of the sphere) are clipped in every frame and stay NaN. "
            f"Add a shorter exposure to the bracket."
        )
    return Outcome(f"{width}×{height} pixels", {"size": [width, height], "lost_share": share}, warnings)
