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
from envcal.unit import RELATIVE, WATTS, unit_of
from envcal.uplift_file import Radiance, read_any_about

#: Spectral samples that are held at a time.
TILE_SAMPLES = 1 << 25
#: Below this a half float loses bits.
_SMALLEST_HALF = 2.0**-14
#: A share of dim pixels that is worth a word.
_MANY_DIM = 0.01


def spectra(source: Path, out: Path, settings: SpectraSettings, *, progress: Progress = silent) -> Outcome:
    """Write the spectral radiance of an uplift file at `settings.wavelengths` to `out`, in bands of rows.

    Of a map in cd/m² it is in W/(m² sr nm): divided by 683 lm/W. Of a relative one Σ ȳ·P·Δλ is its luminance.
    """
    from calibrate.photometry import LUMINOUS_EFFICACY

    header, about = read_any_about(source)
    grid = about.wavelengths_nm
    wavelengths = np.asarray(parse_bands(settings.wavelengths))
    if wavelengths[0] < grid[0] or wavelengths[-1] > grid[-1]:
        raise EnvcalError(
            f"{source}: its emissions are known from {grid[0]:g} to {grid[-1]:g} nm; {settings.wavelengths} leaves that "
            f"range. Narrow the wavelengths, or widen `wavelengths` and run `envcal uplift` again."
        )
    unit = unit_of(source, header.attributes)
    kinds = channels([float(w) for w in wavelengths], half=settings.half, half_preview=unit is None)
    attributes = {
        **provenance.attributes("spectra", settings=settings.model_dump(mode="json"), inputs=[source], unit=unit),
        **provenance.colour_space(about.space),
        **ATTRIBUTES,
        "bandUnit": RELATIVE if unit is None else WATTS,
        "envmap": True,
    }
    height, width = header.size
    rows = max(1, TILE_SAMPLES // (width * len(wavelengths)))
    radiance_of = Radiance(source, about, wavelengths)
    brightest, dim, lit = 0.0, 0, 0
    with exr.Writer(out, header.size, channels=kinds, attributes=attributes) as writer:
        for top, planes in exr.bands(source, [*radiance_of.channels, *"RGB"], rows=rows):
            radiance = radiance_of(planes)
            if unit is not None:
                radiance *= np.float32(1.0 / LUMINOUS_EFFICACY)
            peak = radiance.max(axis=-1)
            brightest = max(brightest, float(peak.max()))
            lit += int((peak > 0).sum())
            dim += int(((peak > 0) & (peak < _SMALLEST_HALF)).sum())
            band: dict[str, Any] = {channel(float(w)): radiance[..., k] for k, w in enumerate(wavelengths)}
            writer.rows({**band, **{name: planes[name] for name in "RGB"}})
            progress(min(top + rows, height), height)
    unit_name = RELATIVE if unit is None else WATTS
    figures = {
        "bands": len(wavelengths),
        "wavelengths": settings.wavelengths,
        "brightest": brightest,
        "unit": unit_name,
        "dim": dim / max(lit, 1),
    }
    warnings = []
    if settings.half and unit is not None and dim > _MANY_DIM * lit:
        warnings.append(
            f"{dim} of {lit} pixels stay below {_SMALLEST_HALF:.2g} W/(m² sr nm) in every band, where half floats keep fewer than "
            "11 bits. Write full floats: `spectra.half: false`, or leave out --half."
        )
    kind = "half" if settings.half else "float"
    return Outcome(f"{len(wavelengths)} bands of {width}×{height}, {kind}, {unit_name}", figures, warnings)
