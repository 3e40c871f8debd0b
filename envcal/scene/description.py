"""The scene as Mitsuba 3 reads it: scene.xml, a file for each lighting, and render.py.

24 spheres with the measured reflectances of a ColorChecker, laid out as the chart is, sit on four steps of grey; a mirror
ball at their left shows the lights, a grey ball of 18 % at their right how these shade. Y is up; the camera looks along −Z,
to where the middle of the map is turned.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from envcal.reflectances import SOURCE, colour_checker

#: Mitsuba's own range. What the chart's measurements do not reach is held constant; the eye sees next to nothing there.
_WAVELENGTHS = np.arange(360.0, 831.0, 10.0)
_RADIUS, _PITCH = 0.42, 1.0
_STEP_HEIGHT, _STEP_DEPTH, _STEPS_WIDTH = 0.6, 1.0, 6.3
_BALL_RADIUS, _BALL_X = 1.15, 4.75
_TABLE_RADIUS = 6.5
_TABLE, _GREY, _MIRROR = 0.30, 0.18, 0.92


def scene_xml(*, width: int, height: int, spp: int) -> str:
    """Return scene.xml; the emitter is included from `$lighting.xml` beside it."""
    return f"""<?xml version="1.0" encoding="utf-8"?>
<!-- A scene to look at an environment map with: 24 spheres with the reflectances of a ColorChecker (colour-science's
     "{SOURCE}"), a mirror ball and a grey ball of 18 %. Y is up; the camera looks towards the middle of the map. -->
<scene version="3.0.0">
    <default name="lighting" value="uplift"/>  <!-- uplift or scaled: which of the files beside gives the light -->
    <default name="width" value="{width}"/>
    <default name="height" value="{height}"/>
    <default name="spp" value="{spp}"/>

    <integrator type="path">
        <integer name="max_depth" value="8"/>
    </integrator>
    <sensor type="perspective">
        <float name="fov" value="34"/>
        <transform name="to_world">
            <lookat origin="0, 4.6, 23" target="0, 1.0, 0" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="$width"/>
            <integer name="height" value="$height"/>
            <string name="pixel_format" value="rgb"/>
            <string name="component_format" value="float32"/>
            <rfilter type="gaussian"/>
        </film>
        <sampler type="multijitter">
            <integer name="sample_count" value="$spp"/>
        </sampler>
    </sensor>

    <include filename="$lighting.xml"/>

    <shape type="disk">  <!-- the table -->
        <transform name="to_world">
            <scale value="{_TABLE_RADIUS:g}"/>
            <rotate x="1" angle="-90"/>
        </transform>
        {_grey(_TABLE, twosided=True)}
    </shape>
{"".join(_step(k) for k in (1, 2, 3))}
    <shape type="sphere">  <!-- the mirror ball -->
        <point name="center" x="{-_BALL_X:g}" y="{_BALL_RADIUS:g}" z="0.6"/>
        <float name="radius" value="{_BALL_RADIUS:g}"/>
        <bsdf type="conductor">
            <string name="material" value="none"/>
            <spectrum name="specular_reflectance" value="{_MIRROR:g}"/>
        </bsdf>
    </shape>
    <shape type="sphere">  <!-- the grey ball -->
        <point name="center" x="{_BALL_X:g}" y="{_BALL_RADIUS:g}" z="0.6"/>
        <float name="radius" value="{_BALL_RADIUS:g}"/>
        {_grey(_GREY)}
    </shape>
{"".join(_sphere(k, *patch) for k, patch in enumerate(colour_checker(_WAVELENGTHS).items()))}
</scene>
"""


def _grey(reflectance: float, *, twosided: bool = False) -> str:
    diffuse = f'<bsdf type="diffuse"><spectrum name="reflectance" value="{reflectance:g}"/></bsdf>'
    return f'<bsdf type="twosided">{diffuse}</bsdf>' if twosided else diffuse


def _depth(row: int) -> float:
    """The z of a row of the chart; the last one, of the greys, is in front."""
    return (row - 1.5) * _STEP_DEPTH + 0.2


def _step(k: int) -> str:
    """The step below row 3 − k: a box from the table up, so that each row stands higher than the one before it."""
    back, front = _depth(0) - _STEP_DEPTH / 2, _depth(3 - k) + _STEP_DEPTH / 2
    half = (_STEPS_WIDTH / 2, k * _STEP_HEIGHT / 2, (front - back) / 2)
    scale = " ".join(f'{axis}="{value:g}"' for axis, value in zip("xyz", half, strict=True))
    return f"""
    <shape type="cube">  <!-- step {k} -->
        <transform name="to_world">
            <scale {scale}/>
            <translate x="0" y="{half[1]:g}" z="{(front + back) / 2:g}"/>
        </transform>
        {_grey(_TABLE)}
    </shape>"""


def _sphere(number: int, name: str, reflectance: npt.NDArray[np.float64]) -> str:
    row, column = divmod(number, 6)
    values = ", ".join(f"{w:g}:{v:.4f}" for w, v in zip(_WAVELENGTHS, reflectance, strict=True))
    return f"""
    <shape type="sphere" id="patch_{number + 1:02d}">  <!-- {name} -->
        <point name="center" x="{(column - 2.5) * _PITCH:g}" y="{(3 - row) * _STEP_HEIGHT + _RADIUS:g}" z="{_depth(row):g}"/>
        <float name="radius" value="{_RADIUS:g}"/>
        <bsdf type="diffuse">
            <spectrum name="reflectance" value="{values}"/>
        </bsdf>
    </shape>"""


#: Turns the middle of the map to −Z, where the camera looks; Mitsuba's maps have it at +Z.
_TURN = '<transform name="to_world"><rotate y="1" angle="180"/></transform>'


def uplift_xml(filename: str) -> str:
    """Return the lighting by the spectra of an uplift file."""
    return f"""<?xml version="1.0" encoding="utf-8"?>
