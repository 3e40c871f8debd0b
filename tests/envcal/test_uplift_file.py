"""What is said to those who give something else where an uplift file is expected."""

import re

import numpy as np
import pytest
from click.testing import CliRunner

from envcal import exr
from envcal.cli import main
from envcal.config import SpectraSettings
from envcal.errors import EnvcalError
from envcal.steps.spectra import spectra
from envcal.uplift_file import read_about
from tests.envcal.small_uplift import small_uplift


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return small_uplift(tmp_path_factory.mktemp("uplift"))[0]


def refused(path):
    with pytest.raises(EnvcalError) as caught:
        read_about(path)
    text = str(caught.value)
    assert text.startswith(str(path))
    return text


def test_the_folder_of_a_run_is_told_the_file_within(made, tmp_path):
    (tmp_path / "uplift").mkdir()
    meant = tmp_path / "uplift" / "environment.exr"
    meant.write_bytes(made.read_bytes())
    for folder in (tmp_path, tmp_path / "uplift"):
        assert f"is a folder; an uplift file is expected. Give {meant}." in refused(folder)


def test_a_folder_without_an_uplift_file_names_none(made, tmp_path):
    (tmp_path / "environment.exr").write_bytes(made.with_name("map.exr").read_bytes())  # a map: not what is wanted
    assert "Give the file that `envcal uplift` writes" in refused(tmp_path)


@pytest.mark.parametrize("command", [["mitsuba"], ["export", "--to", "rgb"], ["spectra"]])
def test_every_command_says_that_a_folder_is_one(tmp_path, command):
    done = CliRunner().invoke(main, [command[0], str(tmp_path), *command[1:], "-o", str(tmp_path / "out.exr")])
    assert done.exit_code == 1 and f"{tmp_path}: is a folder" in done.output


def test_an_image_that_is_a_folder_is_called_one(tmp_path):
    with pytest.raises(EnvcalError, match=r"is a folder; an \.exr file is expected"):
        exr.header(tmp_path)


def test_a_map_is_told_the_command_that_keeps_it(made):
    path = made.with_name("map.exr")
    text = refused(path)
    assert f"`envcal uplift {path} -o {path.with_name('map_uplift.exr')}`" in text


def test_a_radiance_map_of_another_format_is_told_so(tmp_path):
    path = tmp_path / "studio.hdr"
    path.write_bytes(b"#?RADIANCE")
    assert f"`envcal uplift {path} -o {tmp_path / 'studio_uplift.exr'}`" in refused(path)


def test_clusters_belong_to_a_map(made):
    path = made.with_name("clusters.exr")
    assert f"`envcal uplift MAP --clusters {path} -o {path.with_name('clusters_uplift.exr')}`" in refused(path)


def test_bands_were_made_of_the_file_that_is_wanted(made, tmp_path):
    path = tmp_path / "spectral.exr"
    spectra(made, path, SpectraSettings(wavelengths="400:700:50"))
    text = refused(path)
    assert "give the uplift file itself" in text and not re.search(r"envcal uplift \S", text)


def test_what_is_no_map_either_is_told_what_is_wanted(tmp_path):
    exr.write(tmp_path / "depth.exr", {"Z": np.ones((4, 8), np.float32)}, attributes={})
    assert "Give the file that `envcal uplift` writes" in refused(tmp_path / "depth.exr")


def test_the_commands_that_are_named_work(made, tmp_path):
    """What the message about a map and that about clusters say to do, done."""
    for source, more in (
        (made.with_name("map.exr"), []),
        (made.with_name("map.exr"), ["--clusters", str(made.with_name("clusters.exr"))]),
    ):
        out = tmp_path / "made.exr"
        done = CliRunner().invoke(main, ["uplift", str(source), *more, "-o", str(out)])
        assert done.exit_code == 0, done.output
        assert read_about(out)[1].format == 1
