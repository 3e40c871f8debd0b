"""Each benchmark runs, prints its ratios, and skips what is not installed by name. Times are not judged here."""

import json
import os

import numpy as np
import pytest

from benchmarks import __main__ as program
from benchmarks import roundtrip
from benchmarks import uplift as speed
from benchmarks.maps import KINDS, lamps, random_map, relit_rooms
from uplift.spectrum import observer, rgb_space, rgb_weights

EYES, WIDE = observer(), rgb_space("ITU-R BT.2020")


def test_the_list_names_every_benchmark(capsys):
    assert program.main(["--list"]) == 0
    shown = capsys.readouterr().out
    assert "uplift " in shown and "roundtrip " in shown


def test_an_unknown_benchmark_is_refused(capsys):
    assert program.main(["upfilt"]) == 2
    assert "expected uplift or" in capsys.readouterr().err


def test_the_speed_benchmark_prints_a_ratio_for_every_way_of_uplifting(capsys, tmp_path):
    assert program.main(["uplift", "--size", "64x32", "--crop", "512", "--repeat", "1", "--json", f"{tmp_path}/f"]) == 0
    shown = capsys.readouterr().out
    figures = json.loads((tmp_path / "f").read_text())
    names = [row["name"] for row in figures["rows"]]
    assert {"plain loop", "exact", "scaled", "lattice"} <= set(names)
    assert all(name in shown for name in names)
    assert "ratio exact : lattice" in shown and "peak memory" in shown
    assert any("Mitsuba" in name for name in [*names, *figures["skipped"]])
    exact = next(row for row in figures["rows"] if row["name"] == "exact")
    lattice = next(row for row in figures["rows"] if row["name"] == "lattice")
    assert exact["worst"] < 1e-10 and lattice["worst"] < 1e-8
    assert exact["memory"] > 36  # its results alone have 37 bytes a pixel
    assert exact["pixels"] == 2048 and lattice["pixels"] == 512


def test_a_streamed_map_is_uplifted_from_file_to_file():
    figures = speed.stream(64, 32)
    assert figures["status"]["exact"] > 2000
    assert sum(figures["status"].values()) == 2048
    assert figures["bytes"] > 0 and figures["seconds"] > figures["read_s"] > 0


@pytest.mark.slow
def test_the_large_benchmark_measures_in_a_process_of_its_own(capsys):
    assert program.main(["uplift", "--large", "64x32"]) == 0
    assert "ratio to 8 GB" in capsys.readouterr().out


def test_the_round_trip_benchmark_takes_random_maps_where_there_is_no_folder(capsys, tmp_path, monkeypatch):
    monkeypatch.delenv("ENVCAL_DATA", raising=False)
    arguments = ["roundtrip", "--size", "64x32", "--lamps", "1", "--json", f"{tmp_path}/f"]
    assert program.main(arguments) == 0
    shown = capsys.readouterr().out
    assert "random maps only" in shown and "ratio of the paper's mean" in shown
    figures = json.loads((tmp_path / "f").read_text())
    assert set(figures) == {f"random: {kind}" for kind in KINDS} | {"all"}
    assert figures["all"]["uplifts"] == 5 * len(KINDS)
    assert figures["all"]["pixels"] == sum(figures["all"]["status"].values()) == 5 * 5 * 2048
    assert figures["all"]["delta_e_max"] < 1e-10
    assert figures["all"]["closest_inside_the_locus"] == 0


def test_it_makes_at_least_166_uplifts_by_default():
    eyes = lamps(8, EYES)
    assert len(eyes) * len(KINDS) >= 166
    assert len({name for _, name, _ in eyes}) == 40
    assert len({family for family, _, _ in eyes}) == 5


def test_a_precision_that_is_not_offered_is_refused(capsys):
    with pytest.raises(SystemExit):
        roundtrip.main(["--precision", "double"])
    assert "invalid choice" in capsys.readouterr().err


def test_a_relit_room_is_its_transport_times_the_lamp(tmp_path):
    (tmp_path / "truth").mkdir()
    grid = np.arange(380.0, 781.0, 10.0)
    transport = np.random.default_rng(1).random((3, 2, 4, 41)).astype(np.float16)
    np.savez(tmp_path / "truth" / "room0.npz", transport=transport, wavelengths=grid)
    _, _, emission = lamps(1, EYES)[0]
    ((name, rgb),) = relit_rooms(tmp_path, emission, observer=EYES, space=WIDE)
    total = transport.astype(float).sum(axis=0)
    spectrum = np.interp(EYES.wavelengths_nm, grid, total[1, 3])
    assert name == "room0" and rgb.shape == (2, 4, 3)
    np.testing.assert_allclose(rgb[1, 3], rgb_weights(emission, EYES, WIDE) @ spectrum, rtol=1e-5)


