"""Files for other renderers: right in layout and colour, and honest about what they lose."""

import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from envcal import exr, provenance
from envcal.cli import main
from envcal.errors import EnvcalError
from envcal.export.basis import d65_of_mitsuba, export_basis, native_nodes, responses
from envcal.export.loss import loss, sample
from envcal.export.octahedral import resampled, side_of, sphere_of, square_of
from envcal.export.opened import bands, conversion, open_uplift, undeclared
from envcal.export.pbrt import export_pbrt
from envcal.export.rgb import export_rgb
from envcal.scene.make import make_scene
from tests.envcal.small_uplift import EYES, SPACE, small_uplift
from uplift.radiance import spectra_of
from uplift.spectrum import RGB_SPACES, observer, rgb_space

#: float32 in the file, twice rounded.
FLOAT32 = 2e-6
#: Stored coefficients are rounded to float32; their polynomial cancels some digits.
STORED = 2e-3


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return small_uplift(tmp_path_factory.mktemp("uplift"))


# ---- the square map ----


def directions(count=4000, seed=0):
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def test_square_and_sphere_are_each_others_inverse():
    d = directions()
    uv = square_of(d)
    assert uv.min() >= 0 and uv.max() <= 1
    np.testing.assert_allclose(sphere_of(uv[:, 0], uv[:, 1]), d, atol=1e-7)


def test_the_square_has_the_poles_and_axes_where_clarberg_puts_them():
    places = {
        (0.5, 0.5): (0, 0, 1),
        (1, 0.5): (1, 0, 0),
        (0.5, 1): (0, 1, 0),
        (0, 0.5): (-1, 0, 0),
        (0.5, 0): (0, -1, 0),
    }
    places |= {(a, b): (0, 0, -1) for a in (0, 1) for b in (0, 1)}
    for (u, v), direction in places.items():
        np.testing.assert_allclose(sphere_of(u, v), direction, atol=1e-12)


def test_equal_areas_stay_equal():
    """The parallelogram that a small square becomes has 4π of its area, wherever it stands."""
    u, v = np.random.default_rng(4).uniform(0.001, 0.999, (2, 2000))
    step = 1e-6
    along_u = (sphere_of(u + step, v) - sphere_of(u - step, v)) / (2 * step)
    along_v = (sphere_of(u, v + step) - sphere_of(u, v - step)) / (2 * step)
    np.testing.assert_allclose(np.linalg.norm(np.cross(along_u, along_v), axis=-1), 4 * np.pi, rtol=1e-6)


