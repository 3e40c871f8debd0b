"""The unit of an image: from a forward model of a camera back to its cd/m², carried by every file, never mixed or guessed."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from envcal import exr, profile, provenance
from envcal.cli import main
from envcal.config import BalanceSettings, CorrectSettings, PanoramaSettings, PhotometrySettings, SpectraSettings
from envcal.errors import EnvcalError
from envcal.export.basis import export_basis
from envcal.export.pbrt import export_pbrt
from envcal.export.rgb import export_rgb
from envcal.reporter import Reporter
from envcal.runner import Outcome
from envcal.stages import _each
from envcal.steps.absolute import by_exposure, unit_of_chart
from envcal.steps.balance import balance
from envcal.steps.correct import correct
from envcal.steps.panorama import _shared_unit, panorama
from envcal.steps.spectra import spectra
from envcal.unit import ATTRIBUTE, Unit, unit_of
from uplift.spectrum import observer, rgb_space

SPACE = "ITU-R BT.2020"
#: float32 pixels through matrices.
FLOAT32 = 2e-6
#: A grid of 5 nm read at its own wavelengths, in full floats.
SUM_OF_BANDS = 1e-4

#: The scene of the forward model: a camera that sees working RGB with gains, the light on the chart, a D65 lamp.
LIGHT_CD_M2 = 180.0  # of a white diffuser at the chart
LAMP_CD_M2 = 2500.0
GREEN_PER_CD_S = 0.65 * 100 / (78 * 8**2)  # ISO 12232 at ISO 100, f/8: full scale in one second
CAMERA_FROM_WORKING = np.diag([0.5, 1.0, 0.7])
WARM = np.array([1.3, 0.95, 0.5])


def made(**changed: object) -> profile.Profile:
    """A profile as the stages would make it in that scene: the chart's white is 1, the lamp balances to 1."""
    weights = rgb_space(SPACE).luminance_weights
    chart_light = WARM * LIGHT_CD_M2 / (weights @ WARM)
    patches = []
    for name, reflectance in (
        ("red", np.array([0.4, 0.05, 0.05])),
        ("white 9.5 (.05 D)", np.full(3, 0.9)),
        ("white smudge", np.full(3, 0.8)),
        ("black 2 (1.5 D)", np.full(3, 0.03)),
    ):
        seen = CAMERA_FROM_WORKING @ (reflectance * chart_light) * GREEN_PER_CD_S
        patches.append(
            profile.Patch(
                name=name,
                camera_rgb=profile.row(seen),
                noise=(1e-6, 1e-6, 1e-6),
                pixels=90,
                light=1.0,
                left_out=name == "white smudge",
                target_rgb=profile.row(reflectance),
                fitted_rgb=profile.row(reflectance),
                delta_e=0.0,
                delta_e_left_out=0.0,
            )
        )
    matrix = np.diag(1 / (chart_light * GREEN_PER_CD_S)) @ np.linalg.inv(CAMERA_FROM_WORKING)
    lamp = np.full(3, LAMP_CD_M2) / chart_light
    values: dict[str, object] = {
        "working_space": SPACE,
        "camera": profile.Camera(model="M", lens="L", iso=100.0, f_number=8.0, focal_length_mm=24.0),
        "reference_shot": "reference.exr",
        "reference_digest": "0" * 64,
        "chart": profile.Chart(
            reference="x", found="settings", corners=[(1, 1), (9, 1), (9, 6), (1, 6)], quads=[], fit="linear", patches=patches
        ),
        "matrix": profile.matrix_rows(matrix),
        "lamp": profile.Lamp(
            found="settings", polygon=[(1, 1), (2, 1), (2, 2)], pixels=90, clipped=0, rgb=profile.row(lamp),
            noise=(1e-6,) * 3, transform="RGB", luminance="lamp", cone_gains=(1, 1, 1),
        ),
        "balance_matrix": profile.matrix_rows(np.diag(1 / lamp)),
        **changed,
    }  # fmt: skip
    return profile.Profile.model_validate(values)


def merged(folder: Path, scene: np.ndarray, camera: profile.Camera | None = None, name: str = "merged.exr") -> Path:
    """A merged shot of a scene in cd/m², working RGB, as that camera would give it."""
    camera = camera or made().camera
    gain = (camera.iso or 100) / 100 * 64 / (camera.f_number or 8) ** 2
    seen = scene @ CAMERA_FROM_WORKING.T * GREEN_PER_CD_S * gain
    attributes = {
        "envcalStage": "merge",
        "envcalSpace": provenance.CAMERA_RGB,
        "envcalCamera": json.loads(camera.model_dump_json()),
    }
    exr.write(folder / name, exr.rgb_planes(seen), attributes=attributes)
    return folder / name


