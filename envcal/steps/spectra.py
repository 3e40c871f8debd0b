"""Coefficients → spectral radiance, in the spectral EXR layout."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from envcal import exr, provenance
from envcal.config import SpectraSettings, parse_bands
from envcal.errors import EnvcalError
from envcal.reporter import Progress, silent
from envcal.runner import Outcome
from envcal.spectral_exr import ATTRIBUTES, channel, channels
from envcal.uplift_file import Radiance, read_any_about

#: Spectral samples that are held at a time.
TILE_SAMPLES = 1 << 25


def spectra(source: Path, out: Path, settings: SpectraSettings, *, progress: Progress = silent) -> Outcome:
    """Write the spectral radiance of an uplift file at `settings.wavelengths` to `out`, in bands of rows."""
    header, about = read_any_about(source)
    grid = about.wavelengths_nm
    wavelengths = np.asarray(parse_bands(settings.wavelengths))
    if wavelengths[0] < grid[0] or wavelengths[-1] > grid[-1]:
        raise EnvcalError(
            f"{source}: its emissions are known from {grid[0]:g} to {grid[-1]:g} nm; {settings.wavelengths} leaves that "
            f"range. Narrow the wavelengths, or widen `wavelengths` and run `envcal uplift` again."
        )
    kinds = channels([float(w) for w in wavelengths], half=settings.half)
    attributes = {
        **provenance.attributes("spectra", settings=settings.model_dump(mode="json"), inputs=[source]),
        **provenance.colour_space(about.space),
        **ATTRIBUTES,
        "envmap": True,
    }
    height, width = header.size
    rows = max(1, TILE_SAMPLES // (width * len(wavelengths)))
    radiance_of = Radiance(source, about, wavelengths)
    brightest = 0.0
    with exr.Writer(out, header.size, channels=kinds, attributes=attributes) as writer:
        for top, planes in exr.bands(source, [*radiance_of.channels, *"RGB"], rows=rows):
            radiance = radiance_of(planes)
            brightest = max(brightest, float(radiance.max()))
            band: dict[str, Any] = {channel(float(w)): radiance[..., k] for k, w in enumerate(wavelengths)}
            writer.rows({**band, **{name: planes[name] for name in "RGB"}})
            progress(min(top + rows, height), height)
    figures = {"bands": len(wavelengths), "wavelengths": settings.wavelengths, "brightest": brightest}
    kind = "half" if settings.half else "float"
    return Outcome(f"{len(wavelengths)} bands of {width}×{height}, {kind}", figures)
