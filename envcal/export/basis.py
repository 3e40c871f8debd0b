"""An uplift file for Mitsuba 3 without our plugin: one native pass for each light.

Mitsuba's spectral `envmap` keeps three coefficients and a scale a texel and shines with D65(λ) · scale · S(c0 λ² + c1 λ + c2).
Its file reader makes them from RGB; but they are a parameter of the loaded scene (`data`), and there ours can be put.
What is left is D65 where the light's own emission E_k should be. Radiance is linear in the emission at every wavelength,
so the film puts it right: a `specfilm` whose responses are x̄, ȳ, z̄ times E_k/D65 measures what the film would have
measured under E_k. A pass for each light, and their sum is the picture.

Mitsuba's rows run from pole to pole, ours are the middles of bands. So the maps have a row for each middle and one for each
border between two, where the spectrum is that of the mean colour under the same light.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from envcal import atomic, exr, provenance
from envcal.export.opened import Opened, bands, guesses, kelvin, open_uplift, refuse_overwriting, undeclared
from envcal.export.pbrt import spd
from envcal.reporter import Progress, silent
from envcal.runner import Outcome
from envcal.unit import Unit

Float32 = npt.NDArray[np.float32]

#: What Mitsuba divides the CIE's D65, 100 at 560 nm, by: its luminance is then that of 1 in RGB.
_D65_NORM = 98.99741751876255
_FINE = np.arange(360.0, 831.0, 1.0)
#: What it means for the README that the lamps are not known.
GUESSED = "The passes render these guesses exactly; what they light looks as under smooth lamps, not as in the place."


def export_basis(source: Path, folder: Path, *, progress: Progress = silent) -> Outcome:
    """Write a map of coefficients and three film responses for each light, `passes.py` and a README.md into `folder`."""
    atomic.check_folder(folder)
    opened = open_uplift(source)
    coefficients, scale, cluster = _whole(opened)
    used = [int(k) for k in np.unique(cluster[scale > 0])]
    refuse_overwriting(source, folder, [*(f"light{k}.exr" for k in used), "blank.exr"])
    lights: list[dict[str, Any]] = []
    for number, k in enumerate(used):
        nodes = native_nodes(opened, coefficients, np.where(cluster == k, scale, np.float32(0)), k)
        name, about = f"light{k}", opened.about.clusters[k]
        exr.write(
            folder / f"{name}.exr",
            {channel: np.ascontiguousarray(nodes[..., i]) for i, channel in enumerate(("c0", "c1", "c2", "scale"))},
            attributes=provenance.attributes(
                "export", settings={"to": "basis", "light": k}, inputs=[source], unit=opened.unit
            ),
        )
        for axis, values in zip("XYZ", responses(opened, k), strict=True):
            atomic.write_text(folder / f"{axis}_{name}.spd", spd(list(_FINE), list(values)))
        lights.append({"name": name, "type": about.type, "cct": about.cct, "source": about.source})
        progress(number + 1, len(used))
    # As large as the maps: scalar variants of Mitsuba replace data only by data of the same shape.
    height, width = opened.size
    blank = np.zeros((2 * height + 1, width), np.float32)
    exr.write(folder / "blank.exr", dict.fromkeys("RGB", blank), attributes=provenance.colour_space("sRGB"))
    atomic.write_json(folder / "lights.json", lights)
    atomic.write_text(folder / "passes.py", SCRIPT)
    atomic.write_text(folder / "example.xml", EXAMPLE)
    atomic.write_text(folder / "README.md", _readme(source.name, lights, opened.unit, guesses(opened.about, GUESSED)))
    figures = {"lights": lights, "rows": 2 * height + 1, "columns": width}
    return Outcome(f"{len(lights)} passes with maps of {width}×{2 * height + 1}", figures, undeclared(opened.about))


def _whole(opened: Opened) -> tuple[Float32, Float32, npt.NDArray[np.uint32]]:
    coefficients = np.empty((*opened.size, 3), np.float32)
    scale, cluster = np.empty(opened.size, np.float32), np.empty(opened.size, np.uint32)
    for band in bands(opened):
        here = slice(band.top, band.top + len(band.scale))
        coefficients[here], scale[here], cluster[here] = band.coefficients, band.scale, band.cluster
    return coefficients, scale, cluster


def native_nodes(opened: Opened, coefficients: Float32, scale: Float32, k: int) -> Float32:
    """Return the nodes [2H + 1, W, 4] of Mitsuba's envmap for one light: c0, c1, c2 and scale.

    `scale` [H, W] is 0 outside of the light. Mitsuba interpolates S and scale each by itself: where the scale is 0 the
    coefficients are those of the nearest texel that shines, so the product fades to black with the right spectrum.
    """
    from uplift.pixels import uplift_pixels
    from uplift.radiance import rgb_of
    from uplift.table import build_table

    height, width = scale.shape
    index = np.full(scale.shape, k, np.uint32)
    emissions = opened.about.emissions()
    rgb = rgb_of(coefficients, scale, index, emissions, observer=opened.observer, space=opened.space)
    table = build_table(emissions[k], observer=opened.observer, space=opened.space)
    between = uplift_pixels(
        ((rgb[:-1] + rgb[1:]) / 2).astype(np.float32), np.zeros((height - 1, width), np.uint32), [table]
    )
    # Colours out of the light's reach went to D65 there, which is another pass: the brighter neighbour's shape is kept.
    own = (between.emission == 0) & np.isfinite(between.coefficients).all(axis=-1)
    upper = scale[:-1] >= scale[1:]
    shape = np.where(upper[..., np.newaxis], coefficients[:-1], coefficients[1:])
    half = (scale[:-1] + scale[1:]) / 2
    nodes = np.empty((2 * height + 1, width, 4), np.float32)
    nodes[1::2, :, :3], nodes[1::2, :, 3] = coefficients, scale
    nodes[2:-1:2, :, :3] = np.where(own[..., np.newaxis], between.coefficients, shape)
    nodes[2:-1:2, :, 3] = np.where(own, between.scale, half)
    nodes[0], nodes[-1] = nodes[1], nodes[-2]
    return _spread(nodes)


def _spread(nodes: Float32) -> Float32:
    """Give texels without light the coefficients of the nearest one with light; the columns are a ring."""
    from scipy.ndimage import distance_transform_edt

    dark = nodes[..., 3] <= 0
    if not dark.any() or dark.all():
        return nodes
    ring = np.concatenate([dark[:, -1:], dark, dark[:, :1]], axis=1)
    rows, columns = distance_transform_edt(ring, return_distances=False, return_indices=True)[:, :, 1:-1]
    nearest = nodes[rows, (columns - 1) % nodes.shape[1], :3]
    out = nodes.copy()
    out[..., :3] = np.where(dark[..., np.newaxis], nearest, nodes[..., :3])
    return out


def d65_of_mitsuba() -> npt.NDArray[np.float64]:
    """Return D65 at 360, 361 … 830 nm as Mitsuba has it: the CIE's 5 nm table, linear between, normalised.

    colour-science's table ends at 780 nm; beyond it the CIE's formula for the D series goes on, to a few per mille.
    """
    import colour

    table = colour.SDS_ILLUMINANTS["D65"]
    series = colour.sd_CIE_illuminant_D_series(colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"])
    coarse = np.arange(360.0, 831.0, 5.0)
    d65 = np.where(
        coarse <= table.wavelengths[-1],
        np.interp(coarse, table.wavelengths, table.values),
        np.interp(coarse, series.wavelengths, series.values),
    )
    return np.asarray(np.interp(_FINE, coarse, d65) / _D65_NORM)


def responses(opened: Opened, k: int) -> npt.NDArray[np.float64]:
    """Return the film's responses [3, 471] of a light's pass at 360, 361 … 830 nm: (x̄, ȳ, z̄) · E_k / D65."""
    import colour

    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    emission = np.interp(_FINE, opened.wavelengths_nm, opened.about.emissions()[k], left=0.0, right=0.0)
    seen = np.stack([np.interp(_FINE, cmfs.wavelengths, cmfs.values[:, i]) for i in range(3)])
    return np.asarray(seen * emission / d65_of_mitsuba())


#: The scene of README.md, also written as example.xml.
EXAMPLE = """<scene version="3.0.0">
    <default name="basis" value="."/>
    <default name="light" value="light0"/>

    <integrator type="path"/>

    <emitter type="envmap">
        <string name="filename" value="$basis/blank.exr"/>
        <!-- Y is up; the middle of the map stands towards +Z, and so turned towards -Z, where the camera looks. -->
        <transform name="to_world"><rotate y="1" angle="180"/></transform>
    </emitter>

    <sensor type="perspective">
        <float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0, 1.5, 6" target="0, 1, 0" up="0, 1, 0"/></transform>
        <film type="specfilm">
            <integer name="width" value="960"/>
            <integer name="height" value="540"/>
            <spectrum name="X" filename="$basis/X_$light.spd"/>
            <spectrum name="Y" filename="$basis/Y_$light.spd"/>
            <spectrum name="Z" filename="$basis/Z_$light.spd"/>
        </film>
        <sampler type="independent"/>
    </sensor>

    <shape type="sphere">
        <point name="center" x="0" y="1" z="0"/>
        <float name="radius" value="1"/>
        <bsdf type="diffuse"><spectrum name="reflectance" value="0.5"/></bsdf>
    </shape>
