"""The scene as Mitsuba 3 reads it: scene.xml, one file a lighting, and render.py.

24 spheres with the measured reflectances of a ColorChecker, laid out as the chart is (the greys in front), stand on a round
grey table; behind them a mirror ball, which shows the lights, and a grey ball of 18 %, which shows their shading. Y is up, as
in the map; the camera looks along −Z, towards the middle of the map.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from envcal.reflectances import SOURCE, colour_checker

SCENE, SCRIPT = "scene.xml", "render.py"
LIGHTINGS = ("uplift", "scaled")
#: Mitsuba's own range. What the charts' measurements do not reach is held constant; the eye sees next to nothing there.
_WAVELENGTHS = np.arange(360.0, 831.0, 10.0)
_RADIUS, _PITCH = 0.42, 1.0
_BALL_RADIUS = 1.05
_TABLE_RADIUS, _TABLE_EDGE = 4.9, 0.12
_TABLE, _GREY, _MIRROR = 0.30, 0.18, 0.92


def scene_xml(*, width: int, height: int, spp: int) -> str:
    """Return scene.xml; the emitter is included from `$lighting.xml` beside it."""
    spheres = []
    for number, (name, reflectance) in enumerate(colour_checker(_WAVELENGTHS).items()):
        row, column = divmod(number, 6)
        x, z = (column - 2.5) * _PITCH, (row - 1.5) * _PITCH + 0.9
        values = ", ".join(f"{v:.4f}" for v in reflectance)
        spheres.append(f"""
    <shape type="sphere">  <!-- {number + 1} {name} -->
        <point name="center" x="{x:g}" y="{_RADIUS:g}" z="{z:g}"/>
        <float name="radius" value="{_RADIUS:g}"/>
        <bsdf type="diffuse">
            <spectrum type="regular" name="reflectance">
                <float name="wavelength_min" value="{_WAVELENGTHS[0]:g}"/>
                <float name="wavelength_max" value="{_WAVELENGTHS[-1]:g}"/>
                <string name="values" value="{values}"/>
            </spectrum>
        </bsdf>
    </shape>""")
    return f"""<?xml version="1.0" encoding="utf-8"?>
<!-- A scene to look at an environment map with: 24 spheres of ColorChecker reflectances (colour-science's "{SOURCE}"), a
     mirror ball, a grey ball of 18 %, a round table. Y is up; the camera looks towards the middle of the map. -->
<scene version="3.0.0">
    <default name="lighting" value="uplift"/>  <!-- uplift or scaled: which of the files beside gives the light -->
    <default name="width" value="{width}"/>
    <default name="height" value="{height}"/>
    <default name="spp" value="{spp}"/>

    <integrator type="path">
        <integer name="max_depth" value="8"/>
    </integrator>
    <sensor type="perspective">
        <float name="fov" value="33"/>
        <transform name="to_world">
            <lookat origin="0, 4.3, 11.2" target="0, 0.42, -0.35" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="$width"/>
            <integer name="height" value="$height"/>
            <string name="pixel_format" value="rgb"/>
            <string name="component_format" value="float32"/>
            <rfilter type="gaussian"/>
        </film>
        <sampler type="independent">
            <integer name="sample_count" value="$spp"/>
        </sampler>
    </sensor>

    <include filename="$lighting.xml"/>

    <shape type="disk">  <!-- the table -->
        <transform name="to_world">
            <scale value="{_TABLE_RADIUS:g}"/>
            <rotate x="1" angle="-90"/>
        </transform>
        <bsdf type="twosided">
            <bsdf type="diffuse">
                <spectrum name="reflectance" value="{_TABLE:g}"/>
            </bsdf>
        </bsdf>
    </shape>
    <shape type="cylinder">  <!-- its edge -->
        <point name="p0" x="0" y="{-_TABLE_EDGE:g}" z="0"/>
        <point name="p1" x="0" y="0" z="0"/>
        <float name="radius" value="{_TABLE_RADIUS:g}"/>
        <bsdf type="twosided">
            <bsdf type="diffuse">
                <spectrum name="reflectance" value="{_TABLE:g}"/>
            </bsdf>
        </bsdf>
    </shape>

    <shape type="sphere">  <!-- the mirror ball -->
        <point name="center" x="-1.6" y="{_BALL_RADIUS:g}" z="-2.3"/>
        <float name="radius" value="{_BALL_RADIUS:g}"/>
        <bsdf type="conductor">
            <string name="material" value="none"/>
            <spectrum name="specular_reflectance" value="{_MIRROR:g}"/>
        </bsdf>
    </shape>
    <shape type="sphere">  <!-- the grey ball -->
        <point name="center" x="1.6" y="{_BALL_RADIUS:g}" z="-2.3"/>
        <float name="radius" value="{_BALL_RADIUS:g}"/>
        <bsdf type="diffuse">
            <spectrum name="reflectance" value="{_GREY:g}"/>
        </bsdf>
    </shape>
{"".join(spheres)}
</scene>
"""