def scene(height: int = 16) -> np.ndarray:
    return np.random.default_rng(2).uniform(5.0, 400.0, (height, 2 * height, 3))


def balanced(folder: Path, made_with: profile.Profile, shot: Path, name: str = "balanced.exr") -> Path:
    correct(shot, folder / "corrected.exr", CorrectSettings(), made_with)
    balance(folder / "corrected.exr", folder / name, BalanceSettings(), made_with)
    return folder / name


WAYS = {
    "exposure": PhotometrySettings(exposure=True),
    "patch by name": PhotometrySettings.model_validate(
        {"patch": {"patch": "White 9.5", "luminance": 0.9 * LIGHT_CD_M2}}
    ),
    "patch by number": PhotometrySettings.model_validate({"patch": {"patch": 4, "luminance": 0.03 * LIGHT_CD_M2}}),
    "chart": PhotometrySettings(chart_illuminance=math.pi * LIGHT_CD_M2),
}


@pytest.mark.parametrize("way", WAYS)
def test_every_way_to_the_unit_gives_the_scene_back_in_cd_per_square_metre(tmp_path: Path, way: str) -> None:
    unit, warnings = unit_of_chart(made(), WAYS[way])
    assert unit is not None
    assert warnings == []
    assert unit.factor == pytest.approx(LAMP_CD_M2, rel=FLOAT32)
    assert (unit.likely is None) == (way != "exposure")
    out = balanced(tmp_path, made(unit=unit), merged(tmp_path, scene()))
    header, image = exr.read_rgb(out)
    np.testing.assert_allclose(image, scene(), rtol=FLOAT32)
    assert header.attributes["unit"] == "cd.m^-2"
    assert header.attributes["whiteLuminance"] == 1.0
    assert unit_of(out, header.attributes) == unit
    assert profile.parse(str(header.attributes["envcalProfile"]), place="x").unit == unit


def test_relative_is_the_default_and_says_so(tmp_path: Path) -> None:
    assert unit_of_chart(made(), PhotometrySettings()) == (None, [])
    out = balanced(tmp_path, made(), merged(tmp_path, scene()))
    header, image = exr.read_rgb(out)
    assert header.attributes["unit"] == "relative"
    assert "whiteLuminance" not in header.attributes
    np.testing.assert_allclose(image * LAMP_CD_M2, scene(), rtol=FLOAT32)
    done = panorama([out], tmp_path / "map.exr", PanoramaSettings())
    assert "relative" in done.summary


def test_a_root_polynomial_gives_the_same_unit() -> None:
    """The same camera RGB → working RGB for the lamp, part of it through the roots."""
    linear = made()
    lamp_camera = np.linalg.solve(np.array(linear.matrix), np.array(linear.lamp.rgb))  # type: ignore[union-attr]
    roots = np.full((3, 3), 0.3)
    pairs = np.sqrt(lamp_camera * np.roll(lamp_camera, -1))
    matrix = np.array(linear.matrix) - np.outer(roots @ pairs, lamp_camera) / (lamp_camera @ lamp_camera)
    bent = made(matrix=profile.matrix_rows(matrix), root_terms=profile.matrix_rows(roots))
    assert by_exposure(bent) == pytest.approx(by_exposure(linear), rel=1e-9)


@pytest.mark.parametrize("camera", [{"iso": None}, {"f_number": None}])
def test_without_iso_or_aperture_the_exposure_says_nothing_and_is_refused(camera: dict[str, None]) -> None:
    mute = made(camera=made().camera.model_copy(update=camera))
    with pytest.raises(EnvcalError, match=r"photometry\.exposure: .*unknown.*; both are needed"):
        unit_of_chart(mute, PhotometrySettings(exposure=True))
    # A reading needs neither, and has nothing to be held against.
    unit, warnings = unit_of_chart(mute, PhotometrySettings(chart_illuminance=1e6))
    assert unit is not None
    assert warnings == []


@pytest.mark.parametrize("patch", [5, 24, "blue", "", "white"])
def test_a_patch_that_is_not_there_or_not_one_is_refused_with_the_names(patch: int | str) -> None:
    settings = PhotometrySettings.model_validate({"patch": {"patch": patch, "luminance": 100}})
    with pytest.raises(EnvcalError, match=r"one of these is expected: 1 red, 2 white 9\.5"):
        unit_of_chart(made(), settings)


