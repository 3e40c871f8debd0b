"""Two brackets of one view, lamp on and lamp off, through the pipeline up to the balance."""

import dataclasses
from fractions import Fraction

import numpy as np
import pytest
from click.testing import CliRunner

from envcal import exr, profile
from envcal.cli import main
from samples import Camera, CaptureSettings, Module, Pinhole, Room, make_capture, spectra, write_capture
from uplift.spectrum import rgb_space

SIZE = (320, 240)
# Merge, demosaic and noise at some hundred pixels of a lamp.
READING = 0.01
# u'v' of white in the scene's light: what a matrix fitted under one kind of light errs under another.
WHITE = 0.01


def envcal(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


def photograph(folder, name, *, seed, brighter=1.0, **place):
    """A view of chart and module in a room whose lamps are `brighter` times as bright as they were."""
    room = Room(bounces=1, **place)
    lamps = tuple(dataclasses.replace(lamp, luminance=lamp.luminance * brighter) for lamp in room.lamps)
    settings = CaptureSettings(
        place=dataclasses.replace(room, lamps=lamps),
        width=SIZE[0],
        height=SIZE[1],
        perspective=Pinhole(*SIZE, 55.0, 16.0, -9.0),
        exposures_s=(Fraction(1, 256), Fraction(1, 32), Fraction(1, 4)),
        camera=Camera(),
        seed=seed,
        sub=1,
        name=name,
    )
    capture = make_capture(settings)
    write_capture(folder, capture)
    return capture


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("pair")
    photograph(made, "on", seed=1)
    photograph(made, "off", seed=2, module=Module(luminance=1e-9))
    (made / "off.yaml").write_text("capture: {reference: on_*.dng, lamp_off: off_*.dng}\noutput: off\n")
    return made


def test_the_difference_of_two_brackets_gives_the_balance(folder):
    done = envcal("run", folder / "off.yaml", "--until", "balance")
    assert done.exit_code == 0, done.stderr
    made = profile.read(folder / "off" / "balance" / "profile.json")
    assert made.lamp is not None and made.lamp.found == "pair"
    seen = Camera().responses @ spectra.lamp("D65 module")
    expected = np.asarray(made.matrix) @ seen
    reading = np.asarray(made.lamp.rgb)
    np.testing.assert_allclose(reading / reading[1], expected / expected[1], rtol=READING)
    np.testing.assert_allclose(np.asarray(made.balance_matrix) @ reading, 1.0, rtol=1e-6)
    # The view without the lamp is balanced like any other shot.
    _, image = exr.read_rgb(folder / "off" / "balance" / "lamp_off.exr")
    assert image.shape == (SIZE[1], SIZE[0], 3)


@pytest.mark.slow
def test_the_commands_one_by_one_give_the_same(folder, tmp_path):
    for name in ("on", "off"):
        frames = sorted(folder.glob(f"{name}_*.dng"))
        assert envcal("merge", *frames, "-o", tmp_path / f"{name}.exr", "--set", "deviation=true").exit_code == 0
    assert envcal("correct", tmp_path / "on.exr", "-o", tmp_path / "c.exr").exit_code == 0
    done = envcal(
        "balance", tmp_path / "c.exr", "-o", tmp_path / "b.exr", "--pair", tmp_path / "on.exr", tmp_path / "off.exr"
    )
    assert done.exit_code == 0, done.stderr
    one = profile.read(tmp_path / "b.profile.json").lamp
    assert envcal("run", folder / "off.yaml", "--until", "balance").exit_code == 0
    other = profile.read(folder / "off" / "balance" / "profile.json").lamp
    assert one is not None and other is not None
    np.testing.assert_allclose(one.rgb, other.rgb, rtol=1e-6)
    plain = envcal("merge", *sorted(folder.glob("off_*.dng")), "-o", tmp_path / "plain.exr")
    assert plain.exit_code == 0
    refused = envcal(
        "balance", tmp_path / "c.exr", "-o", tmp_path / "d.exr", "--pair", tmp_path / "on.exr", tmp_path / "plain.exr"
    )
    assert refused.exit_code == 1
    assert "deviation=true" in refused.stderr


def uv(xyz):
    x, y, z = xyz
    return np.array([4 * x, 9 * y]) / (x + 15 * y + 3 * z)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["search", "pair"])
def test_beside_a_module_of_its_own_measured_spectrum_white_comes_out_as_the_room_lights_it(folder, way):
    # A module of 5100 K: taken for D65 it would make the whole room bluish.
    capture = photograph(folder, "warm", seed=4, module=Module(spectrum="LED-B4"))
    np.savetxt(folder / "module.csv", np.column_stack([spectra.WAVELENGTHS_NM, spectra.lamp("LED-B4")]), delimiter=",")
    lamp = "" if way == "pair" else "lamp: {size: [0.056, 0.45], within: 0.2}, "
    shots = "reference: warm_*.dng" + (", lamp_off: off_*.dng" if way == "pair" else "")
    true = uv(capture.truth().patch_xyz[18])
    away = {}
    for name, spectrum in (("own", "spectrum: module.csv, "), ("d65", "")):
        (folder / f"{name}.yaml").write_text(
            f"capture: {{{shots}}}\noutput: {name}_{way}\n"
            f"balance: {{{lamp}{spectrum}camera: {Camera().sensitivities}}}\ncluster: {{chart_spectrum: off}}\n"
        )
        done = envcal("run", folder / f"{name}.yaml", "--until", "balance")
        assert done.exit_code == 0, done.stderr
        made = profile.read(folder / f"{name}_{way}" / "balance" / "profile.json")
        white = np.asarray(made.balance_matrix) @ np.asarray(made.matrix) @ made.chart.patches[18].camera_rgb
        xyz_from_rgb = rgb_space(made.working_space).xyz_from_rgb
        away[name] = float(np.hypot(*(uv(xyz_from_rgb @ white) - true)))
    assert away["own"] < WHITE
    assert away["d65"] > 2 * away["own"]


@pytest.mark.slow
def test_lamps_that_were_dimmed_between_the_brackets_are_refused_with_a_figure(folder):
    photograph(folder, "dusk", seed=3, brighter=0.9, module=Module(luminance=1e-9))
    (folder / "dusk.yaml").write_text("capture: {reference: on_*.dng, lamp_off: dusk_*.dng}\noutput: dusk\n")
    done = envcal("run", folder / "dusk.yaml", "--until", "balance")
    assert done.exit_code == 1
    assert "own light differs by +1" in done.stderr
    assert "steady light" in done.stderr
    assert not (folder / "dusk" / "balance").exists()


def test_a_shot_may_not_take_the_name_of_the_pair(folder):
    path = folder / "named.yaml"
    path.write_text("capture:\n  reference: on_*.dng\n  environment: {lamp_off: off_*.dng}\n")
    done = envcal("check", path)
    assert done.exit_code == 1
    assert "named.yaml:3: capture.environment.lamp_off" in done.stderr
