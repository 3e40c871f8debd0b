"""The scenes of the lamp's benchmark are what they say, and its verdicts tell right from wrong."""

import types

import numpy as np
import pytest

from benchmarks import __main__ as program
from benchmarks.lamp import Tally, Verdict, known_of, look
from benchmarks.lamp_scenes import Calibrated, cameras, lamp_scene
from samples import spectra
from uplift.spectrum import rgb_space

XYZ_FROM_RGB = rgb_space("ITU-R BT.2020").xyz_from_rgb


def test_a_seed_gives_the_same_scene_and_shows_its_lamp_where_it_says():
    seed = next(seed for seed in range(50) if lamp_scene(seed).readable)
    scene, again = lamp_scene(seed), lamp_scene(seed)
    np.testing.assert_array_equal(scene.radiance, again.radiance)
    assert scene.lamp is not None and scene.place is not None
    assert not (scene.lamp & ~scene.place).any()
    seen = scene.radiance[scene.lamp].mean(axis=0)
    # Its surface reflects some of the scene's light besides.
    assert (seen > 0.9 * scene.camera_lamp).all()


def test_the_cameras_see_d65_as_the_spectra_say():
    name, sensitivities = cameras()[0]
    scene = next(s for s in map(lamp_scene, range(50)) if s.what.endswith(name))
    expected = sensitivities @ spectra.lamp("D65")
    np.testing.assert_allclose(scene.camera_d65 / scene.camera_d65[1], expected / expected[1], rtol=0.15)


@pytest.mark.parametrize(("at", "verdict"), [("lamp", "found"), ("beside", "wrong object")])
def test_a_region_counts_as_found_only_on_the_lamp(at, verdict, monkeypatch):
    from calibrate.lamp import finding

    place = np.zeros((100, 100), bool)
    place[20:40, 20:40] = True
    scene = types.SimpleNamespace(place=place, camera_lamp=np.ones(3), camera_d65=np.ones(3))
    centre = 30.0 if at == "lamp" else 70.0
    reading = types.SimpleNamespace(polygon=np.full((4, 2), centre), rgb=np.ones(3), warnings=(), score=0.9)
    monkeypatch.setattr(finding, "choose_lamp", lambda *_, **__: reading)
    image = np.ones((100, 100, 3), np.float32)
    made = Calibrated(image, np.zeros((4, 2)), np.eye(3))
    view = finding.View(image, np.zeros((100, 100), bool), 0, XYZ_FROM_RGB, [])
    assert look(scene, made, view, colour=None, form=None).what.startswith(verdict)
    reading.rgb = np.array([1.0, 1.0, 1.5])
    if at == "lamp":
        assert look(scene, made, view, colour=None, form=None).what == "found, misread, unwarned"


def test_more_is_known_the_more_is_declared():
    scene = next(s for s in map(lamp_scene, range(50)) if s.readable)
    made = Calibrated(np.ones((2, 2, 3), np.float32), scene.corners, np.eye(3))
    (nothing, no_form), (published, form), (own, same) = (
        known_of(scene, made, declared, seed=1) for declared in ("nothing", "form", "all")
    )
    assert no_form is None and form is not None and form == same
    assert form.within is not None and form.within > scene.facts["gap"]
    np.testing.assert_array_equal(nothing.camera_rgb, published.camera_rgb)
    colours = [colour.camera_rgb / colour.camera_rgb[1] for colour in (published, own)]
    true = scene.camera_lamp / scene.camera_lamp[1]
    assert own.own_spectrum and np.abs(colours[1] / true - 1).max() < 0.08
    assert (own.covariance() < published.covariance()).all()


def test_the_tally_counts_what_passed_without_a_word():
    tally = Tally()
    tally.add("readable", Verdict("found, warned", 0.001, "another region, at …", 0.9), 0.1)
    tally.add("readable", Verdict("found", 0.001, "", 0.999), 0.1)
    tally.add("without", Verdict("wrong object, warned", float("nan"), "may not be the lamp", 0.5), 0.1)
    assert tally.unwarned() == 0
    tally.add("hard", Verdict("found, misread, unwarned", 0.02, "", 0.999), 0.1)
    assert tally.unwarned() == 1
    assert tally.reasons == {"another region": 1}


@pytest.mark.slow
def test_the_benchmark_runs(capsys):
    assert program.main(["lamp", "--with", "2", "--without", "1"]) in (0, 1)
    shown = capsys.readouterr().out
    assert "readable" in shown and "wrong or misread without a warning" in shown
