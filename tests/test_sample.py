"""The shipped sample through the whole pipeline, held against what is true of the room it shows."""

import json
from pathlib import Path

import numpy as np
import pytest

from envcal import config, exr, profile
from envcal.reporter import Reporter
from envcal.runner import run_pipeline
from envcal.stages import STAGES

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def truth():
    from samples import make_capture

    return make_capture().truth()


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sample") / "output"
    loaded = config.load(ROOT / "pipeline.yaml", overrides=[f"output={folder}"])
    run_pipeline(loaded, STAGES, reporter=Reporter(quiet=True))
    return folder


@pytest.fixture(scope="module")
def record(output):
    return json.loads((output / "run.json").read_text(encoding="utf-8"))["stages"]


def test_merged_radiance_is_within_one_percent_of_the_truth(output, truth):
    """Median over the pixels that stand above the noise floor in the longest exposure that does not clip them.

    Edges are left out: a mosaic does not measure all three colours of a pixel there, whoever merges it.
    """
    _, image = exr.read_rgb(output / "merge" / "reference.exr")
    true = truth.camera_rgb
    smooth = np.ones(true.shape[:2], bool)
    for axis in (0, 1):
        for step in (-2, -1, 1, 2):
            smooth &= (np.abs(np.roll(true, step, axis) / np.maximum(true, 1e-12) - 1) < 0.05).all(axis=2)
    # 50 000 electrons at the white level; 8 s is the longest exposure. 100 electrons: a tenth of the signal is noise.
    lit = (true * 50_000 * 8 > 100).all(axis=2)
    error = np.abs(image / np.maximum(true, 1e-12) - 1)
    assert smooth.mean() > 0.5
    for channel in range(3):
        assert np.median(error[..., channel][smooth & lit]) < 0.01
        assert np.median(error[..., channel][lit]) < 0.01
    bias = (image / np.maximum(true, 1e-12) - 1)[smooth & lit]
    assert abs(np.mean(bias)) < 2e-3


def test_no_light_is_lost_and_the_hot_pixels_are_found(record):
    figures = record["merge"]["figures"]["shots"]["reference"]
    assert figures["lost"] == 0
    assert 0 < figures["defects"] <= 40


def test_the_chart_is_found_where_it_stands(output, truth):
    chart = profile.read(output / "balance" / "profile.json").chart
    width = np.hypot(*(truth.chart_corners[1] - truth.chart_corners[0]))
    assert np.abs(np.asarray(chart.corners) - truth.chart_corners).max() < 0.03 * width


def test_the_charts_colours_are_met(record):
    delta_e = record["correct"]["figures"]["shots"]["reference"]["delta_e"]
    assert delta_e["mean"] <= 2.5
    assert delta_e["mean"] < delta_e["left_out_mean"]


def test_the_lamp_reads_one_within_one_percent_where_the_truth_says_it_is(output, truth):
    _, image = exr.read_rgb(output / "balance" / "reference.exr")
    # The rim of the module is a mixture even where the pixel shows nothing else: demosaicing reaches one pixel.
    inside = truth.module.copy()
    for axis in (0, 1):
        for step in (-1, 1):
            inside &= np.roll(truth.module, step, axis)
    assert inside.sum() > 50
    assert image[inside].mean(axis=0) == pytest.approx([1, 1, 1], rel=0.01)


def test_every_lamp_of_the_room_is_recovered_within_five_percent_of_its_temperature(output, truth):
    lights = json.loads((output / "cluster" / "lights.json").read_text(encoding="utf-8"))["lights"]
    lamps = [name for name in truth.emitters if name != "D65 module"]
    height, width = truth.labels.shape
    found = {}
    for light in lights:
        u, v = light["at"]
        y, x = int(v * height), int(u * width)
        around = truth.labels[max(y - 3, 0) : y + 4, max(x - 3, 0) : x + 4]
        seen = around[around >= 0]
        assert seen.size, f"the light at {light['at']} is no lamp of the room"
        found[truth.emitters[np.bincount(seen).argmax()]] = light["cct_seen"]
    assert sorted(found) == sorted(lamps)
    for name, cct in found.items():
        assert cct == pytest.approx(truth.cct_k[truth.lamp(name)], rel=0.05), name


