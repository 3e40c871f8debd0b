"""An uplift file for pbrt-v4: square RGB maps, one for each light, since pbrt has no spectral environment.

What pbrt-v4 does (its sources: lights.cpp, spectrum.cpp, colorspace.cpp): `LightSource "infinite"` takes either one spectrum
for all directions or an RGB image, which must be square and equal-area; a pixel becomes RGBIlluminantSpectrum, that is
2·max(rgb) · sigmoid(rgb / (2·max(rgb))) · the illuminant of the image's colour space, looked up without interpolation;
negative components become 0. The colour space is found by the image's chromaticities, and is one of sRGB, DCI-P3, Rec. 2020
(all D65) and ACES2065-1. Several infinite lights add up. So the colours can be kept, the lamps' spectra cannot.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from envcal import atomic, exr, provenance
from envcal.export.loss import loss
from envcal.export.octahedral import resampled, side_of
from envcal.export.opened import (
    LARGEST_HALF,
    Opened,
    bands,
    conversion,
    guesses,
    kelvin,
    open_uplift,
    refuse_overwriting,
    undeclared,
)
from envcal.reporter import Progress, silent
from envcal.runner import Outcome
from uplift.spectrum import rgb_space

#: The widest of pbrt's colour spaces whose illuminant is D65.
SPACE = "ITU-R BT.2020"
#: What it means for pbrt's README that the lamps are not known.
GUESSED = (
    "So both sides of the comparison below are guesses: a small difference says that two guesses agree, not that pbrt lights as the "
    "place did."
)
#: What brings the maps from the frame of pbrt's lights into a scene: its up, whether it is mirrored at its head by
#: `Scale -1 1 1`, where the middle of the map then stands, and the images of x, y and z. pbrt's own frame is left-handed, and
#: the maps are right in it as they are; so a plain scene needs a rotation (determinant 1), a mirrored one a mirroring (−1).
TRANSFORMS: tuple[tuple[str, bool, str, tuple[tuple[int, int, int], ...]], ...] = (
    ("+z", False, "−x", ((1, 0, 0), (0, 1, 0), (0, 0, 1))),
    ("+y", False, "+z", ((0, 0, -1), (-1, 0, 0), (0, 1, 0))),
    ("+y", True, "−z", ((0, 0, 1), (-1, 0, 0), (0, 1, 0))),
    ("+z", True, "−x", ((1, 0, 0), (0, -1, 0), (0, 0, 1))),
)


def export_pbrt(source: Path, folder: Path, *, half: bool = False, progress: Progress = silent) -> Outcome:
    """Write a square map for each light of an uplift file, its spectrum, `environment.pbrt` and a README.md.

    The figures say what pbrt's own spectra lose against the file's: ΔE2000 of ColorChecker patches lit by single pixels.
    """
    atomic.check_folder(folder)
    opened = open_uplift(source)
    latlong, cluster, clipped = _latlong(opened)
    used = [int(k) for k in np.unique(cluster[latlong.max(axis=-1) > 0])]
    side = side_of(opened.size[1])
    steps = len(used) + 1
    refuse_overwriting(source, folder, [f"light{k}.exr" for k in used])
    lights: list[dict[str, Any]] = []
    overflow = 0
    space = rgb_space(SPACE, observer=opened.observer)
    for number, k in enumerate(used):
        image = resampled(latlong, cluster, k, side)
        if half:
            overflow += int((image > LARGEST_HALF).any(axis=-1).sum())
            image = np.minimum(image, LARGEST_HALF)
        name, about = f"light{k}", opened.about.clusters[k]
        attributes = {
            **provenance.attributes(
                "export", settings={"to": "pbrt", "light": k, "half": half}, inputs=[source], unit=opened.unit
            ),
            **provenance.colour_space(SPACE),
        }
        with exr.Writer(
            folder / f"{name}.exr",
            (side, side),
            channels=dict.fromkeys("RGB", "f2" if half else "f4"),
            attributes=attributes,
        ) as writer:
            writer.rows(exr.rgb_planes(image))
        atomic.write_text(folder / f"{name}.spd", spd(opened.about.wavelengths_nm, about.emission))
        mean = image.astype(np.float64).mean(axis=(0, 1)) @ space.luminance_weights
        lights.append(
            {
                "name": name,
                "type": about.type,
                "cct": about.cct,
                "source": about.source,
                "mean_luminance": float(mean),
                "brightest": float((latlong[cluster == k] @ space.luminance_weights).max()),
            }
        )
        progress(number + 1, steps)
    before = _mean_luminance(latlong, space.luminance_weights)
    after = sum(light["mean_luminance"] for light in lights)
    lost = loss(opened, space=SPACE)
    progress(steps, steps)
    figures = {
        "side": side,
        "space": SPACE,
        "half": half,
        "lights": lights,
        "energy_ratio": after / before if before > 0 else 1.0,
        "negative": clipped,
        "overflow": overflow,
        "relight_delta_e": lost,
        "guessed": bool(undeclared(opened.about)),
        "unit": None if opened.unit is None else opened.unit.told(),
    }
    atomic.write_text(folder / "environment.pbrt", _scene(lights))
    atomic.write_text(folder / "README.md", _readme(figures, source.name, guesses(opened.about, GUESSED)))
    warnings = [
        f"pbrt-v4 makes its own spectra from RGB: what single pixels light is off by ΔE2000 {lost['mean']:.2f} in the mean "
        f"({lost['p95']:.2f} at the 95th percentile) against this file's spectra. README.md says more."
    ]
    if clipped:
        warnings.append(f"{clipped} pixels lie outside of Rec. 2020; pbrt takes negative components for 0.")
    if overflow:
        warnings.append(f"{overflow} texels are above 65504 and were set to it. Leave out --half.")
    warnings += undeclared(opened.about)
    return Outcome(f"{len(lights)} lights of {side}×{side} for pbrt-v4", figures, warnings)


def _latlong(opened: Opened) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8], int]:
    """The colours [H, W, 3] in pbrt's space, the light of each pixel [H, W], and how many had a negative component."""
    matrix = conversion(opened.space, rgb_space(SPACE, observer=opened.observer))
    colours = np.empty((*opened.size, 3), np.float32)
    cluster = np.empty(opened.size, np.uint8)
    clipped = 0
    for band in bands(opened):
        rgb = band.rgb(opened) @ matrix.T
        # What rounding alone makes negative is not counted.
        clipped += int((rgb.min(axis=-1) < -1e-4 * rgb.max(axis=-1)).sum())
        here = slice(band.top, band.top + len(rgb))
        colours[here] = np.maximum(rgb, 0.0)
        cluster[here] = band.cluster
    return colours, cluster, clipped