</scene>
"""

SCRIPT = '''"""Render a scene under the uplift's lights with Mitsuba's own emitter, a pass for each light.

    python passes.py SCENE.xml -o OUT.exr [--spp 256] [--variant llvm_ad_spectral]

SCENE.xml has, as README.md beside this file shows, an envmap of `$basis/blank.exr` and a specfilm with the responses
`$basis/X_$light.spd` and so on; example.xml is a whole scene. OUT.exr is linear sRGB. The samples are those of each
pass, so the picture costs samples x passes. llvm_* variants need LLVM's library (Debian: libllvm19, not 15 or 16; or
name one in DRJIT_LIBLLVM_PATH); scalar_spectral needs none and is slow.
"""

import argparse
import json
from pathlib import Path

import mitsuba as mi
import numpy as np

RGB_FROM_XYZ = np.array(
    [[3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]]
)
FOLDER = Path(__file__).resolve().parent


def put_light(scene, name):
    """Replace the data of the scene's envmap by the coefficients of a light."""
    image = np.array(mi.Bitmap(str(FOLDER / f"{name}.exr")), np.float32)
    if image.shape[2] != 4:
        raise SystemExit(f"{name}.exr: expected the channels c0, c1, c2, scale")
    # Mitsuba repeats columns at the seam: one at the right, or, since 3.6, one on either side.
    left, right = (image[:, -1:], image[:, :1])
    padded = {p.shape: p for p in (np.concatenate(q, axis=1) for q in ([left, image, right], [image, right]))}
    params = mi.traverse(scene)
    keys = [key for key in params.keys() if key == "data" or key.endswith(".data")]
    keys = [key for key in keys if tuple(params[key].shape) in padded]
    if len(keys) != 1:
        raise SystemExit(f"expected one envmap of blank.exr in the scene; found {keys}")
    params[keys[0]] = mi.TensorXf(np.ascontiguousarray(padded[tuple(params[keys[0]].shape)]))
    params.update()