def test_the_room_has_no_sky(record):
    assert record["cluster"]["figures"]["sky"] is False


def test_the_uplift_gives_back_the_map(record):
    figures = record["uplift"]["figures"]
    assert figures["round_trip_delta_e"]["max"] <= 1e-8
    assert figures["round_trip_nan"] == 0
    # float32 in the file: a few units in the last place of c0 λ² + c1 λ + c2.
    assert figures["round_trip_delta_e_stored"]["max"] < 0.01
    assert sum(figures["status"].values()) == figures["pixels"]
    assert figures["status"]["missing"] == 0


def test_the_spectral_image_is_read_by_colour_science_and_integrates_to_the_map(output):
    import colour

    from uplift.spectrum import observer, rgb_space, xyz_of

    path = output / "spectra" / "environment.exr"
    header = exr.header(path)
    assert header.attributes["spectralLayoutVersion"] == "1.0"
    assert header.attributes["emissiveUnits"] == "W.m^-2.sr^-1"
    assert header.latlong
    components = colour.read_spectral_image_Fichet2021(path)
    components = components[0] if isinstance(components, tuple) else components
    wavelengths, values = components["S0"]
    assert wavelengths == pytest.approx(np.arange(380, 781, 10))
    _, image = exr.read_rgb(path)
    seen = observer(380, 780, 10)
    back = xyz_of(np.asarray(values, np.float64), seen) @ rgb_space(header.attributes["envcalSpace"]).rgb_from_xyz.T
    bright = image.min(axis=2) > 0.01
    # The bands are twice as wide as the grid of the uplift, and half floats keep 11 bits.
    assert np.median(np.abs(back[bright] / image[bright] - 1)) < 0.02


def test_every_file_says_what_it_holds(output):
    for path in sorted(output.glob("*/*.exr")):
        header = exr.header(path)
        assert header.attributes["envcalStage"] == path.parent.name
        assert header.attributes["unit"] == "relative"
        assert header.json("envcalSettings") is not None
        assert all(len(digest) == 64 for digest in header.json("envcalInputs").values())
        assert header.latlong == (path.parent.name in {"panorama", "cluster", "uplift", "spectra"})
        assert (header.chromaticities is None) == (path.parent.name == "merge")