def _mean_luminance(latlong: npt.NDArray[np.float32], weights: npt.NDArray[np.float64]) -> float:
    """The luminance averaged over the sphere."""
    rows = latlong.mean(axis=1, dtype=np.float64) @ weights
    sines = np.sin(np.pi * (np.arange(len(rows)) + 0.5) / len(rows))
    return float(rows @ sines / sines.sum())


def spd(wavelengths_nm: list[float], values: list[float]) -> str:
    """A spectrum as pbrt reads it from a file: a wavelength in nm and a value a line."""
    return "".join(f"{w:g} {v:.9g}\n" for w, v in zip(wavelengths_nm, values, strict=True))


def _scene(lights: list[dict[str, Any]]) -> str:
    text = [
        '# The environment as pbrt-v4 can have it. Include it in the world block: Include "environment.pbrt"',
        "#",
        "# The maps are in pbrt's own frame: z is up, and u = phi/2pi of the lat-long map from +x towards +y. So the middle of",
        "# the lat-long map stands towards -x. That is right for a scene whose up is +z and that is not mirrored. For others",
        "# remove the first # of one line below. `mirrored` is a scene that has `Scale -1 1 1` before its camera, as those from",
        "# right-handed programs have; with the line of the other kind the map would be seen mirrored, left for right.",
        "AttributeBegin",
    ]
    for up, mirrored, middle, images in TRANSFORMS[1:]:
        numbers = "  ".join(f"{x} {y} {z} 0" for x, y, z in images)
        kind = "mirrored" if mirrored else "plain"
        text.append(
            f"    # ConcatTransform [ {numbers}  0 0 0 1 ]  # up {up}, {kind}: the middle towards {_ascii(middle)}"
        )
    for light in lights:
        cct = f", {light['cct']:.0f} K" if light["cct"] else ""
        text += [
            f"    # {light['type']}{cct}; its own spectrum, which pbrt cannot use with an image: {light['name']}.spd",
            f'    LightSource "infinite" "string filename" [ "{light["name"]}.exr" ] "float scale" [ 1 ]',
        ]
    return "\n".join([*text, "AttributeEnd", ""])