def load(scene_file, name, parameters):
    """Return the scene of one pass; a scene that does not ask for its light is refused."""
    try:
        return mi.load_file(str(scene_file), basis=FOLDER.as_posix(), light=name, **parameters)
    except Exception as error:
        if "unused parameter" not in str(error).lower():
            raise
        raise SystemExit(
            f"{scene_file}: does not use both $basis and $light, so no light of the map would be in the picture. Give the scene an "
            "envmap of $basis/blank.exr and a specfilm with the spectra $basis/X_$light.spd, $basis/Y_$light.spd and "
            f"$basis/Z_$light.spd, as README.md and example.xml beside {Path(__file__).name} show."
        ) from None


def render(scene_file, spp, per_pass=16, seed=0, **parameters):
    """Return the picture [height, width, 3], linear sRGB: the sum of the passes of all lights."""
    total = 0.0
    for light in json.loads((FOLDER / "lights.json").read_text(encoding="utf-8")):
        name = light["name"]
        scene = load(scene_file, name, parameters)
        put_light(scene, name)
        count = max(1, round(spp / per_pass))
        for k in range(count):
            xyz = np.array(mi.render(scene, spp=min(spp, per_pass), seed=seed + k), np.float64)
            total = total + xyz @ RGB_FROM_XYZ.T / count
        print(f"{name}: {light['type']}")
    return total.astype(np.float32)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("-o", "--output", required=True)
    parser.add_argument("--spp", type=int, default=256)
    parser.add_argument("--variant", default="llvm_ad_spectral")
    chosen = parser.parse_args()
    if chosen.variant not in mi.variants() or "spectral" not in chosen.variant:
        spectral = ", ".join(variant for variant in mi.variants() if "spectral" in variant)
        parser.error(f"--variant {chosen.variant}: expected a spectral one of this Mitsuba: {spectral}")
    mi.set_variant(chosen.variant)
    mi.Bitmap(render(chosen.scene, chosen.spp)).write(chosen.output)
