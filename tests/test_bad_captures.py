"""What people really bring home: each mistake gets a message with place and remedy, and nothing is half-written."""

import dataclasses
import os
import sys
from fractions import Fraction

import numpy as np
import pytest
from click.testing import CliRunner

from envcal import exr, provenance
from envcal.cli import main

SHORT = (Fraction(1, 256), Fraction(1, 64), Fraction(1, 16), Fraction(1, 4))


def envcal(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


def photograph(folder, *, exposures=SHORT, name="a", **place):
    """A flat view of a corner of the room with chart and module, small enough for a test."""
    from samples import Camera, CaptureSettings, Pinhole, Room, make_capture, write_capture

    camera = Camera(**place.pop("camera", {}))
    settings = CaptureSettings(
        place=dataclasses.replace(Room(bounces=1), **place),
        width=480,
        height=360,
        perspective=Pinhole(480, 360, 55.0, 16.0, -9.0),
        exposures_s=exposures,
        camera=camera,
        name=name,
    )
    return write_capture(folder, make_capture(settings))


def pipeline(folder, capture="{reference: a_*.dng}", more=""):
    path = folder / "pipeline.yaml"
    path.write_text(f"capture: {capture}\n{more}")
    return path


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    photograph(folder)
    return folder


def test_a_good_flat_reference_calibrates_and_is_refused_as_a_map(good):
    done = envcal("run", pipeline(good))
    assert done.exit_code == 1
    assert "480×360 pixels" in done.stderr
    assert "exactly twice as wide as high" in done.stderr
    assert (good / "output" / "balance" / "profile.json").is_file()
    assert not (good / "output" / "panorama" / "environment.exr").exists()


def test_a_capture_without_a_chart_is_refused_and_its_merge_kept(tmp_path):
    photograph(tmp_path, chart=None, module=None)
    done = envcal("run", pipeline(tmp_path))
    assert done.exit_code == 1
    assert "correct.chart" in done.stderr
    assert (tmp_path / "output" / "merge" / "reference.exr").is_file()
    assert not (tmp_path / "output" / "correct").exists()


def test_a_capture_without_a_lamp_is_refused_with_the_setting_that_helps(tmp_path):
    photograph(tmp_path, module=None)
    done = envcal("run", pipeline(tmp_path))
    assert done.exit_code == 1
    assert "balance.lamp" in done.stderr
    assert "rectangle" in done.stderr
    assert not (tmp_path / "output" / "balance").exists()


def test_a_lamp_clipped_in_every_frame_is_refused(tmp_path):
    photograph(tmp_path, exposures=(Fraction(1, 2), Fraction(1)))
    done = envcal("run", pipeline(tmp_path))
    assert done.exit_code == 1
    assert "clipped" in done.stderr
    assert "shorter exposure" in done.stderr
    assert not (tmp_path / "output" / "balance").exists()


def test_check_tells_every_mistake_of_the_frames_before_anything_runs(good, tmp_path):
    for path in good.glob("*.dng"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    photograph(tmp_path, name="b", exposures=SHORT[:1], camera={"iso": 400})
    frames = sorted(tmp_path.glob("a_*.dng"))
    frames[0].write_bytes(frames[0].read_bytes()[:5000])
    (tmp_path / "a_notes.dng").write_text("not a photograph")
    done = envcal("check", pipeline(tmp_path, "{reference: '[ab]_*.dng'}"))
    assert done.exit_code == 1
    assert frames[0].name in done.stderr
    assert "a_notes.dng" in done.stderr
    assert "ISO 400" in done.stderr
    assert not (tmp_path / "output").exists()


def test_a_profile_of_another_camera_is_applied_with_a_warning_that_names_both(good, tmp_path):
    envcal("run", pipeline(good))
    profile = good / "output" / "balance" / "profile.json"
    frames = photograph(tmp_path, name="other", camera={"model": "Other 1", "iso": 200}, exposures=SHORT[:3])
    assert envcal("merge", *frames, "-o", tmp_path / "merged.exr").exit_code == 0
    done = envcal("correct", tmp_path / "merged.exr", "-o", tmp_path / "c.exr", "--profile", profile)
    assert done.exit_code == 0
    assert "Other 1" in done.stderr
    assert "ISO" in done.stderr


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text[:200], "is not a profile"),
        (lambda text: text.replace('"matrix"', '"martix"'), "matrix"),
        (lambda _: "[]", "is not a profile"),
        (
            lambda text: text.replace('"iso":100.0', '"iso":NaN').replace('"iso": 100.0', '"iso": NaN'),
            "is not a profile",
        ),
    ],
)
def test_a_damaged_profile_is_refused(good, tmp_path, change, message):
    envcal("run", pipeline(good))
    text = (good / "output" / "balance" / "profile.json").read_text()
    (tmp_path / "p.json").write_text(change(text))
    merged = good / "output" / "merge" / "reference.exr"
    done = envcal("correct", merged, "-o", tmp_path / "c.exr", "--profile", tmp_path / "p.json")
    assert done.exit_code == 1
    assert message in done.stderr
    assert not (tmp_path / "c.exr").exists()