def test_a_black_patch_of_no_luminance_is_refused() -> None:
    patches = [p.model_copy(update={"camera_rgb": (0.0, -1e-6, 0.0)}) for p in made().chart.patches]
    dark = made(chart=made().chart.model_copy(update={"patches": patches}))
    with pytest.raises(EnvcalError, match="a positive one is expected"):
        unit_of_chart(dark, WAYS["patch by number"])


def test_a_doubtful_patch_is_told() -> None:
    def said(patch: str, luminance: float) -> list[str]:
        settings = PhotometrySettings.model_validate({"patch": {"patch": patch, "luminance": luminance}})
        return unit_of_chart(made(), settings)[1]

    (spoilt,) = said("white smudge", 0.8 * LIGHT_CD_M2)
    assert "left out of the chart's fit as spoilt" in spoilt
    (coloured,) = said("red", 25.0)
    assert "red is coloured" in coloured


@pytest.mark.parametrize("illuminance", [math.pi * LIGHT_CD_M2 / 10, math.pi * LIGHT_CD_M2 * 10])
def test_a_reading_that_the_exposure_contradicts_is_told_with_the_ratio(illuminance: float) -> None:
    unit, (warning,) = unit_of_chart(made(), PhotometrySettings(chart_illuminance=illuminance))
    assert unit is not None
    ratio = unit.factor / LAMP_CD_M2
    assert f"{ratio:.3g} times as bright as ISO 100 and f/8" in warning
    assert "Check the reading" in warning


def test_only_one_way_to_the_unit_may_be_given() -> None:
    with pytest.raises(ValueError, match="gives `exposure` and `chart_illuminance`"):
        PhotometrySettings(exposure=True, chart_illuminance=100)


# ---- the map ----


def write_shot(
    path: Path, image: np.ndarray, unit: Unit | None = None, made_with: profile.Profile | None = None
) -> Path:
    attributes = {
        **provenance.attributes("balance", settings={}, inputs=[], unit=unit),
        **provenance.colour_space(SPACE),
    }
    if made_with is not None:
        attributes["envcalProfile"] = made_with.model_dump(mode="json")
    exr.write(path, exr.with_lost(image.astype(np.float32)), attributes=attributes)
    return path


@pytest.mark.parametrize(
    "setting", [{"horizontal_illuminance": 500}, {"vertical_illuminance": {"lux": 500, "toward": 0.3}}]
)
def test_an_illuminance_at_the_maps_place_makes_a_furnace_of_that_illuminance_over_pi(
    tmp_path: Path, setting: dict[str, object]
) -> None:
    shot = write_shot(tmp_path / "shot.exr", np.full((16, 32, 3), 0.25))
    settings = PhotometrySettings.model_validate(setting)
    done = panorama([shot], tmp_path / "map.exr", PanoramaSettings(), settings)
    header, image = exr.read_rgb(tmp_path / "map.exr")
    np.testing.assert_allclose(image, 500 / math.pi, rtol=FLOAT32)
    assert header.attributes["unit"] == "cd.m^-2"
    assert done.figures["unit"]["factor"] == pytest.approx(500 / math.pi / 0.25, rel=FLOAT32)
    assert done.warnings == []


def test_lost_light_on_the_plane_and_an_impossible_illuminance_are_told(tmp_path: Path) -> None:
    image = np.full((16, 32, 3), 0.25)
    image[2, 5:9] = np.nan
    shot = write_shot(tmp_path / "shot.exr", image, made_with=made())
    settings = PhotometrySettings(horizontal_illuminance=0.25 * LAMP_CD_M2 * math.pi * 20)
    done = panorama([shot], tmp_path / "map.exr", PanoramaSettings(), settings)
    assert any("sees is clipped in every frame, and counts as dark" in w for w in done.warnings)
    assert any("times as bright as ISO 100" in w for w in done.warnings)


def test_shots_of_different_units_or_a_second_unit_make_no_map(tmp_path: Path) -> None:
    unit = Unit(factor=100.0, source="a test")
    image = np.full((16, 32, 3), 0.25)
    absolute = write_shot(tmp_path / "a.exr", image, unit)
    with pytest.raises(EnvcalError, match=r"is in cd/m² already, from a test"):
        panorama([absolute], tmp_path / "m.exr", PanoramaSettings(), PhotometrySettings(horizontal_illuminance=500))
    relative = write_shot(tmp_path / "r.exr", image)
    headers = [exr.header(path) for path in (absolute, relative)]
    with pytest.raises(EnvcalError, match=r"r\.exr: is relative, but .*a\.exr is in cd/m²"):
        _shared_unit([absolute, relative], headers)


