"""What the benchmarks of the whole pipeline and of unknown cameras say can be false: truth where nothing is left to err."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import estimated_cameras as cameras
from benchmarks import pipeline as bench
from benchmarks.colour import chart, true_reference
from benchmarks.rooms import relight
from envcal import config
from samples import spectra as published
from uplift.spectrum import illuminant, observer, rgb_space

EYES = observer()
SPACE = rgb_space("ITU-R BT.2020", observer=EYES)
LUTHER = EYES.cmfs @ np.array([[0.6, 0.3, 0.05], [0.25, 0.8, -0.02], [0.02, -0.1, 0.7]]).T


@pytest.mark.parametrize("way", bench.WAYS)
def test_the_settings_of_every_way_are_valid_and_tell_what_they_say(way, tmp_path):
    labels = np.full((100, 200), -1)
    labels[20:30, 40:60], labels[50:60, 140:160] = 0, 1
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "a.dng").write_bytes(b"")
    text = bench._yaml(tmp_path, bench.CASES[0], way, SimpleNamespace(labels=labels))
    (tmp_path / "pipeline.yaml").write_text(text, encoding="utf-8")
    loaded = config.load(tmp_path / "pipeline.yaml")
    declared = {"declared": ["led", "incandescent"], "spectra": [None, None], "unmixed": [None, None]}
    assert [light.type for light in loaded.lights] == declared.get(way, [])
    assert all(
        light.at == pytest.approx(at) for light, at in zip(loaded.lights, [(0.25, 0.25), (0.75, 0.55)], strict=False)
    )
    assert (loaded.settings.balance.camera is None) == (way == "nothing")


def test_spectra_of_grey_walls_are_right_by_their_lamp_and_under_d65_by_the_usual_uplift():
    day, warm = illuminant("D65", EYES), illuminant("A", EYES)
    pixels = np.stack([0.4 * day, 0.3 * warm])
    rgb = pixels @ EYES.cmfs * EYES.step_nm @ SPACE.rgb_from_xyz.T
    truth = SimpleNamespace(emission=np.stack([day, warm]), dominant=np.array([[0, 1]]))
    judged = bench.Judged(np.array([0, 0]), np.array([0, 1]), pixels, rgb)
    colours = published.colour_samples()[::9]
    best = bench._best(judged, truth, EYES, SPACE)
    assert relight(best, pixels, colours, observer=EYES, space=SPACE) < 1e-6
    usual = bench._usual(rgb, EYES, SPACE)
    assert relight(usual[:1], pixels[:1], colours, observer=EYES, space=SPACE) < 1e-3
    assert relight(usual[1:], pixels[1:], colours, observer=EYES, space=SPACE) > 0.1


def test_a_camera_that_sees_as_the_eye_does_is_right_in_every_light_by_its_sensitivities_and_by_no_other_way():
    rng = np.random.default_rng(2)
    bumps = np.exp(-0.5 * ((EYES.wavelengths_nm[:, None] - np.linspace(420, 680, 6)) / 30) ** 2)
    others = np.stack([LUTHER * (1 + 0.1 * bumps @ rng.standard_normal((6, 3))) for _ in range(9)])
    others /= (illuminant("D65", EYES) @ others * EYES.step_nm)[:, None, :]
    found = cameras.matrices(LUTHER, others, chart(), true_reference(chart()), "A")
    for name in cameras.OTHERS:
        errors = {way: cameras.difference(matrix, LUTHER, cameras.lights(name)) for way, matrix in found.items()}
        # The module has D65's colour to 1e-9; the matrix is a fit of many spectra, all of which it can meet.
        assert errors["sensitivities"] < 1e-4
        assert min(errors["chart"], errors["estimated"]) > 1e-2
