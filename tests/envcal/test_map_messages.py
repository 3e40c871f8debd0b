"""What is said of maps that are damaged, unfit or no maps at all."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from envcal import exr, provenance
from envcal.cli import main
from tests.envcal.small_uplift import small_uplift


def envcal(*arguments, status=0):
    done = CliRunner().invoke(main, [str(a) for a in arguments])
    assert done.exit_code == status, done.output
    return done


def written(path, *, spoilt=(), value=np.nan, stage=None):
    """A grey map with a soft gradient, some of its pixels (row, column) spoilt."""
    image = np.linspace(0.5, 1.5, 16 * 32, dtype=np.float32).reshape(16, 32, 1) * np.ones(3, np.float32)
    for row, column in spoilt:
        image[row, column] = value
    attributes = provenance.colour_space("sRGB") | ({} if stage is None else {"envcalStage": stage})
    exr.write(path, exr.rgb_planes(image), attributes=attributes)
    return path


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_map_of_other_programs_is_not_told_of_brackets(tmp_path, value):
    source = written(tmp_path / "map.exr", spoilt=[(3, 12), (4, 5), (7, 0), (9, 9)], value=value)
    for command in ("uplift", "cluster"):
        told = envcal(command, source, "-o", tmp_path / f"{command}.exr").stderr
        assert "bracket" not in told
        assert "clipped" not in told
        assert told.count("NaN or infinite in the file") == 1
        assert "the first at x 12, y 3; x 5, y 4; x 0, y 7" in told
        assert "4 of 512 pixels" in told or "4 pixels" in told


def test_one_pixel_is_one_pixel_and_has_a_place(tmp_path):
    source = written(tmp_path / "map.exr", spoilt=[(3, 12)])
    told = envcal("uplift", source, "-o", tmp_path / "out.exr").stderr
    assert "1 pixel (x 12, y 3): NaN or infinite in the file" in told
    source = written(tmp_path / "map.exr", spoilt=[(5, 30)], value=np.array([-2.0, 1.0, 0.2], np.float32))
    told = envcal("uplift", source, "-o", tmp_path / "out.exr").stderr
    assert "1 pixel (x 30, y 5): colours that no light can show" in told
    assert ", from a negative component. " in told
    assert "average" not in told
    assert "report" not in told


def test_several_negative_pixels_are_counted_with_the_share_that_they_are(tmp_path):
    source = written(tmp_path / "map.exr", spoilt=[(5, 30), (6, 2)], value=np.array([-2.0, 1.0, 0.2], np.float32))
    told = envcal("uplift", source, "-o", tmp_path / "out.exr").stderr
    assert "2 of 512 pixels (" in told
    assert "x 30, y 5; x 2, y 6): colours that no light can show" in told
    assert "2 of them have negative components" in told


def test_places_go_on_counting_from_tile_to_tile(tmp_path, monkeypatch):
    monkeypatch.setattr("envcal.steps.uplift.TILE_PIXELS", 64)  # two rows
    source = written(tmp_path / "map.exr", spoilt=[(3, 12), (14, 5)])
    told = envcal("uplift", source, "-o", tmp_path / "out.exr").stderr
    assert "x 12, y 3; x 5, y 14)" in told


def test_what_photographs_lost_is_still_called_clipped(tmp_path):
    source = written(tmp_path / "map.exr", spoilt=[(3, 12), (4, 5)], stage="panorama")
    told = envcal("uplift", source, "-o", tmp_path / "out.exr").stderr
    assert "missing (clipped in every frame)" in told
    assert "of the map is lost (clipped in every frame)" in told
    assert "in the file" not in told


def test_a_folder_is_called_one_and_the_map_in_it_named(tmp_path):
    source = written(tmp_path / "map.exr")
    for command in ("uplift", "cluster"):
        told = envcal(command, tmp_path, "-o", tmp_path.parent / "out.exr", status=1).stderr
        assert f"{tmp_path}: is a folder; a map, .exr or .hdr, is expected. Give {source}." in told
    (tmp_path / "panorama").mkdir()
    of_run = written(tmp_path / "panorama" / "environment.exr")
    assert f"Give {of_run}." in envcal("uplift", tmp_path, "-o", tmp_path.parent / "out.exr", status=1).stderr


def test_what_was_made_of_a_map_is_no_map_and_the_right_command_is_named(tmp_path):
    (tmp_path / "files").mkdir()
    made, _ = small_uplift(tmp_path / "files")
    map_path, clusters, bands = tmp_path / "files" / "map.exr", tmp_path / "clusters.exr", tmp_path / "bands.exr"
    envcal("cluster", map_path, "-o", clusters)
    envcal("spectra", made, "-o", bands, "--wavelengths", "400:700:50")
    for command in ("uplift", "cluster"):
        told = envcal(command, made, "-o", tmp_path / "out.exr", status=1).stderr
        assert f"{made}: is an uplift file already, and no map (made of map.exr). `envcal spectra`" in told
        told = envcal(command, clusters, "-o", tmp_path / "out.exr", status=1).stderr
        assert "is what `envcal cluster` found in a map, and no map (made of map.exr)" in told
        assert "--clusters" in told
        told = envcal(command, bands, "-o", tmp_path / "out.exr", status=1).stderr
        assert "is a spectral image already" in told
    assert not (tmp_path / "out.exr").exists()
    envcal("uplift", map_path, "--clusters", clusters, "-o", tmp_path / "out.exr")


@pytest.mark.parametrize("given", [False, True])
def test_the_lights_are_in_the_figures_of_an_uplift_as_in_those_of_cluster(tmp_path, given):
    source, clusters = written(tmp_path / "map.exr"), tmp_path / "clusters.exr"
    found = json.loads(envcal("cluster", source, "-o", clusters, "--json").stdout)["figures"]
    more = ["--clusters", clusters] if given else []
    figures = json.loads(envcal("uplift", source, "-o", tmp_path / "out.exr", "--json", *more).stdout)["figures"]
    assert figures["lights"] == found["lights"]
    assert figures["sky"] is False
    assert {"type", "cct", "share", "at"} <= figures["lights"][0].keys()
    assert "emission" not in figures["lights"][0]
    assert figures["pixels"] == 512


def test_what_is_declared_wins_over_indoor_which_gives_the_type_that_is_missing(tmp_path):
    source, lights = written(tmp_path / "map.exr"), tmp_path / "lights.yaml"
    for declared, kind in (("type: incandescent", "incandescent"), ("cct: 4000", "led")):
        lights.write_text(f"- {{at: [0.5, 0.5], {declared}}}\n")
        done = envcal("cluster", source, "-o", tmp_path / "c.exr", "--lights", lights, "--indoor", "led", "--json")
        (light,) = json.loads(done.stdout)["figures"]["lights"]
        assert light["declared"]
        assert light["type"] == kind