def test_a_damaged_unit_is_refused_and_a_strangers_is_believed(tmp_path: Path) -> None:
    with pytest.raises(EnvcalError, match=f"`{ATTRIBUTE}` in its header is damaged"):
        unit_of(tmp_path, {"unit": "cd.m^-2", ATTRIBUTE: "{}"})
    with pytest.raises(EnvcalError, match="damaged"):
        unit_of(tmp_path, {"unit": "cd.m^-2", ATTRIBUTE: "{"})
    assert unit_of(tmp_path, {"unit": "furlongs"}) is None
    stranger = unit_of(tmp_path, {"unit": "cd.m^-2"})
    assert stranger is not None
    assert stranger.factor == 1


def test_the_unit_reaches_the_spectra_as_watts_and_the_colours_do_not_depend_on_it(tmp_path: Path) -> None:
    """Σ 683 ȳ P Δλ of the bands is the luminance of the map; the relative map's bands are the same but for the factor."""
    unit = Unit(factor=300.0, source="a test")
    image = np.random.default_rng(5).uniform(0.05, 1.0, (8, 16, 3)) * [1.3, 1.0, 0.7]
    image[3, 3] = 400.0
    weights = rgb_space(SPACE).luminance_weights
    bands = {}
    for name, one, gain in (("relative", None, 1.0), ("absolute", unit, 300.0)):
        shot = write_shot(tmp_path / f"{name}.exr", image * gain, one)
        panorama([shot], tmp_path / f"{name}.map.exr", PanoramaSettings())
        files = [str(tmp_path / f"{name}.{what}.exr") for what in ("map", "uplift")]
        done = CliRunner().invoke(main, ["uplift", files[0], "-o", files[1]], catch_exceptions=False)
        assert done.exit_code == 0, done.output
        path = tmp_path / f"{name}.spectral.exr"
        told = spectra(Path(files[1]), path, SpectraSettings(wavelengths="380:780:5", half=False))
        header, planes = exr.read(path, [c for c in exr.header(path).channels if c.startswith("S0")])
        assert exr.header(Path(files[1])).attributes["unit"] == header.attributes["unit"]
        bands[name] = np.stack([planes[c] for c in sorted(planes)], axis=-1).astype(np.float64)
        assert told.figures["unit"] == header.attributes["bandUnit"]
    assert header.attributes["bandUnit"] == "W.m^-2.sr^-1.nm^-1"
    np.testing.assert_allclose(bands["absolute"] * 683, bands["relative"] * 300, rtol=1e-3)
    luminance = 683 * 5 * bands["absolute"] @ observer().cmfs[:, 1]
    np.testing.assert_allclose(luminance, image * 300 @ weights, rtol=SUM_OF_BANDS)


@pytest.mark.parametrize("unit", [None, Unit(factor=300.0, source="a test")])
def test_what_other_renderers_get_says_its_unit(tmp_path: Path, unit: Unit | None) -> None:
    shot = write_shot(tmp_path / "shot.exr", np.full((8, 16, 3), 0.5), unit)
    panorama([shot], tmp_path / "map.exr", PanoramaSettings())
    uplifted = tmp_path / "uplift.exr"
    arguments = ["uplift", str(tmp_path / "map.exr"), "-o", str(uplifted)]
    assert CliRunner().invoke(main, arguments, catch_exceptions=False).exit_code == 0
    for export in (export_rgb, export_pbrt, export_basis):
        folder = tmp_path / export.__name__
        export(uplifted, folder)
        images = [path for path in folder.glob("*.exr") if path.name != "blank.exr"]
        assert images
        for path in images:
            assert unit_of(path, exr.header(path).attributes) == unit
        text = (folder / "README.md").read_text(encoding="utf-8")
        assert ("cd/m², from a test" in text) == (unit is not None)


def test_lamps_in_candelas_fit_into_half_floats_and_dim_rooms_are_told(tmp_path: Path) -> None:
    image = np.full((8, 16, 3), 0.05)
    image[3, 3] = 3e6
    shot = write_shot(tmp_path / "shot.exr", image, Unit(factor=300.0, source="a test"))
    panorama([shot], tmp_path / "map.exr", PanoramaSettings())
    arguments = ["uplift", str(tmp_path / "map.exr"), "-o", str(tmp_path / "u.exr")]
    assert CliRunner().invoke(main, arguments, catch_exceptions=False).exit_code == 0
    done = spectra(tmp_path / "u.exr", tmp_path / "s.exr", SpectraSettings(half=True))
    kinds = exr.header(tmp_path / "s.exr").channels
    assert {kinds[c] for c in "RGB"} == {"f4"}
    assert {kind for c, kind in kinds.items() if c.startswith("S0")} == {"f2"}
    assert done.figures["dim"] == pytest.approx(127 / 128)
    (warning,) = done.warnings
    assert warning.startswith("127 of 128 pixels stay below 6.1e-05 W")