def _ascii(axis: str) -> str:
    return axis.replace("−", "-")


def _unit(told: str | None) -> str:
    if told is None:
        return "Values are relative."
    return f"Values are {told}: the sums of the maps are luminances."


def _readme(figures: dict[str, Any], source: str, guessed: str) -> str:
    lost = figures["relight_delta_e"]
    rows = "\n".join(
        f"| `{light['name']}.exr` | {light['type']} | {kelvin(light['cct'])} "
        f"| {light['mean_luminance']:.4g} | {light['brightest']:.4g} | {light['source']} |"
        for light in figures["lights"]
    )
    transforms = "\n".join(
        f"| {up} | {'yes' if mirrored else 'no'} | {middle} | {'the line `up ' + up + ', ' + ('mirrored' if mirrored else 'plain') + '`' if k else 'none: as written'} |"
        for k, (up, mirrored, middle, _) in enumerate(TRANSFORMS)
    )
    overflow = f"; {figures['overflow']} texels were too bright for a half float" if figures["half"] else ""
    return f"""# {source} for pbrt-v4

`Include "environment.pbrt"` in the world block of a scene. The maps are {figures["side"]}×{figures["side"]}, linear Rec. 2020, in the square
equal-area layout that pbrt-v4 wants (`imgtool makeequiarea` has been done); one for each light, so that a light can be dimmed or
left out by its `scale`. Their sum is the whole map.

| map | type | CCT | mean luminance | of the brightest pixel | spectrum |
|---|---|---|---|---|---|
{rows}

A map value of 1 is a radiance of 1, white, in the rendered image at pbrt's default exposure (`iso` 100, 1 s): so its sources say, pbrt
has not been run. {_unit(figures["unit"])}

## Which way is up

As written, `environment.pbrt` is for a scene whose up is +z and that is not mirrored. For others it holds a line each, to be
uncommented. A scene is mirrored if `Scale -1 1 1` stands before its camera, as in scenes from right-handed programs: with the line
of the wrong kind the map is seen mirrored, left for right, and lights from the wrong side.

| up | `Scale -1 1 1` before the camera | the middle of the map stands at | transform in `environment.pbrt` |
|---|---|---|---|
{transforms}

## What is kept

Colours and light: the mean luminance over the sphere is {figures["energy_ratio"]:.5f} of the original's. {figures["negative"]} pixels lay
outside of Rec. 2020 and lost their negative components{overflow}.

## What is lost

The spectra. pbrt-v4 gives an RGB pixel of an infinite light the spectrum 2·max(rgb) · sigmoid · D65 whatever lamp there was, and an
infinite light with a spectrum (`"spectrum L"`) cannot have an image.

## A lamp by hand

`lightN.spd` are the lamps' spectra, for lights that you model yourself:

    AreaLightSource "diffuse" "spectrum L" [ "light0.spd" ] "float scale" [ Y ]

pbrt divides a light's spectrum by its luminance, so the values in the file have no brightness (here Σ ȳ·E·Δλ = 1), and `scale` alone is the luminance,
in the unit of the maps: a `scale` of 1 is as bright as a map value of (1, 1, 1) at the map's own `scale` of 1. To match the map, Y is the
mean of 0.2627 R + 0.6780 G + 0.0593 B over the lamp in it, at most what the table above has for its brightest pixel. Paint the lamp black in the
map then, or it lights the scene twice.

## By how much
{guessed}
Measured on {lost["pixels"]} pixels of this map, evenly over the sphere: 24 ColorChecker patches lit by the pixel's spectrum, and by the
spectrum that pbrt makes of its RGB (solved exactly; pbrt's table adds its own interpolation error).

| ΔE2000 | |
|---|---|
| mean | {lost["mean"]:.3f} |
| mean, each pixel weighted by its light | {lost["mean_by_light"]:.3f} |
| median of the pixels | {lost["median"]:.3f} |
| 95th percentile of the pixels | {lost["p95"]:.3f} |

The map itself, seen in a mirror, keeps its colours. What it lights does not: by as much as this table says. pbrt also looks
up texels without interpolation: enlarge the map first if its texels show in mirrors.
"""