<!-- Light by the spectra of the uplift file; needs `import envcal.mitsuba` in the script that renders. -->
<scene version="3.0.0">
    <emitter type="envcal">
        <string name="filename" value="{filename}"/>
        {_TURN}
    </emitter>
</scene>
"""


def scaled_xml(filename: str) -> str:
    """Return the lighting by the same map as RGB, which Mitsuba's own `envmap` uplifts under D65."""
    return f"""<?xml version="1.0" encoding="utf-8"?>
<!-- Light by the colours alone: Mitsuba gives every pixel a smooth spectrum under D65. For comparison. -->
<scene version="3.0.0">
    <emitter type="envmap">
        <string name="filename" value="{filename}"/>
        {_TURN}
    </emitter>
</scene>
"""


SCRIPT = '''"""Render scene.xml under the uplift's spectra and under plain RGB; uplift.exr and scaled.exr are written beside it.

    python render.py [SAMPLES]

Needs `pip install 'envcal[mitsuba]'`. llvm_ad_spectral wants an LLVM library (Debian: libllvm19); without one take
scalar_spectral, which is slow, or cuda_ad_spectral on an NVIDIA card.
"""

import sys
from pathlib import Path

import drjit as dr
import envcal.mitsuba
import mitsuba as mi

VARIANT = "llvm_ad_spectral"
SAMPLES_PER_PASS = 16  # bounds the memory: a pass holds all its samples at once

folder = Path(__file__).resolve().parent
samples = int(sys.argv[1]) if len(sys.argv) > 1 else 128
envcal.mitsuba.set_variant(VARIANT)
for lighting in ("uplift", "scaled"):
    scene = mi.load_file(str(folder / "scene.xml"), lighting=lighting)
    passes = max(1, round(samples / SAMPLES_PER_PASS))
    image = 0
    for k in range(passes):
        image += mi.render(scene, spp=SAMPLES_PER_PASS, seed=k) / passes
        dr.eval(image)
        print(f"{lighting}: pass {k + 1} of {passes}")
    mi.Bitmap(image).write(str(folder / f"{lighting}.exr"))
'''
