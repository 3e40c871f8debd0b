"""The chart's light in profile and lights: it goes to the light of its colour and to no other, or says why not."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from envcal import cameras, exr, profile
from envcal.errors import EnvcalError
from envcal.steps.chart_light import estimated_camera, given, measure
from uplift.illuminants import cct_duv_of, family_emission
from uplift.lights import Light
from uplift.spectrometer import chart_reflectances
from uplift.spectrometer.camera import typical_camera
from uplift.spectrum import illuminant, observer, xyz_of

EYES = observer()
CAMERA = "Nikon 5100 (NPL)"
MATRIX = np.array([[1.2, -0.3, 0.1], [-0.1, 1.1, -0.1], [0.05, -0.4, 1.5]])
#: As in tests/uplift/test_spectrometer.py.
NEAR = 0.25


@cache
def curves():
    return cameras.sensitivities(CAMERA, EYES.wavelengths_nm)


def a_profile(light, *, lamp=True, noise=0.002, slope=0.0, fall_off=1.0, module=None):
    """The profile of a chart under a light; `slope` tilts red from one side of the chart to the other.

    `module` is the spectrum of the lamp in the picture; None: D65.
    """
    raw = chart_reflectances(EYES) @ (curves() * light[:, None])
    raw = raw * (1 + noise * np.random.default_rng(3).standard_normal((24, 3)))
    shade = np.linspace(fall_off, 1 / fall_off, 24)
    raw[:, 0] *= 1 + slope * ((np.arange(24) % 6) - 2.5) / 2.5
    patches = [
        profile.Patch(
            name=str(k),
            camera_rgb=profile.row(raw[k] * shade[k]),
            noise=profile.row(noise * raw[k]),
            pixels=100,
            light=float(shade[k]),
            target_rgb=(0.2, 0.2, 0.2),
            fitted_rgb=(0.2, 0.2, 0.2),
            delta_e=1.0,
            delta_e_left_out=1.0,
        )
        for k in range(24)
    ]
    chart = profile.Chart(reference="r", found="auto", corners=[], quads=[], cost=None, fit="linear", patches=patches)
    shown = 7.0 * (illuminant("D65", EYES) if module is None else module) @ curves()
    strip = profile.Lamp(
        found="auto",
        polygon=[],
        pixels=50,
        clipped=0,
        rgb=profile.row(MATRIX @ shown),
        noise=(0, 0, 0),
        transform="CAT16",
        luminance="lamp",
        cone_gains=(1, 1, 1),
        spectrum=None if module is None else "module.csv",
    )
    return profile.Profile(
        working_space="ITU-R BT.2020",
        camera=profile.Camera(model="c", lens="", iso=100, f_number=8),
        reference_shot="reference.exr",
        reference_digest="0" * 64,
        chart=chart,
        matrix=profile.matrix_rows(MATRIX),
        lamp=strip if lamp else None,
    )


def a_light(name="LED-B3", *, declared=False, emission=None):
    """A light of the map with the colour of a lamp, and another spectrum."""
    cct, duv = cct_duv_of(illuminant(name, EYES) if emission is None else emission, EYES)
    return Light(
        cluster=0,
        type="smooth",
        cct=cct,
        duv=0.0,
        emission=family_emission("smooth", cct, EYES),
        source="unknown",
        confidence=0.3,
        share=1.0,
        at=(0.5, 0.5),
        declared=declared,
        remedy="declare it",
        cct_seen=cct,
        duv_seen=duv,
        cct_sigma=0.01 * cct,
    )


def colours(*lights):
    return xyz_of(np.array(lights), EYES)


@pytest.mark.parametrize(("camera", "loss"), [(CAMERA, False), (None, True)])
def test_the_profile_tells_the_spectrum_on_its_chart(camera, loss):
    lamp = illuminant("LED-B3", EYES)
    light, warnings = measure(a_profile(lamp, fall_off=1.3), camera, Path())
    assert warnings == [] and light.refused == ""
    assert np.linalg.norm(np.array(light.emission) - lamp) < NEAR * np.linalg.norm(lamp)
    assert light.family == "led" and light.camera == (camera or "")
    assert (light.camera_loss > 1) == loss


def test_an_unknown_camera_is_estimated_from_chart_and_lamp_and_one_like_no_other_is_not_believed():
    found, _ = measure(a_profile(illuminant("A", EYES)), None, Path())
    estimated = estimated_camera(found)
    day = illuminant("D65", EYES)
    true = curves() / (day @ curves() * EYES.step_nm)
    # To the first order in the directions, and without negative values.
    np.testing.assert_allclose(day @ estimated * EYES.step_nm, 1.0, rtol=2e-3)
    mean = typical_camera(EYES).mean
    assert np.linalg.norm(estimated - true) < 0.8 * np.linalg.norm(mean - true)
    assert estimated_camera(found.model_copy(update={"camera_unlikely": 22.0})) is None
    assert estimated_camera(found.model_copy(update={"chi2": 4.9})) is None
    given_one, _ = measure(a_profile(illuminant("A", EYES)), CAMERA, Path())
    assert estimated_camera(given_one) is None and estimated_camera(None) is None


def test_beside_a_lamp_of_its_own_spectrum_the_light_is_measured_too():
    light, module = illuminant("FL11", EYES), illuminant("LED-B1", EYES)
    found, warnings = measure(a_profile(light, module=module), CAMERA, Path(), lamp=module)
    assert warnings == [] and found.refused == ""
    assert np.linalg.norm(np.array(found.emission) - light) < NEAR * np.linalg.norm(light)
    assert found.cct == pytest.approx(cct_duv_of(light, EYES)[0], rel=0.02)
    # Believed to be D65, the same lamp makes the light wrong or refused.
    believed, _ = measure(a_profile(light, module=module), CAMERA, Path())
    assert believed.refused or abs(believed.cct - found.cct) > 1000


def test_the_profile_keeps_what_was_read_what_was_fitted_and_how_far_it_is_trusted(tmp_path):
    whole = a_profile(illuminant("LED-B3", EYES), fall_off=1.3)
    light, _ = measure(whole, None, Path())
    whole.model_copy(update={"light": light}).write(tmp_path / "p.json")
    kept = profile.read(tmp_path / "p.json")
    assert kept.light == light and 0 <= light.trusted <= 1
    raw = np.array([patch.camera_rgb for patch in kept.chart.patches])
    fall_off = np.array([[patch.light] for patch in kept.chart.patches])
    lamp = np.linalg.inv(np.array(kept.matrix)) @ kept.lamp.rgb
    np.testing.assert_allclose(kept.light.readings, raw / fall_off / lamp, rtol=1e-12)
    np.testing.assert_allclose(kept.light.fitted, kept.light.readings, rtol=0.05)
    # What is used goes from the smooth spectrum towards the measured one by the share that is trusted, colour unchanged.
    np.testing.assert_allclose(
        xyz_of(np.array(kept.light.emission), EYES), xyz_of(np.array(kept.light.measured), EYES), rtol=1e-6
    )


def test_the_camera_may_be_a_file_beside_the_settings(tmp_path):
    table = np.column_stack([EYES.wavelengths_nm, curves()])
    np.savetxt(tmp_path / "mine.csv", table, delimiter=",")
    lamp = illuminant("LED-B3", EYES)
    light, _ = measure(a_profile(lamp), "mine.csv", tmp_path)
    named, _ = measure(a_profile(lamp), CAMERA, tmp_path)
    np.testing.assert_allclose(light.emission, named.emission, rtol=1e-6, atol=1e-9)
    with pytest.raises(EnvcalError, match="neither a file"):
        measure(a_profile(lamp), "yours.csv", tmp_path)


def test_without_a_lamp_or_a_whole_chart_nothing_is_measured():
    lamp = illuminant("LED-B3", EYES)
    assert measure(a_profile(lamp, lamp=False), CAMERA, Path()) == (None, [])
    whole = a_profile(lamp)
    part = whole.model_copy(update={"chart": whole.chart.model_copy(update={"patches": whole.chart.patches[:9]})})
    assert measure(part, CAMERA, Path()) == (None, [])


def an_sg(light, *, known):
    """The profile of an SG under a light, with or without its measured reflectances."""
    from benchmarks.chart_kinds import sg_reflectances

    nm = np.arange(400.0, 701.0, 10.0)
    surfaces = np.array([np.interp(EYES.wavelengths_nm, nm, row) for row in sg_reflectances()])
    raw = surfaces @ (curves() * light[:, None])
    raw = raw * (1 + 0.002 * np.random.default_rng(3).standard_normal((140, 3)))
    plain = a_profile(light)
    patches = [
        plain.chart.patches[0].model_copy(
            update={
                "camera_rgb": profile.row(raw[k]),
                "noise": profile.row(0.002 * raw[k]),
                "light": 1.0,
                "reflectance": sg_reflectances()[k].tolist() if known else [],
            }
        )
        for k in range(140)
    ]
    update = {"patches": patches, "wavelengths_nm": nm.tolist() if known else []}
    return plain.model_copy(update={"chart": plain.chart.model_copy(update=update)})


def test_an_sg_measures_the_light_on_it_by_its_own_measured_reflectances_and_without_them_says_what_to_do():
    lamp = illuminant("LED-B3", EYES)
    light, warnings = measure(an_sg(lamp, known=False), CAMERA, Path())
    assert light is None
    (said,) = warnings
    assert "only colours are published" in said and "correct.patches" in said
    light, warnings = measure(an_sg(lamp, known=True), CAMERA, Path())
    assert light is not None and light.refused == "" and warnings == []
    cct, _ = cct_duv_of(lamp, EYES)
    assert light.cct == pytest.approx(cct, rel=0.03)
    assert light.family == "led"


def test_a_refusal_is_kept_told_and_not_used():
    light, warnings = measure(a_profile(illuminant("LED-B3", EYES), slope=0.2), CAMERA, Path())
    assert "several lights" in light.refused
    assert len(warnings) == 1 and "not used" in warnings[0]
    own = a_light()
    assert given([own], colours(own.emission), {"p": light}, EYES) == ([own], [])


def test_what_cannot_be_a_reading_is_a_warning():
    bad = a_profile(illuminant("LED-B3", EYES))
    dark = bad.model_copy(update={"lamp": bad.lamp.model_copy(update={"rgb": (0.0, 0.0, 0.0)})})
    light, warnings = measure(dark, CAMERA, Path())
    assert light is None and "could not be measured" in warnings[0]


def test_the_profile_with_its_light_is_written_and_read_and_one_of_format_1_is_read(tmp_path):
    made = a_profile(illuminant("FL11", EYES))
    light, _ = measure(made, CAMERA, Path())
    whole = made.model_copy(update={"light": light})
    whole.write(tmp_path / "p.json")
    assert profile.read(tmp_path / "p.json") == whole
    old = made.model_dump(mode="json") | {"format": 1}
    del old["light"]
    assert profile.parse(json.dumps(old), place="old").light is None
    earlier = whole.model_dump(mode="json")
    for name in ("measured", "trusted", "readings", "fitted"):
        del earlier["light"][name]
    assert profile.parse(json.dumps(earlier), place="earlier").light.trusted is None


def test_the_spectrum_goes_to_the_light_of_its_colour_and_to_no_other():
    chart, _ = measure(a_profile(illuminant("LED-B3", EYES)), CAMERA, Path())
    own, other = a_light("LED-B3"), a_light("A")
    (first, second), warnings = given([other, own], colours(other.emission, own.emission), {"p.json": chart}, EYES)
    assert warnings == []
    assert first is other
    assert second.type == "measured" and "p.json" in second.source and "led" in second.source
    assert 0.3 <= second.confidence <= 0.99 and second.remedy == ""
    np.testing.assert_allclose(second.emission, chart.emission, rtol=1e-6)
    assert second.kinds == chart.families and first.kinds == other.kinds


@pytest.mark.parametrize(("camera", "remedy"), [("", "balance.camera"), (CAMERA, "")])
def test_a_spectrum_followed_in_part_says_so(camera, remedy):
    chart, _ = measure(a_profile(illuminant("LED-B3", EYES)), CAMERA, Path())
    own = a_light()
    for trusted, told in ((0.25, "only 25% of it"), (1.0, "")):
        part = chart.model_copy(update={"trusted": trusted, "camera": camera})
        (found,), _ = given([own], colours(own.emission), {"p": part}, EYES)
        assert ("only" in found.source) == bool(told) and told in found.source
        assert bool(found.remedy) == (bool(remedy) and bool(told))
        assert not found.remedy or remedy in found.remedy


def test_what_a_person_declared_stays():
    chart, _ = measure(a_profile(illuminant("LED-B3", EYES)), CAMERA, Path())
    own = a_light("LED-B3", declared=True)
    assert given([own], colours(own.emission), {"p": chart}, EYES) == ([own], [])


def test_two_charts_measure_two_lights():
    charts = {name: measure(a_profile(illuminant(name, EYES)), CAMERA, Path())[0] for name in ("LED-B5", "A")}
    lights = [a_light("A"), a_light("LED-B5")]
    found, warnings = given(lights, colours(*(one.emission for one in lights)), charts, EYES)
    assert warnings == []
    assert ["of A" in found[0].source, "of LED-B5" in found[1].source] == [True, True]


def test_a_second_chart_of_the_same_light_is_told_and_not_used():
    chart, _ = measure(a_profile(illuminant("LED-B3", EYES)), CAMERA, Path())
    own = a_light()
    (found,), warnings = given([own], colours(own.emission), {"one": chart, "two": chart}, EYES)
    assert "of one" in found.source
    assert len(warnings) == 1 and "two" in warnings[0]


def test_an_even_mixture_of_two_lights_is_given_to_neither_and_named():
    a, b = illuminant("A", EYES), illuminant("LED-B5", EYES)
    chart, _ = measure(a_profile(0.5 * a + 0.5 * b), CAMERA, Path())
    lights = [a_light("A"), a_light("LED-B5")]
    found, warnings = given(lights, colours(a, b), {"p": chart}, EYES)
    assert found == lights
    assert len(warnings) == 1
    assert "none of the lights" in warnings[0] and "light 0" in warnings[0] and "light 1" in warnings[0]
    share = int(warnings[0].split("light 0 (")[1].split("%")[0])
    assert abs(share - 50) <= 6


def test_a_light_without_a_colour_gets_nothing():
    chart, _ = measure(a_profile(illuminant("LED-B3", EYES)), CAMERA, Path())
    black = replace(a_light(), cct_seen=float("nan"), duv_seen=float("nan"))
    found, warnings = given([black], np.zeros((1, 3)), {"p": chart}, EYES)
    assert found == [black] and "none of the lights" in warnings[0]


@pytest.mark.slow
def test_from_a_capture_beside_a_module_of_its_own_spectrum_the_light_comes_out(tmp_path):
    from fractions import Fraction

    from envcal import config
    from envcal.reporter import Reporter
    from envcal.runner import run_pipeline
    from envcal.stages import STAGES
    from samples import Camera, CaptureSettings, Chart, Furnace, Module, make_capture, write_capture
    from samples.scene import BOARD_M, CHART_BOX_M

    module = Module(spectrum="LED-B1")
    (width, height), (box_x, box_y) = module.size_m, CHART_BOX_M[:2]
    left = 0.5 + (BOARD_M[0] / 2 + module.gap_m + 0.25 * width) / box_x
    inside = [left, 0.5 - 0.4 * height / box_y, 0.5 * width / box_x, 0.8 * height / box_y]
    exposures = tuple(Fraction(8) / 4**k for k in range(4))
    for name, place in (("reference", Furnace("FL2", 80.0, Chart(), module)), ("environment", Furnace("FL2", 80.0))):
        settings = CaptureSettings(
            place=place, width=1024 if place.chart else 64, exposures_s=exposures, camera=Camera(), name=name
        )
        write_capture(tmp_path, make_capture(settings))
    np.savetxt(
        tmp_path / "module.csv", np.column_stack([EYES.wavelengths_nm, illuminant("LED-B1", EYES)]), delimiter=","
    )
    (tmp_path / "pipeline.yaml").write_text(
        "capture: {reference: reference_*.dng, environment: environment_*.dng}\n"
        f"balance: {{spectrum: module.csv, camera: {CAMERA}, lamp: {{chart_rectangle: {inside}}}}}\n"
    )
    to_balance = [stage.name for stage in STAGES].index("balance") + 1
    run_pipeline(config.load(tmp_path / "pipeline.yaml"), STAGES[:to_balance], reporter=Reporter(quiet=True))
    found = profile.read(tmp_path / "output" / "balance" / "profile.json")
    light = illuminant("FL2", EYES)
    assert found.lamp.spectrum == "module.csv" and found.light.refused == ""
    assert np.linalg.norm(np.array(found.light.emission) - light) < NEAR * np.linalg.norm(light)
    assert found.light.cct == pytest.approx(cct_duv_of(light, EYES)[0], rel=0.02)
    # An applied profile brings the light along, in the header of every balanced shot.
    header = exr.header(tmp_path / "output" / "balance" / "environment.exr")
    assert profile.parse(str(header.attributes["envcalProfile"]), place="header").light == found.light