def test_a_shot_that_is_mostly_clipped_is_told_so_before_anything_else(tmp_path):
    photograph(tmp_path, exposures=(Fraction(4), Fraction(16)))
    done = envcal("run", pipeline(tmp_path))
    assert done.exit_code == 1
    assert "of the shot is clipped in every frame" in done.stderr
    assert "shorter exposures" in done.stderr


def test_a_profile_that_is_applied_does_not_pass_for_one_that_was_made_here(good, tmp_path):
    envcal("run", pipeline(good))
    profile = good / "output" / "balance" / "profile.json"
    merged = good / "output" / "merge" / "reference.exr"
    done = envcal("correct", merged, "-o", tmp_path / "c.exr", "--profile", profile)
    assert "no chart was looked for" in done.stdout
    done = envcal("balance", tmp_path / "c.exr", "-o", tmp_path / "b.exr", "--profile", profile)
    assert "no lamp was looked for" in done.stdout


def test_lights_that_may_not_be_what_they_are_taken_for_are_doubted(tmp_path):
    """Two lamps: one is declared as what it is not, a dark corner is declared as if that moved it."""
    image = np.full((128, 256, 3), 0.05, np.float32)
    image[20:40, 30:70] = [9.0, 10.0, 11.0]
    image[60:70, 150:160] = [40.0, 22.0, 9.0]
    image[100:, :] *= np.float32([1.0, 0.9, 0.8])
    attributes = provenance.colour_space("ITU-R BT.2020")
    exr.write(tmp_path / "map.exr", exr.rgb_planes(image), attributes=attributes)
    lights = tmp_path / "lights.yaml"

    def found(text):
        lights.write_text(f"lights: [{text}]\n")
        done = envcal("cluster", tmp_path / "map.exr", "-o", tmp_path / "c.exr", "--lights", lights)
        assert done.exit_code == 0, done.output
        return done.stderr

    assert found("{at: [0.2, 0.24], type: daylight}") == ""
    assert "its spectrum has 2700 K" in found("{at: [0.2, 0.24], type: led, cct: 2700}")
    assert "does not move a surface" in found("{at: [0.9, 0.9], type: led}")
    image[0, 0] = np.nan
    exr.write(tmp_path / "map.exr", exr.rgb_planes(image), attributes=attributes)
    assert "1 pixel (x 0, y 0): NaN or infinite in the file" in found("{at: [0.2, 0.24], type: daylight}")
    photographed = attributes | {"envcalStage": "panorama"}
    exr.write(tmp_path / "map.exr", exr.rgb_planes(image), attributes=photographed)
    assert "lamps are the first to be" in found("{at: [0.2, 0.24], type: daylight}")