# ---- the profile on other shots ----


def test_a_shot_of_another_exposure_comes_out_in_the_profiles_unit_and_is_told(tmp_path: Path) -> None:
    unit = Unit(factor=LAMP_CD_M2, source="a test")
    other = made().camera.model_copy(update={"iso": 400.0, "f_number": 4.0})
    shot = merged(tmp_path, scene(), other)
    done = correct(shot, tmp_path / "corrected.exr", CorrectSettings(), made(unit=unit))
    balance(tmp_path / "corrected.exr", tmp_path / "balanced.exr", BalanceSettings(), made(unit=unit))
    np.testing.assert_allclose(exr.read_rgb(tmp_path / "balanced.exr")[1], scene(), rtol=FLOAT32)
    assert done.figures["exposure_gain"] == pytest.approx(1 / 16)
    said = " ".join(done.warnings)
    assert "made with ISO 100, this shot with 400: radiance was scaled" in said
    assert "made with f-number 8, this shot with 4: radiance was scaled" in said
    assert len(done.warnings) == 2


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"model": "N"}, "made with camera M, this shot with N: its colours are wrong"),
        ({"lens": ""}, "made with lens L, this shot with unknown"),
        ({"iso": None}, "made with ISO 100, this shot with unknown: radiance is off by their unknown ratio"),
        ({"f_number": None}, "made with f-number 8, this shot with unknown: radiance is off"),
        ({"focal_length_mm": 35.0}, "made with focal length 24, this shot with 35: the fall-off changes"),
    ],
)
def test_every_way_in_which_a_shot_is_not_the_profiles_is_told(changed: dict[str, object], words: str) -> None:
    (text,) = profile.mismatches(made(), made().camera.model_copy(update=changed))
    assert text.startswith(f"the profile was {words}")
    assert "Photograph a reference with the same" in text


def test_the_same_camera_is_not_warned_of() -> None:
    assert profile.mismatches(made(), made().camera) == []
    # Lenses report 24 mm as 24.0 or 24.2; earlier profiles tell no focal length.
    assert profile.mismatches(made(), made().camera.model_copy(update={"focal_length_mm": 24.3})) == []
    old = made(camera=made().camera.model_copy(update={"focal_length_mm": None}))
    assert profile.mismatches(old, made().camera) == []


def test_what_is_said_alike_of_many_shots_is_said_once_with_their_number() -> None:
    run = SimpleNamespace(reporter=Reporter(quiet=True))
    told = {"reference": [], **{f"s{k}": [f"s{k}.exr: other ISO"] for k in range(5)}, "t": ["t.exr: other lens"]}
    outcome = _each(run, told, lambda shot, _: Outcome(shot, {}, told[shot]))  # type: ignore[arg-type]
    assert outcome.warnings == ["5 of 7 shots (s0, s1, s2, …): other ISO", "t: other lens"]
    alone = _each(run, ["s1"], lambda shot, _: Outcome(shot, {}, told[shot]))  # type: ignore[arg-type]
    assert alone.warnings == ["other ISO"]


# ---- the commands ----


def test_the_commands_take_the_unit_where_it_belongs(tmp_path: Path) -> None:
    def run(*arguments: str) -> tuple[int, str]:
        done = CliRunner().invoke(main, list(arguments))
        return done.exit_code, done.output

    shot = write_shot(tmp_path / "shot.exr", np.full((16, 32, 3), 0.25))
    out = str(tmp_path / "map.exr")
    code, text = run("panorama", str(shot), "-o", out, "--photometry", "horizontal_illuminance=500")
    assert code == 0, text
    assert exr.header(Path(out)).attributes["unit"] == "cd.m^-2"
    code, text = run("panorama", str(shot), "-o", out, "--photometry", "exposure=true")
    assert (code, "belongs to `envcal balance`" in text) == (2, True)
    code, text = run("balance", str(shot), "-o", out, "--photometry", "horizontal_illuminance=500")
    assert (code, "belongs to `envcal panorama`" in text) == (2, True)
    code, text = run("balance", str(shot), "-o", out, "--photometry", "exposure=true", "--profile", "p.json")
    assert (code, "its unit" in text) == (2, True)
    code, text = run("balance", str(shot), "-o", out, "--photometry", "candela=3")
    assert (code, "is not a setting" in text) == (1, True)