def test_real_maps_are_read_and_clustered(tmp_path, monkeypatch, capsys):
    import cv2

    (tmp_path / "real").mkdir()
    _, _, emission = lamps(1, EYES)[0]
    rgb = random_map("reflectances", 64, 32, emission, observer=EYES, space=WIDE, seed=1)
    cv2.imwrite(str(tmp_path / "real" / "a.hdr"), rgb[..., ::-1])
    monkeypatch.setenv("ENVCAL_DATA", str(tmp_path))
    groups = roundtrip.measure(16, 8, per_family=1, precision="exact")
    assert groups["real: own lights"].uplifts == 1 and groups["real: other lamps"].uplifts == 5
    assert groups["real: own lights"].pixels == 2048
    assert "real: own lights" in roundtrip.report({**groups, "all": groups["real: own lights"]})


def test_the_lights_benchmark_measures_times_where_there_is_no_folder(capsys, tmp_path, monkeypatch):
    monkeypatch.delenv("ENVCAL_DATA", raising=False)
    assert program.main(["lights", "--size", "256", "--json", f"{tmp_path}/f"]) == 0
    shown = capsys.readouterr().out
    assert "times only" in shown and "ratio to 1 s" in shown
    assert json.loads((tmp_path / "f").read_text())["times"]["all_s"] > 0


TIMES = ("sky_s", "clusters_s", "lights_s", "all_s", "all_cpu_s")


@pytest.mark.skipif("ENVCAL_DATA" not in os.environ, reason="ENVCAL_DATA names no folder of rooms")
def test_the_lights_benchmark_knows_the_truth_of_its_rooms():
    from pathlib import Path

    from benchmarks import lights, rooms

    folder = Path(os.environ["ENVCAL_DATA"])
    every = {lamp.name: lamp for lamp in rooms.lamps(folder, EYES)}
    room = rooms.rooms(folder, EYES)[0]
    lamps_on = {0: (every["LED-B3"], 1.0), 1: (every["2700 K"], 0.5)}
    scene = rooms.lit(room, lamps_on, observer=EYES, space=WIDE)
    np.testing.assert_allclose(scene.parts.sum(axis=0), scene.rgb @ WIDE.luminance_weights, rtol=1e-4, atol=1e-6)
    rgb = scene.rgb.reshape(-1, 3)[scene.places]
    np.testing.assert_allclose(
        scene.spectra @ EYES.cmfs * EYES.step_nm @ WIDE.rgb_from_xyz.T, rgb, rtol=1e-3, atol=1e-5
    )
    context = lights.Context(folder, EYES, WIDE)
    row = lights.several_row(scene, context)
    assert row["lamps"] == 2 and 0 <= row["right"] <= 1
    of_two = lights.shared(context, [room], list(every.values()), count=1, seed=0)
    assert "mixed, true" in lights.report({"size": [2, 1], "times": dict.fromkeys(TIMES, 0.0), "shared": of_two})
    same = rooms.relight(scene.spectra, scene.spectra, context.reflectances, observer=EYES, space=WIDE)
    assert same == 0.0
    assert rooms.scaled_error(scene, context.reflectances, observer=EYES, space=WIDE) > 0.1


def test_the_chart_benchmark_counts_what_is_found_and_what_is_not_there(capsys, tmp_path, monkeypatch):
    monkeypatch.delenv("ENVCAL_DATA", raising=False)
    arguments = ["chart", "--first", "5", "--with", "1", "--without", "1", "--maps", "0", "--json", f"{tmp_path}/f"]
    arguments += ["--sg", "0", "--passports", "0", "--two", "0"]
    assert program.main(arguments) == 0
    shown = capsys.readouterr().out
    assert "pictures: 1 of 1 (100.0%) found" in shown and "without: 1 of 1 (100.0%) without a false" in shown
    assert "skipped" in shown
    figures = json.loads((tmp_path / "f").read_text())
    assert figures["pictures"]["good"] == figures["without"]["good"] == 1
    assert figures["pictures"]["missed"] == figures["without"]["missed"] == []