@pytest.mark.parametrize(
    ("way", "within"),
    [
        # The sample's camera keeps the standard for equal energy, not for daylight: 3 % of green.
        ("exposure", 0.05),
        ("patch", 0.03),
        # The light in the middle of the chart, from its patches' published luminance factors, which are for D65.
        ("chart", 0.04),
        # The map's own errors, the dim and coloured parts included, are summed up in it.
        ("map", 0.05),
    ],
)
def test_every_way_to_absolute_units_gives_the_rooms_own_candelas(output, truth, tmp_path, way, within):
    from envcal.config import BalanceSettings, PanoramaSettings, PhotometrySettings
    from envcal.steps.balance import balance, calibrate_on_lamp
    from envcal.steps.panorama import panorama
    from uplift.spectrum import rgb_space

    true = truth.xyz[..., 1]
    height, width = true.shape
    theta = np.pi * (np.arange(height // 2) + 0.5) / height
    over = np.cos(theta) * np.sin(theta) * 2 * np.pi**2 / (width * height)
    white = truth.patch_xyz[18, 1]
    weights = rgb_space("ITU-R BT.2020").luminance_weights
    patches = profile.read(output / "correct" / "profile.json").chart.patches
    published = np.array([patch.target_rgb for patch in patches]) @ weights
    photometry = PhotometrySettings.model_validate(
        {
            "exposure": {"exposure": True},
            "patch": {"patch": {"patch": "white", "luminance": white}},
            "chart": {"chart_illuminance": np.pi * float(np.exp(np.mean(np.log(truth.patch_xyz[:, 1] / published))))},
            "map": {"horizontal_illuminance": float((true[: height // 2] * over[:, np.newaxis]).sum())},
        }[way]
    )
    corrected, balanced = output / "correct" / "reference.exr", tmp_path / "balanced.exr"
    settings = BalanceSettings(camera="Nikon 5100 (NPL)")
    made = calibrate_on_lamp(corrected, settings, photometry)
    assert not any("photometry" in text for text in made.warnings)
    balance(corrected, balanced, settings, made)
    done = panorama([balanced], tmp_path / "map.exr", PanoramaSettings(), photometry if way == "map" else None)
    assert not done.warnings
    header, image = exr.read_rgb(tmp_path / "map.exr")
    assert header.attributes["unit"] == "cd.m^-2"
    luminance = image @ weights
    lit = true > np.median(true)
    assert np.median(luminance[lit] / true[lit]) == pytest.approx(1, abs=within)


def test_a_second_run_does_no_stage_again(output):
    before = {path: path.stat().st_mtime_ns for path in output.rglob("*.*") if path.name not in ("run.json", ".lock")}
    loaded = config.load(ROOT / "pipeline.yaml", overrides=[f"output={output}"])
    run_pipeline(loaded, STAGES, reporter=Reporter(quiet=True))
    assert before == {path: path.stat().st_mtime_ns for path in before}


def test_the_stages_one_at_a_time_make_the_same_pixels_as_the_pipeline(output, tmp_path):
    from click.testing import CliRunner

    from envcal.cli import main

    def envcal(*arguments):
        done = CliRunner().invoke(main, [str(a) for a in arguments])
        assert done.exit_code == 0, done.output
        return done

    frames = sorted((ROOT / "samples" / "capture").glob("*.dng"))
    envcal("merge", *frames, "-o", tmp_path / "merged.exr")
    envcal("correct", tmp_path / "merged.exr", "-o", tmp_path / "corrected.exr")
    camera = "Nikon 5100 (NPL)"  # as pipeline.yaml has it
    envcal("balance", tmp_path / "corrected.exr", "-o", tmp_path / "balanced.exr", "--camera", camera)
    envcal("panorama", tmp_path / "balanced.exr", "-o", tmp_path / "environment.exr")
    envcal("cluster", tmp_path / "environment.exr", "-o", tmp_path / "clusters.exr")
    envcal(
        "uplift", tmp_path / "environment.exr", "-o", tmp_path / "uplift.exr", "--clusters", tmp_path / "clusters.exr"
    )
    envcal("spectra", tmp_path / "uplift.exr", "-o", tmp_path / "spectral.exr", "--wavelengths", "380:780:10", "--half")
    for mine, theirs in (
        ("merged.exr", "merge/reference.exr"),
        ("balanced.exr", "balance/reference.exr"),
        ("environment.exr", "panorama/environment.exr"),
        ("uplift.exr", "uplift/environment.exr"),
        ("spectral.exr", "spectra/environment.exr"),
    ):
        names = sorted(exr.header(tmp_path / mine).channels)
        one, other = (exr.read(path, names)[1] for path in (tmp_path / mine, output / theirs))
        assert all(np.array_equal(one[name], other[name], equal_nan=True) for name in names), mine
    # The profile made on the reference, applied to the same bracket as if it were footage, gives the same picture.
    completed = tmp_path / "balanced.profile.json"
    envcal("correct", tmp_path / "merged.exr", "-o", tmp_path / "footage.exr", "--profile", completed)
    envcal("balance", tmp_path / "footage.exr", "-o", tmp_path / "footage_balanced.exr", "--profile", completed)
    assert np.array_equal(
        exr.read_rgb(tmp_path / "footage_balanced.exr")[1], exr.read_rgb(tmp_path / "balanced.exr")[1]
    )
