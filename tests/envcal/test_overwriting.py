"""No command writes over one of its inputs, by whatever name it is called."""

import os

import numpy as np
import pytest
from click.testing import CliRunner

from envcal import exr
from envcal.cli import main


def envcal(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


@pytest.fixture
def studio(tmp_path):
    path = tmp_path / "studio.exr"
    exr.write(path, exr.rgb_planes(np.ones((8, 16, 3), np.float32)), attributes={})
    return path


@pytest.mark.parametrize("command", ["merge", "correct", "balance", "panorama", "cluster", "uplift", "spectra"])
@pytest.mark.parametrize("through", ["its name", "a longer way", "a symbolic link", "a hard link"])
def test_an_output_that_is_the_input_is_refused_and_the_input_kept(studio, command, through):
    before, out = studio.read_bytes(), studio
    if through == "a longer way":
        (studio.parent / "sub").mkdir()
        out = studio.parent / "sub" / ".." / "studio.exr"
    elif through == "a symbolic link":
        out = studio.parent / "link.exr"
        out.symlink_to(studio)
    elif through == "a hard link":
        out = studio.parent / "hard.exr"
        os.link(studio, out)
    listed = sorted(studio.parent.iterdir())
    done = envcal(command, studio, "-o", out)
    assert done.exit_code == 1
    assert f"{out}: the output is the input" in done.stderr
    assert str(studio) in done.stderr
    assert studio.read_bytes() == before
    assert sorted(studio.parent.iterdir()) == listed


def test_every_input_counts_not_only_the_first(studio):
    other = studio.with_name("clusters.exr")
    other.write_bytes(studio.read_bytes())
    for arguments in (("uplift", studio, "--clusters", other), ("panorama", studio, other), ("merge", studio, other)):
        done = envcal(*arguments, "-o", other)
        assert done.exit_code == 1
        assert f"{other}: the output is the input" in done.stderr
    done = envcal("merge", studio, "--set", f"dark_frame={other}", "-o", other)
    assert f"{other}: the output is the input" in done.stderr


def test_what_is_written_beside_the_output_falls_on_no_input_either(studio):
    lights = studio.with_name("found.lights.json")
    lights.write_text('{"lights": [{"at": [0.5, 0.5], "type": "led"}]}')
    done = envcal("cluster", studio, "-o", studio.with_name("found.exr"), "--lights", lights)
    assert done.exit_code == 1
    assert f"{lights}: is written beside the output found.exr, and it is an input" in done.stderr
    patches = studio.with_name("new.profile.json")
    patches.write_text("{}")
    done = envcal("correct", studio, "-o", studio.with_name("new.exr"), "--set", f"patches={patches}")
    assert done.exit_code == 1
    assert f"{patches}: is written beside" in done.stderr
    done = envcal("balance", studio, "-o", studio.with_name("new.exr"), "--set", f"spectrum={patches}")
    assert f"{patches}: is written beside" in done.stderr


def test_another_file_of_the_outputs_name_may_be_replaced(studio):
    (studio.parent / "out.exr").write_bytes(b"of an earlier run")
    done = envcal("cluster", studio, "-o", studio.parent / "out.exr")
    assert done.exit_code == 0, done.stderr
    assert "R" in exr.header(studio.parent / "out.exr").channels