def test_an_incomplete_profile_cannot_balance(good, tmp_path):
    envcal("run", pipeline(good))
    incomplete = good / "output" / "correct" / "profile.json"
    corrected = good / "output" / "correct" / "reference.exr"
    done = envcal("balance", corrected, "-o", tmp_path / "b.exr", "--profile", incomplete)
    assert done.exit_code == 1
    assert "no lamp balance yet" in done.stderr


def test_strange_pixels_of_a_map_are_counted_and_harm_no_other(tmp_path):
    rng = np.random.default_rng(5)
    image = rng.random((32, 64, 3), np.float32) + 0.2
    clean = image.copy()
    image[3, 4] = np.nan
    image[5, 6] = [np.inf, 1, 1]
    image[7, 8] = 0
    image[9, 10] = [-1, 0.2, 0.1]
    image[11, 12] = [-0.01, -0.02, -0.03]
    image[13, 14] = 1e-30
    attributes = provenance.colour_space("ITU-R BT.2020")
    exr.write(tmp_path / "map.exr", exr.rgb_planes(image), attributes=attributes)
    exr.write(tmp_path / "clean.exr", exr.rgb_planes(clean), attributes=attributes)
    done = envcal("uplift", tmp_path / "map.exr", "-o", tmp_path / "up.exr", "--json")
    assert done.exit_code == 0, done.output
    assert "2 of 2048 pixels" in done.stderr and "black holes in the light" in done.stderr
    names = ["c0", "c1", "c2", "scale", "cluster", "status"]
    _, planes = exr.read(tmp_path / "up.exr", names)
    assert (planes["status"] == 4).sum() == 2
    assert planes["status"][7, 8] == 1
    assert planes["status"][9, 10] == planes["status"][11, 12] == 3
    assert planes["status"][13, 14] == 0
    assert all(np.isfinite(planes[name]).all() for name in names)
    assert planes["scale"].min() == 0
    assert envcal("spectra", tmp_path / "up.exr", "-o", tmp_path / "s.exr").exit_code == 0
    _, bands = exr.read(tmp_path / "s.exr", ["S0.550,000000nm"])
    assert np.isfinite(bands["S0.550,000000nm"]).all()
    assert bands["S0.550,000000nm"].min() >= 0


def test_a_black_map_and_a_map_of_nothing_but_nan_go_through(tmp_path):
    for name, value in (("black", 0.0), ("nan", np.nan)):
        path = tmp_path / f"{name}.exr"
        exr.write(path, exr.rgb_planes(np.full((16, 32, 3), value, np.float32)), attributes={})
        done = envcal("uplift", path, "-o", tmp_path / f"{name}_up.exr")
        assert done.exit_code == 0, done.output
        assert "holds no light" in done.stderr


def test_clusters_of_another_map_are_refused(tmp_path):
    for name, height in (("one", 16), ("other", 32)):
        image = np.random.default_rng(1).random((height, 2 * height, 3), np.float32)
        exr.write(tmp_path / f"{name}.exr", exr.rgb_planes(image), attributes={})
    assert envcal("cluster", tmp_path / "one.exr", "-o", tmp_path / "clusters.exr").exit_code == 0
    done = envcal("uplift", tmp_path / "other.exr", "-o", tmp_path / "up.exr", "--clusters", tmp_path / "clusters.exr")
    assert done.exit_code == 1
    assert "Run `envcal cluster` on this map" in done.stderr
    assert not (tmp_path / "up.exr").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit on the size of files")
def test_a_disk_that_takes_no_more_leaves_nothing_half_written(tmp_path):
    import subprocess

    exr.write(
        tmp_path / "map.exr", exr.rgb_planes(np.random.default_rng(1).random((256, 512, 3), np.float32)), attributes={}
    )
    limited = (
        "import resource, signal, sys\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))\n"
        "from envcal.cli import main\n"
        f"main(['uplift', {str(tmp_path / 'map.exr')!r}, '-o', {str(tmp_path / 'up.exr')!r}])\n"
    )
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", limited], capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "cannot be written" in done.stderr or "disk is full" in done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["map.exr"]