'''


def _readme(source: str, lights: list[dict[str, Any]], unit: Unit | None, guessed: str) -> str:
    rows = "\n".join(
        f"| `{light['name']}` | {light['type']} | {kelvin(light['cct'])} | {light['source']} |" for light in lights
    )
    return f"""# {source} for Mitsuba 3 without a plugin

For render farms that allow scripts but no plugins. Each light of the map is a pass with Mitsuba's own `envmap`; the sum of the
passes is the picture. `python passes.py SCENE.xml -o picture.exr` does all of them and needs Mitsuba and numpy only.

| pass | type | CCT | spectrum |
|---|---|---|---|
{rows}
{guessed}
A whole scene, `example.xml` in this folder, to start from:

```xml
{EXAMPLE}```

Of it, `<emitter>` and `<film>` have to be so; the rest is yours. Then

    python passes.py example.xml -o picture.exr --spp 256

renders it. `--variant` (default `llvm_ad_spectral`) is a spectral variant of Mitsuba. The `llvm_*` ones need LLVM's shared library (Debian and
Ubuntu: `apt install libllvm19`; `DRJIT_LIBLLVM_PATH` names another one; not 15 or 16, which abort while rendering); `cuda_ad_spectral` needs
an NVIDIA card, `scalar_spectral` nothing, and is some two hundred times slower. `--spp` is of each pass: the picture costs samples × passes, here
{len(lights)} times as much as one render of that many samples.

`passes.py` fills in `$basis` (the folder it stands in) and `$light` (`light0`, …) for each pass, so write them as they stand here.
`blank.exr` is black: `passes.py` puts a light's data in its place, and without it nothing is lit. Nothing else in the scene shines;
other lights are rendered once, by themselves, and added. Mitsuba's convention holds: the middle of the
map stands towards +Z, `to_world` turns it.

## How it works

`lightN.exr` holds c0, c1, c2 and scale in the layout of Mitsuba's own data, which shines with D65(λ) · scale · S(c0 λ² + c1 λ + c2). The film
responses `X_lightN.spd` … are the colour matching functions times E_N(λ)/D65(λ), from 360 to 830 nm by 1 nm, so each pass has the XYZ that
the light's own spectrum would have given. This holds for every path that keeps its wavelength; fluorescence would break it.
The picture's unit is the map's: {"relative" if unit is None else unit.told()}.

## What is exact, what is lost

- At the texels: the spectra, to Mitsuba's single precision. It evaluates the polynomial in nanometres, where its terms cancel: mostly
  some 10⁻⁶ of the reflectance, in single pixels of deep colour some 10⁻³.
- Between texels Mitsuba interpolates the shape and the scale of a spectrum each by itself. Where a bright and a dark texel of different
  colour meet, as at the rim of the sun, what lies between has a wrong colour; the `envcal` emitter has not. The maps have twice the
  rows of the original to meet Mitsuba's rows, which run from pole to pole; a texel between two of ours has their mean colour.
- Noise: more lights, more passes; and the wavelengths are drawn by the film's response alone.
"""
