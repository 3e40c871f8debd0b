"""The map as plain RGB for renderers without spectra: ACEScg, sRGB, Rec. 2020 and others, lat-long."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from envcal import atomic, exr, provenance
from envcal.export.opened import LARGEST_HALF, bands, conversion, open_uplift, refuse_overwriting
from envcal.reporter import Progress, silent
from envcal.runner import Outcome
from uplift.spectrum import rgb_space

#: The space whose triangle encloses the spectral locus; adapted from D65, a laser leaves it by half a per cent at most.
WIDEST = "ACES2065-1"


#: What the spaces are called in the OpenColorIO configurations: of ACES 1.0 to 1.2, and from ACES 1.3 on.
NUKE = {
    "ACEScg": "`ACES - ACEScg` (`ACEScg` in newer configurations)",
    "ACES2065-1": "`ACES - ACES2065-1` (`ACES2065-1` in newer configurations)",
    "sRGB": "`Utility - Linear - sRGB` (`Linear Rec.709 (sRGB)` in newer configurations; `linear` in nuke-default)",
    "ITU-R BT.2020": "`Utility - Linear - Rec.2020` (`Linear Rec.2020` in newer configurations)",
    "P3-D65": "`Utility - Linear - P3-D65` (`Linear P3-D65` in newer configurations)",
    "Adobe Wide Gamut RGB": "`Utility - Linear - Adobe Wide Gamut RGB` (newer configurations have none: export ACEScg)",
}


def file_name(space: str) -> str:
    """The name of the map in a space, such as `environment_acescg.exr`."""
    return f"environment_{space.lower().replace(' ', '_').replace('itu-r_bt.', 'rec')}.exr"


def export_rgb(
    source: Path, folder: Path, *, space: str = "ACEScg", half: bool = False, progress: Progress = silent
) -> Outcome:
    """Write the colours of an uplift file as a lat-long map in `space`, and a README.md, into `folder`.

    The colours are those of the spectra, integrated over the file's own grid, so pixels that were moved to the closest
    possible colour are shown as they will light. White is kept (Bradford). Negative components, colours outside of
    `space`, are kept and counted. With `half`, what is brighter than a half float can hold is set to 65504 and counted.
    """
    atomic.check_folder(folder)
    opened = open_uplift(source)
    target = rgb_space(space, observer=opened.observer)
    matrix = conversion(opened.space, target)
    out = folder / file_name(space)
    refuse_overwriting(source, folder, [out.name])
    attributes = {
        **provenance.attributes(
            "export", settings={"to": "rgb", "space": space, "half": half}, inputs=[source], unit=opened.unit
        ),
        **provenance.colour_space(space),
        "envmap": True,
    }
    height, width = opened.size
    overflow = outside = 0
    brightest = lost = total = 0.0
    with exr.Writer(
        out, opened.size, channels=dict.fromkeys("RGB", "f2" if half else "f4"), attributes=attributes
    ) as writer:
        for band in bands(opened):
            rgb = band.rgb(opened) @ matrix.T
            outside += int((rgb.min(axis=-1) < -1e-4 * np.abs(rgb).max(axis=-1)).sum())
            brightest = max(brightest, float(rgb.max()))
            if half:
                theta = np.pi * (band.top + np.arange(len(rgb)) + 0.5) / height
                weight = np.sin(theta)[:, np.newaxis]
                before = rgb @ target.luminance_weights
                over = (np.abs(rgb) > LARGEST_HALF).any(axis=-1)
                overflow += int(over.sum())
                rgb = np.clip(rgb, -LARGEST_HALF, LARGEST_HALF)
                total += float((before * weight).sum())
                lost += float(((before - rgb @ target.luminance_weights) * weight).sum())
            writer.rows(exr.rgb_planes(rgb))
            progress(band.top + len(rgb), height)
    figures = {
        "file": out.name,
        "space": space,
        "half": half,
        "brightest": brightest,
        "overflow": overflow,
        "light_lost": lost / total if total > 0 else 0.0,
        "outside": outside,
        "unit": None if opened.unit is None else opened.unit.told(),
    }
    warnings = []
    if overflow:
        warnings.append(
            f"{overflow} of {height * width} pixels are brighter than a half float can hold ({brightest:.4g}; at most "
            f"65504) and were set to 65504: {figures['light_lost']:.2%} of the light is lost. Leave out --half."
        )
    if outside:
        wider = (
            "" if space == WIDEST else f"; {WIDEST} holds all but the very purest colours of light (`--space {WIDEST}`)"
        )
        warnings.append(
            f"{outside} of {height * width} pixels have colours outside of {space}: a component is negative. Renderers "
            f"clip it, which changes the colour{wider}."
        )
    atomic.write_text(folder / "README.md", _readme(figures, opened.space.name))
    kind = "half" if half else "float"
    return Outcome(f"{width}×{height} in {space}, {kind}", figures, warnings)


def _brightness(told: object) -> str:
    if told is not None:
        return f"Values are {told}: (1, 1, 1) is 1 cd/m²."
    return """Relative: (1, 1, 1) is the white of luminance 1, and stays (1, 1, 1) in a renderer
that takes maps as they are. In a map from `envcal run` that is the white of the D65 lamp (unless `balance: {luminance: keep}`).
No unit such as cd/m² stands behind it; set the exposure, or the strength of the light, in the renderer."""


def _readme(figures: dict[str, object], source: str) -> str:
    overflow = (
        f"; set to 65504, being brighter than a half float can hold: {figures['overflow']}" if figures["half"] else ""
    )
    return f"""# RGB map

`{figures["file"]}`: lat-long, linear {figures["space"]} (the header's `chromaticities`), {"half" if figures["half"] else "float"}.

**Orientation.** The first row is up (+Y). Seen from inside, with the middle of the map straight ahead (−Z), a quarter of the
width to the right of the middle is at the right hand (+X), and both edges are behind (+Z). Renderers have frames of their own:
where the middle comes out elsewhere, turn the light about the vertical.

**Brightness.** {_brightness(figures["unit"])}

**Nuke.** Read → input transform {NUKE[str(figures["space"])]}, no further conversion.

White stays white: between spaces of different white points ({source} has D65; ACES spaces have ACES white, about D60) the
colours are adapted by Bradford's method.

What is lost: the spectra. A renderer that uplifts this map by itself gives every pixel a smooth spectrum under one white, and
what it lights will look as under that, not as under the lamps of the place. Pixels outside of the space: {figures["outside"]}{overflow}.
"""
