"""The stage `correct` on pictures with an SG, and with two charts: what the profile keeps, and what is said."""

import functools

import numpy as np
import pytest

from benchmarks.chart_kinds import scene_with_sg, scene_with_two
from envcal import exr, profile, provenance
from envcal.config import CorrectSettings
from envcal.steps.correct import calibrate_on_chart, correct

SPACE = "ITU-R BT.2020"
SG = "ColorCheckerSG - After November 2014"
# Corners found, in pixels, beside those drawn.
FOUND = 2.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("charts")


def merged(folder, name, image):
    path = folder / f"{name}.exr"
    if not path.exists():
        camera = {"model": "c", "lens": "", "iso": 100.0, "f_number": 8.0, "focal_length_mm": None}
        attributes = {
            **provenance.attributes("merge", settings={}, inputs=[]),
            **provenance.colour_space(provenance.CAMERA_RGB),
            "envcalCamera": camera,
        }
        exr.write(path, exr.with_lost(np.asarray(image, np.float32)), attributes=attributes)
    return path


@functools.cache
def two(seed):
    return scene_with_two(seed)


def test_two_charts_in_different_light_are_told_with_the_corners_of_the_other(folder):
    scene = two(30001)
    made = calibrate_on_chart(merged(folder, "two", scene.image), CorrectSettings(), SPACE)
    np.testing.assert_allclose(made.chart.corners, scene.corners[0], atol=FOUND)
    (other,) = made.chart.others
    np.testing.assert_allclose(other.corners, scene.corners[1], atol=FOUND)
    assert other.light_uv > 0.01
    (said,) = [text for text in made.warnings if "in different light" in text]
    assert "`correct.chart: [[" in said
    outcome = correct(merged(folder, "two", scene.image), folder / "corrected.exr", CorrectSettings(), made)
    assert "another chart reads" in outcome.summary
    assert len(outcome.figures["other_charts"]) == 1
    made.write(folder / "profile.json")
    assert profile.read(folder / "profile.json") == made


@pytest.mark.slow
def test_the_corners_that_are_given_name_the_chart_that_is_used(folder):
    scene = two(30001)
    corners = tuple((float(x), float(y)) for x, y in scene.corners[1])
    made = calibrate_on_chart(merged(folder, "two", scene.image), CorrectSettings(chart=corners), SPACE)
    (other,) = made.chart.others
    np.testing.assert_allclose(other.corners, scene.corners[0], atol=FOUND)
    assert made.chart.found == "settings"


@pytest.mark.slow
def test_two_charts_in_one_light_agree_and_nothing_is_said(folder):
    scene = two(30000)
    made = calibrate_on_chart(merged(folder, "one", scene.image), CorrectSettings(), SPACE)
    (other,) = made.chart.others
    assert other.light_uv < 0.004 and other.delta_e < made.delta_e()["mean"] + 1
    assert not [text for text in made.warnings if "several charts" in text]


def test_an_sg_gives_a_profile_of_140_patches(folder):
    scene = scene_with_sg(30017)
    made = calibrate_on_chart(merged(folder, "sg", scene.image), CorrectSettings(reference=SG), SPACE)
    assert [patch.name for patch in made.chart.patches][:2] == ["A1", "B1"]
    assert len(made.chart.patches) == len(made.chart.quads) == 140
    assert made.delta_e()["mean"] < 4
    assert made.chart.white.target_rgb[1] > 0.85