def test_a_texel_of_the_lat_long_map_lands_where_its_direction_is():
    height, width, side = 32, 64, side_of(64)
    for row, column in ((5, 3), (20, 40), (30, 63)):
        latlong = np.zeros((height, width, 3), np.float32)
        latlong[row, column] = 1.0
        square = resampled(latlong, np.zeros((height, width), np.uint8), 0, side)[..., 1]
        theta, phi = np.pi * (row + 0.5) / height, 2 * np.pi * (column + 0.5) / width
        u, v = square_of([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
        y, x = np.unravel_index(square.argmax(), square.shape)
        assert abs(x + 0.5 - u * side) < 1.5 and abs(y + 0.5 - v * side) < 1.5


def test_the_clusters_of_a_square_map_add_up_and_keep_the_light():
    height, width, side = 64, 128, side_of(128)
    rng = np.random.default_rng(2)
    latlong = rng.uniform(0, 1, (height, width, 3)).astype(np.float32)
    cluster = rng.integers(0, 3, (height, width)).astype(np.uint8)
    whole = resampled(latlong, np.zeros_like(cluster), 0, side)
    parts = sum(resampled(latlong, cluster, k, side) for k in range(3))
    np.testing.assert_allclose(parts, whole, atol=1e-6)
    sines = np.sin(np.pi * (np.arange(height) + 0.5) / height)
    mean = latlong.mean(axis=1).T @ sines / sines.sum()
    np.testing.assert_allclose(whole.mean(axis=(0, 1)), mean, rtol=5e-3)


def test_an_even_map_stays_even():
    latlong = np.full((16, 32, 3), 0.7, np.float32)
    assert np.ptp(resampled(latlong, np.zeros((16, 32), np.uint8), 0, side_of(32))) < 1e-6


# ---- RGB ----


def test_the_map_in_its_own_space_is_the_map(made, tmp_path):
    outcome = export_rgb(made[0], tmp_path, space=SPACE)
    header, image = exr.read_rgb(tmp_path / "environment_rec2020.exr")
    np.testing.assert_allclose(image, made[1], rtol=STORED, atol=1e-4)
    assert header.latlong and header.attributes["envcalSpace"] == SPACE and outcome.figures["overflow"] == 0
    assert provenance.space_of(header.path, header.chromaticities, asked=None) == SPACE


@pytest.mark.parametrize("space", ["ACEScg", "sRGB", "ACES2065-1", "P3-D65"])
def test_white_stays_white_in_every_space(space):
    matrix = conversion(rgb_space(SPACE, observer=EYES), rgb_space(space, observer=EYES))
    np.testing.assert_allclose(matrix @ np.ones(3), 1, atol=1e-12)


def test_between_spaces_of_one_white_nothing_is_adapted():
    wide, narrow = rgb_space(SPACE, observer=EYES), rgb_space("sRGB", observer=EYES)
    np.testing.assert_allclose(conversion(wide, narrow), narrow.rgb_from_xyz @ wide.xyz_from_rgb, atol=1e-12)


def test_the_adaptation_to_acescg_is_that_of_colour_science():
    import colour

    source, target = colour.RGB_COLOURSPACES[SPACE], colour.RGB_COLOURSPACES["ACEScg"]
    known = colour.matrix_RGB_to_RGB(source, target, chromatic_adaptation_transform="Bradford")
    ours = conversion(rgb_space(SPACE, observer=EYES), rgb_space("ACEScg", observer=EYES))
    np.testing.assert_allclose(ours, known, atol=2e-4)  # they round white to four digits


def test_what_a_half_float_cannot_hold_is_counted(tmp_path):
    source, _ = small_uplift(tmp_path, peak=2e5)
    outcome = export_rgb(source, tmp_path / "rgb", space=SPACE, half=True)
    _, image = exr.read_rgb(tmp_path / "rgb" / "environment_rec2020.exr")
    assert outcome.figures["overflow"] == 1 and image.max() == 65504 and 0.5 < outcome.figures["light_lost"] < 1
    assert "1 of 128 pixels are brighter than a half float can hold" in outcome.warnings[0]


def test_colours_outside_of_the_space_are_kept_and_counted(tmp_path):
    source, _ = small_uplift(tmp_path, saturated=True)
    outcome = export_rgb(source, tmp_path / "rgb", space="sRGB")
    _, image = exr.read_rgb(tmp_path / "rgb" / "environment_srgb.exr")
    assert outcome.figures["outside"] >= 16 and image.min() < 0
    assert "colours outside of sRGB" in outcome.warnings[0]


@pytest.mark.parametrize(("space", "remedy"), [("sRGB", True), ("ACEScg", True), ("ACES2065-1", False)])
def test_a_space_too_small_is_told_the_one_that_holds_all_colours_and_that_one_nothing(
    tmp_path, monkeypatch, space, remedy
):
    source, _ = small_uplift(tmp_path)
    # A map that leaves every space, as colours of noise may: green and blue far below nothing.
    monkeypatch.setattr(
        "envcal.export.opened.Band.rgb", lambda self, _opened: np.full((*self.scale.shape, 3), [1, -9, -9])
    )
    (text,) = export_rgb(source, tmp_path / "rgb", space=space).warnings
    assert f"outside of {space}" in text and ("--space ACES2065-1" in text) is remedy and "such as ACEScg" not in text


@pytest.mark.parametrize("work", [export_rgb, export_pbrt])
def test_half_floats_are_mentioned_only_where_there_are_half_floats(made, tmp_path, work):
    for half in (False, True):
        work(made[0], tmp_path / str(half), half=half)
        assert ("half float" in (tmp_path / str(half) / "README.md").read_text(encoding="utf-8")) is half


def test_the_readme_of_the_rgb_map_says_where_it_looks_and_what_1_is(made, tmp_path):
    export_rgb(made[0], tmp_path)
    text = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert "straight ahead (−Z)" in text and "at the right hand (+X)" in text and "No unit such as cd/m²" in text


@pytest.mark.parametrize("space", RGB_SPACES)
def test_the_readme_names_nukes_input_transform_of_the_space_that_was_written(made, tmp_path, space):
    export_rgb(made[0], tmp_path, space=space)
    (line,) = re.findall(r"\*\*Nuke\.\*\* .*", (tmp_path / "README.md").read_text(encoding="utf-8"))
    # The configurations call the spaces nearly as they are called here.
    named = {"sRGB": "Utility - Linear - sRGB", "ITU-R BT.2020": "Rec.2020"}.get(space, space)
    assert f"{named}`" in line and "no further conversion" in line
    others = {"ACEScg", "ACES2065-1", "P3-D65", "Rec.2020", "Linear - sRGB"} - {named}
    if space != "Adobe Wide Gamut RGB":  # which newer configurations do not have: ACEScg is advised
        assert not any(other in line for other in others if other not in named)


# ---- pbrt ----


def test_pbrt_gets_a_square_map_a_light_in_a_space_that_it_knows(made, tmp_path):
    outcome = export_pbrt(made[0], tmp_path)
    text = (tmp_path / "environment.pbrt").read_text(encoding="utf-8")
    files = re.findall(r'"string filename" \[ "(.*?)" \]', text)
    assert files == ["light0.exr", "light1.exr"]
    for name in files:
        header, image = exr.read_rgb(tmp_path / name)
        assert header.size[0] == header.size[1] == outcome.figures["side"] and not header.latlong
        assert image.min() >= 0 and np.isfinite(image).all()
        # pbrt looks its four spaces up by their chromaticities, each within a thousandth.
        np.testing.assert_allclose(
            header.chromaticities, (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290), rtol=1e-3
        )
    assert abs(outcome.figures["energy_ratio"] - 1) < 0.02
    assert f"{outcome.figures['relight_delta_e']['mean']:.3f}" in (tmp_path / "README.md").read_text(encoding="utf-8")
    assert "pbrt-v4 makes its own spectra" in outcome.warnings[0]


def place_in_pbrt(d):
    """The square's (u, v) of a direction by the formulas of pbrt-v4 (EqualAreaSphereToSquare), one direction at a time."""
    x, y, z = (abs(float(v)) for v in d)
    radius = np.sqrt(max(1.0 - z, 0.0))
    small, large = min(x, y), max(x, y)
    turn = np.arctan(small / large) * 2 / np.pi if large > 0 else 0.0
    turn = 1.0 - turn if x < y else turn
    v, u = turn * radius, radius - turn * radius
    if d[2] < 0:
        u, v = 1.0 - v, 1.0 - u
    return (np.copysign(u, d[0]) + 1) / 2, (np.copysign(v, d[1]) + 1) / 2


#: Up, whether the scene is mirrored by Scale -1 1 1, where the camera has to look to see the middle of the map.
SCENES = [
    ("+z", False, (-1, 0, 0)),
    ("+y", False, (0, 0, 1)),
    ("+y", True, (0, 0, -1)),
    ("+z", True, (-1, 0, 0)),
]


@pytest.mark.parametrize(("up", "mirrored", "ahead"), SCENES)
def test_a_camera_of_pbrt_sees_the_map_upright_and_not_mirrored_by_the_transform_for_its_scene(
    made, tmp_path, up, mirrored, ahead
):
    """Red right of the middle, blue left of it, green above it; looked up as pbrt does, where its camera has these places."""
    export_pbrt(made[0], tmp_path)
    text = (tmp_path / "environment.pbrt").read_text(encoding="utf-8")
    kind = "mirrored" if mirrored else "plain"
    found = re.findall(rf"    # ConcatTransform \[ (.*?) \]  # up \{up}, {kind}", text)
    if (up, mirrored) == ("+z", False):
        assert not found and not re.search(r"^ *ConcatTransform", text, re.MULTILINE)  # as written
        matrix = np.eye(3)
    else:
        # pbrt's files hold a matrix column by column.
        matrix = np.array([float(v) for v in found[0].split()]).reshape(4, 4).T[:3, :3]
    assert np.linalg.det(matrix) == (-1 if mirrored else 1)
    height, width = 32, 64
    latlong = np.zeros((height, width, 3), np.float32)
    latlong[:, 46:51, 0] = latlong[:, 13:18, 2] = latlong[:2, :, 1] = 1  # u = 3/4, u = 1/4, the zenith
    latlong[14:18, 30:34] = 1  # the middle
    square = resampled(latlong, np.zeros((height, width), np.uint8), 0, side_of(width))
    zenith = np.array({"+y": (0, 1, 0), "+z": (0, 0, 1)}[up], float)
    # LookAt takes up × forward for the right of the picture; the scale before it turns that into the left.
    right = np.cross(zenith, ahead) * (-1 if mirrored else 1)

    def seen(direction):
        u, v = place_in_pbrt(np.linalg.solve(matrix, direction))
        return tuple(
            np.round(square[min(int(v * len(square)), len(square) - 1), min(int(u * len(square)), len(square) - 1)], 1)
        )

    assert seen(np.array(ahead)) == (1, 1, 1)
    assert seen(right) == (1, 0, 0) and seen(-right) == (0, 0, 1)
    assert seen(zenith)[1] > 0.9 and seen(-zenith)[1] == 0


def test_every_page_on_pbrts_up_says_when_a_scene_is_mirrored(made, tmp_path):
    export_pbrt(made[0], tmp_path)
    pages = [tmp_path / "environment.pbrt", tmp_path / "README.md", Path(__file__).parents[2] / "docs" / "export.md"]
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert "`Scale -1 1 1`" in text and "mirrored" in text and "plain" in text


def test_the_spectra_beside_the_maps_are_the_lamps(made, tmp_path):
    export_pbrt(made[0], tmp_path)
    spectrum = np.loadtxt(tmp_path / "light1.spd")
    about = open_uplift(made[0]).about
    np.testing.assert_allclose(spectrum[:, 0], about.wavelengths_nm)
    np.testing.assert_allclose(spectrum[:, 1], about.clusters[1].emission, rtol=1e-8)


def test_nothing_is_lost_of_a_map_that_was_uplifted_as_pbrt_does_it(tmp_path):
    """The scaled method is pbrt's own formula, so its spectra come back from RGB; under FL11 they do not."""
    scaled, _ = small_uplift(tmp_path / "a", method="scaled")
    lamps, _ = small_uplift(tmp_path / "b", lamps=("FL11",))
    assert loss(open_uplift(scaled), space=SPACE)["mean"] < 0.01
    assert loss(open_uplift(lamps), space=SPACE)["mean"] > 1.0


def test_the_sample_of_pixels_is_even_over_the_sphere(made):
    opened = open_uplift(made[0])
    drawn = sample(opened, count=4000)
    height = opened.size[0]
    sines = np.sin(np.pi * (np.arange(height) + 0.5) / height)
    lit = made[1].max(axis=-1) > 0
    light = made[1].astype(float) @ opened.space.luminance_weights
    weight = np.where(lit, sines[:, None], 0.0)
    expected = (light * weight).sum() / weight.sum()
    deviation = np.sqrt(((light - expected) ** 2 * weight).sum() / weight.sum() / 4000)
    assert abs(drawn.light.mean() - expected) < 5 * deviation


# ---- Mitsuba without a plugin ----


def test_the_film_under_d65_measures_what_it_would_under_the_lamp(made):
    """responses · D65 = observer · lamp, and its sum over 1 nm is the lamp's XYZ."""
    opened = open_uplift(made[0])
    fine = np.arange(360.0, 831.0)
    for k, cluster in enumerate(opened.about.clusters):
        measured = responses(opened, k) * d65_of_mitsuba()
        lamp = np.interp(fine, opened.wavelengths_nm, cluster.emission, left=0, right=0)
        seen = observer(360, 830, 1).cmfs.T
        np.testing.assert_allclose(measured, seen * lamp, atol=1e-15)


def test_every_middle_row_of_the_native_map_is_ours_and_dark_texels_have_a_neighbours_shape(made):
    opened = open_uplift(made[0])
    (band,) = bands(opened)
    scale = np.where(band.cluster == 1, band.scale, np.float32(0))
    nodes = native_nodes(opened, band.coefficients, scale, 1)
    assert nodes.shape == (17, 16, 4)
    lit = scale > 0
    np.testing.assert_array_equal(nodes[1::2, :, 3], scale)
    np.testing.assert_array_equal(nodes[1::2, :, :3][lit], band.coefficients[lit])
    # Columns 8 … 15 are of light 1. Column 7 borders on 8, column 0, round the seam, on 15.
    np.testing.assert_array_equal(nodes[1::2, 7, :3], band.coefficients[:, 8])
    np.testing.assert_array_equal(nodes[1::2, 0, :3], band.coefficients[:, 15])


def test_between_two_rows_stands_their_mean_colour(made):
    opened = open_uplift(made[0])
    (band,) = bands(opened)
    scale = np.where(band.cluster == 1, band.scale, np.float32(0))
    nodes = native_nodes(opened, band.coefficients, scale, 1)
    emissions = opened.about.emissions()

    def colours(rows):
        index = np.ones(rows.shape[:2], np.uint32)
        spectra = spectra_of(rows[..., :3], rows[..., 3], index, emissions, EYES.wavelengths_nm, observer=EYES)
        return spectra @ EYES.cmfs * EYES.step_nm

    middle = colours(nodes[1::2])
    np.testing.assert_allclose(colours(nodes[2:-1:2]), (middle[:-1] + middle[1:]) / 2, rtol=STORED, atol=1e-5)


def test_the_folder_for_passes_is_complete(made, tmp_path):
    outcome = export_basis(made[0], tmp_path)
    lights = json.loads((tmp_path / "lights.json").read_text(encoding="utf-8"))
    assert [light["name"] for light in lights] == ["light0", "light1"] and outcome.figures["rows"] == 17
    for light in lights:
        header = exr.header(tmp_path / f"{light['name']}.exr")
        assert set(header.channels) == {"c0", "c1", "c2", "scale"} and header.size == (17, 16)
        assert all(np.loadtxt(tmp_path / f"{axis}_{light['name']}.spd").shape == (471, 2) for axis in "XYZ")
    compile((tmp_path / "passes.py").read_text(encoding="utf-8"), "passes.py", "exec")
    assert "`passes.py` fills in `$basis`" in (tmp_path / "README.md").read_text(encoding="utf-8")


def test_the_pages_of_pbrt_and_basis_say_that_undeclared_lights_are_guesses(made, tmp_path, monkeypatch):
    told = re.compile(r"kind of no light of this map is known\*\*.*declare\s+them", re.DOTALL)
    for known in (True, False):
        if not known:
            monkeypatch.setattr("envcal.export.opened.undeclared", lambda _about: ["declare"])
        for work in (export_pbrt, export_basis):
            folder = tmp_path / f"{work.__name__}-{known}"
            work(made[0], folder)
            text = (folder / "README.md").read_text(encoding="utf-8")
            assert bool(told.search(text)) is not known
    text = (tmp_path / "export_pbrt-False" / "README.md").read_text(encoding="utf-8")
    # Before the table of ΔE2000, which is what it is about.
    assert text.index("both sides of the comparison below are guesses") < text.index("| ΔE2000 | |")


def test_the_readme_of_pbrt_says_how_bright_a_lamp_by_hand_is(made, tmp_path):
    figures = export_pbrt(made[0], tmp_path).figures
    text = (tmp_path / "README.md").read_text(encoding="utf-8")
    luminance = made[1].astype(float) @ rgb_space(SPACE, observer=EYES).luminance_weights
    for k, light in enumerate(figures["lights"]):
        assert light["brightest"] == pytest.approx(luminance[:, 8 * k : 8 * k + 8].max(), rel=STORED)
        assert f"| {light['brightest']:.4g} |" in text
    weights = re.search(r"([\d.]+) R \+ ([\d.]+) G \+ ([\d.]+) B", text).groups()
    np.testing.assert_allclose(
        [float(w) for w in weights], rgb_space(SPACE, observer=EYES).luminance_weights, atol=1e-4
    )
    assert '"float scale" [ Y ]' in text


@pytest.fixture
def passes(made, tmp_path):
    """The script of an exported folder, in Mitsuba's scalar variant."""
    mi = pytest.importorskip("mitsuba")
    export_basis(made[0], tmp_path)
    mi.set_variant("scalar_spectral")
    return runpy.run_path(str(tmp_path / "passes.py"))


def test_the_example_scene_takes_the_lights(passes, tmp_path):
    assert (tmp_path / "example.xml").read_text(encoding="utf-8") in (tmp_path / "README.md").read_text(
        encoding="utf-8"
    )
    for name in ("light0", "light1"):
        scene = passes["load"](tmp_path / "example.xml", name, {})
        passes["put_light"](scene, name)


@pytest.mark.parametrize(
    "used",
    ["", "<!-- $basis -->", '<emitter type="envmap"><string name="filename" value="$basis/blank.exr"/></emitter>'],
)
def test_a_scene_that_does_not_ask_for_the_lights_is_told_what_to_write(passes, tmp_path, used):
    scene = tmp_path / "mine.xml"
    scene.write_text(f'<scene version="3.0.0"><integrator type="path"/>{used}</scene>', encoding="utf-8")
    with pytest.raises(SystemExit, match=r"mine\.xml: does not use both \$basis and \$light.*example\.xml"):
        passes["render"](scene, 4)


def test_other_mistakes_of_a_scene_stay_mitsubas(passes, tmp_path):
    (tmp_path / "mine.xml").write_text("<scene", encoding="utf-8")
    with pytest.raises(RuntimeError):
        passes["render"](tmp_path / "mine.xml", 4)


def test_passes_want_a_spectral_variant(made, tmp_path):
    pytest.importorskip("mitsuba")
    export_basis(made[0], tmp_path)
    command = [sys.executable, str(tmp_path / "passes.py"), "example.xml", "-o", "out.exr", "--variant", "scalar_rgb"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 2 and "expected a spectral one of this Mitsuba: scalar_spectral" in done.stderr


@pytest.mark.parametrize(("types", "hinted"), [(("smooth", "smooth"), True), (("smooth", "led"), False), ((), False)])
def test_lights_are_asked_for_only_if_the_kind_of_none_is_known(made, types, hinted):
    about = open_uplift(made[0]).about
    lamps = [about.clusters[0].model_copy(update={"type": kind}) for kind in (*types, "fallback")]
    (hint,) = undeclared(about.model_copy(update={"clusters": lamps})) or ("",)
    assert ("--lights lights.yaml" in hint) is hinted
    assert undeclared(about.model_copy(update={"clusters": lamps, "method": "scaled"})) == []


# ---- the command ----


def test_the_command_writes_and_prints_figures(made, tmp_path):
    done = CliRunner().invoke(main, ["export", str(made[0]), "--to", "rgb", "-o", str(tmp_path), "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["figures"]["space"] == "ACEScg"
    assert (tmp_path / "environment_acescg.exr").is_file() and (tmp_path / "README.md").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--to", "pbrt", "--space", "sRGB"], "--space belongs to --to rgb"),
        (["--to", "basis", "--half"], "--half belongs to colours"),
        (["--to", "renderman"], "Invalid value for '--to'"),
    ],
)
def test_options_that_do_not_belong_together_are_refused(made, tmp_path, arguments, message):
    done = CliRunner().invoke(main, ["export", str(made[0]), "-o", str(tmp_path), *arguments])
    assert done.exit_code == 2 and message in done.output


@pytest.mark.parametrize("work", [export_rgb, export_pbrt, export_basis])
def test_a_file_that_is_no_uplift_is_refused(work, tmp_path):
    exr.write(tmp_path / "map.exr", dict.fromkeys("RGB", np.ones((4, 8), np.float32)), attributes={})
    with pytest.raises(EnvcalError, match="is not an uplift file"):
        work(tmp_path / "map.exr", tmp_path / "out")


@pytest.mark.parametrize("work", [export_rgb, export_pbrt, export_basis, make_scene])
def test_a_map_without_light_is_refused_and_no_lights_are_asked_for(tmp_path, work):
    source, _ = small_uplift(tmp_path, black=True)
    with pytest.raises(EnvcalError, match="there is no light in it") as error:
        work(source, tmp_path / "out")
    assert "declare" not in str(error.value) and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("work", "name"),
    [(export_rgb, "environment_acescg.exr"), (export_pbrt, "light1.exr"), (export_basis, "light0.exr")],
)
def test_an_export_never_falls_on_the_uplift_file(made, tmp_path, work, name):
    (tmp_path / "there").mkdir()
    source = tmp_path / "there" / name
    source.write_bytes(made[0].read_bytes())
    with pytest.raises(EnvcalError, match="is the input, and would overwrite it"):
        work(source, tmp_path / "there" / ".." / "there")
    assert source.read_bytes() == made[0].read_bytes() and len(list(source.parent.iterdir())) == 1


@pytest.mark.parametrize("work", [export_rgb, export_pbrt, export_basis, make_scene])
@pytest.mark.parametrize("below", ["", "folder"])
def test_an_output_that_is_a_file_is_refused_before_anything_is_done(made, tmp_path, work, below):
    (tmp_path / "out.exr").write_bytes(b"mine")
    with pytest.raises(
        EnvcalError, match=r"the output has to be a folder, and .*out\.exr is a file\. Give another name"
    ):
        work(made[0], tmp_path / "out.exr" / below)
    assert (tmp_path / "out.exr").read_bytes() == b"mine"
