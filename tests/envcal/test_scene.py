"""The scene around a map: what is written, what is compared, and that it can be done without Mitsuba."""

import json
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from click.testing import CliRunner

from envcal import exr
from envcal.cli import main
from envcal.errors import EnvcalError
from envcal.reflectances import colour_checker
from envcal.scene import description, pictures
from envcal.scene.make import make_scene, native_rows
from envcal.scene.render import Rendered, _even_count, without_fireflies
from tests.envcal.small_uplift import small_uplift


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return small_uplift(tmp_path_factory.mktemp("uplift"))[0]


def scene_tree():
    return ET.fromstring(description.scene_xml(width=64, height=36, spp=16))  # noqa: S314 - our own text


# ---- the files ----


def test_the_spheres_have_the_measured_reflectances_in_the_order_of_the_chart():
    shapes = [shape for shape in scene_tree().iter("shape") if (shape.get("id") or "").startswith("patch_")]
    assert len(shapes) == 24
    grid = np.arange(360.0, 831.0, 10.0)
    for shape, reflectance in zip(shapes, colour_checker(grid).values(), strict=True):
        pairs = [pair.split(":") for pair in shape.find("bsdf/spectrum").get("value").split(",")]
        np.testing.assert_array_equal([float(w) for w, _ in pairs], grid)
        np.testing.assert_allclose([float(v) for _, v in pairs], reflectance, atol=5e-5)
    centres = np.array([[float(shape.find("point").get(axis)) for axis in "xyz"] for shape in shapes]).reshape(4, 6, 3)
    assert (np.diff(centres[..., 0], axis=1) > 0).all() and (np.diff(centres[..., 1], axis=0) < 0).all()


def test_nothing_in_the_scene_touches_anything_else():
    balls = [
        (np.array([float(shape.find("point").get(axis)) for axis in "xyz"]), float(shape.find("float").get("value")))
        for shape in scene_tree().iter("shape")
        if shape.get("type") == "sphere"
    ]
    assert len(balls) == 26
    for k, (centre, radius) in enumerate(balls):
        assert centre[1] >= radius - 1e-9
        for other, reach in balls[k + 1 :]:
            assert np.linalg.norm(centre - other) > radius + reach


def test_the_scene_is_written_with_relative_names_and_without_mitsuba(made, tmp_path):
    folder = made.parent / "scene"
    outcome = make_scene(made, folder, render=False)
    assert outcome.figures == {"rendered": False} and outcome.warnings == []
    assert f"finds {made.resolve()} by the name ../uplift.exr: move both together" in outcome.summary
    assert 'value="../uplift.exr"' in (folder / "uplift.xml").read_text(encoding="utf-8")
    assert 'value="map_rgb.exr"' in (folder / "scaled.xml").read_text(encoding="utf-8")
    for name in ("scene.xml", "uplift.xml", "scaled.xml"):
        ET.parse(folder / name)  # noqa: S314 - our own file
    compile((folder / "render.py").read_text(encoding="utf-8"), "render.py", "exec")
    header, image = exr.read_rgb(folder / "map_rgb.exr")
    assert header.size == (17, 16) and image.min() >= 0


def test_without_mitsuba_the_scene_is_written_and_the_warning_says_what_to_install(made, tmp_path, monkeypatch):
    def missing(_asked):
        raise EnvcalError("Mitsuba 3 cannot be imported. Install it with `pip install 'envcal[mitsuba]'`.")

    monkeypatch.setattr("envcal.scene.render.set_variant", missing)
    outcome = make_scene(made, tmp_path)
    assert (tmp_path / "scene.xml").is_file() and outcome.figures == {"rendered": False}
    assert "pip install" in outcome.warnings[0]
    with pytest.raises(EnvcalError, match="pip install"):
        make_scene(made, tmp_path / "named", variant="llvm_ad_spectral")
    assert not (tmp_path / "named").exists()


def test_a_variant_without_spectra_is_refused(made, tmp_path, monkeypatch):
    monkeypatch.setattr("envcal.scene.render.set_variant", lambda asked: (asked, None))
    with pytest.raises(EnvcalError, match="has no spectra"):
        make_scene(made, tmp_path / "scene", variant="llvm_ad_rgb")
    assert not (tmp_path / "scene").exists()


def test_a_render_never_falls_on_the_uplift_file(tmp_path):
    source, _ = small_uplift(tmp_path)
    before = source.read_bytes()
    with pytest.raises(EnvcalError, match=r"the output .*uplift\.exr is the input"):
        make_scene(source, tmp_path, render=False)
    assert source.read_bytes() == before and not (tmp_path / "scene.xml").exists()


def test_the_command_refuses_a_variant_that_there_is_not_before_it_writes(made, tmp_path):
    pytest.importorskip("mitsuba")
    done = CliRunner().invoke(main, ["mitsuba", str(made), "-o", str(tmp_path / "scene"), "--variant", "llvm_spectral"])
    assert done.exit_code == 1 and "Mitsuba has no variant llvm_spectral" in done.output
    assert not (tmp_path / "scene").exists()


def test_native_rows_interpolate_to_what_middle_rows_do():
    """Rows from pole to pole, read as Mitsuba reads them, are the map read by middles of bands, clamped at the poles."""
    middle = np.random.default_rng(1).uniform(0, 1, (6, 4, 3)).astype(np.float32)
    rows = native_rows(middle)
    v = np.linspace(0, 1, 101)
    ours, theirs = np.clip(v * 6 - 0.5, 0, 5), v * (len(rows) - 1)
    for channel in range(3):
        for column in range(4):
            expected = np.interp(ours, np.arange(6), middle[:, column, channel])
            found = np.interp(theirs, np.arange(13), rows[:, column, channel])
            np.testing.assert_allclose(found, expected, atol=1e-6)


def test_a_wide_map_is_reduced_for_the_comparison_and_keeps_its_light(made, tmp_path, monkeypatch):
    monkeypatch.setattr("envcal.scene.make._WIDEST", 8)
    make_scene(made, tmp_path, render=False)
    header, small = exr.read_rgb(tmp_path / "map_rgb.exr")
    assert header.size == (9, 8)
    monkeypatch.setattr("envcal.scene.make._WIDEST", 16)
    make_scene(made, tmp_path, render=False)
    _, large = exr.read_rgb(tmp_path / "map_rgb.exr")
    np.testing.assert_allclose(small[1::2].mean(axis=(0, 1)), large[1::2].mean(axis=(0, 1)), rtol=1e-5)


# ---- what is made of the renders ----


def test_a_firefly_counts_as_four_times_the_median_and_the_rest_is_left_alone():
    passes = np.random.default_rng(0).uniform(0.9, 1.1, (8, 4, 5, 3)).astype(np.float32)
    passes[3, 1, 2] = 1000.0
    tamed = without_fireflies(passes)
    assert 3.5 < tamed[3, 1, 2].max() < 4.5
    passes[3, 1, 2] = tamed[3, 1, 2] = 0.0
    np.testing.assert_array_equal(tamed, passes)


def test_a_pass_has_as_many_samples_as_the_sampler_takes():
    for samples in range(1, 200):
        count = _even_count(samples)
        k = int(count**0.5)
        assert count >= samples and count in (k * k, k * (k + 1)) and count < samples + 2 * k + 1


def rendered(image, noise, seed):
    rng = np.random.default_rng(seed)
    even, odd = (image + rng.normal(0, noise, image.shape) for _ in range(2))
    return Rendered(*(part.astype(np.float32) for part in ((even + odd) / 2, even, odd)))


def test_pictures_of_the_same_light_differ_by_their_noise_alone():
    image = np.full((40, 60, 3), 0.4)
    found = pictures.compare(rendered(image, 0.01, 1), rendered(image, 0.01, 2), gain=1.0)
    assert 0.1 < found.mean < 1 and abs(found.noise / found.mean - 1) < 0.1
    quiet = pictures.compare(rendered(image, 0, 1), rendered(image, 0, 2), gain=1.0)
    assert quiet.mean == quiet.noise == 0


def test_a_difference_stands_out_from_the_noise():
    image = np.full((40, 60, 3), 0.4)
    found = pictures.compare(rendered(image, 0.002, 1), rendered(image * [1.2, 1, 1], 0.002, 2), gain=1.0)
    assert found.mean > 5 and found.noise < 0.1 * found.mean


def test_the_map_of_differences_has_the_pictures_width_and_a_legend_below():
    delta_e = np.zeros((90, 160))
    delta_e[:, 80:] = 4.0
    difference = pictures.Difference(delta_e, 2.0, 4.0, 4.0, 0.1)
    assert pictures.scale_end(difference) == 5.0
    shown = pictures.difference_picture(difference)
    assert shown.shape[1] == 160 and shown.shape[0] > 90
    assert shown[:90, :80].max() < 10 < shown[:90, 80:].max()
    assert shown[90:].std() > 5


@pytest.mark.parametrize("width", [64, 128, 200, 512, 960])
def test_the_caption_of_no_picture_is_cut(width):
    """Nothing is drawn in the outermost columns beside the legend, nor in its last rows."""
    difference = pictures.Difference(np.full((30, width), 4.0), 12.34, 23.45, 99.0, 0.22, 0.123, 11.11)
    legend = pictures.difference_picture(difference)[30:].astype(int)
    ground = legend[0, 0]
    assert (legend[:, :3] == ground).all() and (legend[:, -3:] == ground).all() and (legend[-3:] == ground).all()
    assert (legend != ground).any(axis=(1, 2)).sum() > 30


def test_background_that_srgb_cannot_show_is_counted_apart_and_things_are_not():
    image = np.full((40, 60, 3), 0.4)
    image[:, :20] = [-0.1, 0.5, 0.2]
    image[:5] = [-0.1, 0.5, 0.2]
    background = np.zeros((40, 60), bool)
    background[:, :30] = True
    first, second = rendered(image, 0.0, 1), rendered(np.maximum(image, 0), 0.0, 2)
    found = pictures.compare(replace(first, background=background), second, gain=1.0)
    # The columns of the background and, mixed with them by the mean over 3×3, one more and two rows more.
    assert pictures.outside_srgb(replace(first, background=background))[:, :20].all()
    assert not pictures.outside_srgb(replace(first, background=background))[10:, 25:].any()
    assert not pictures.outside_srgb(replace(first, background=background))[:, 30:].any()
    assert found.outside_mean > 2 and 20 / 60 <= found.outside <= 24 / 60 + 0.05
    assert 0 < found.mean < 0.5 * pictures.compare(first, second, gain=1.0).mean
    assert found.largest > 2  # the things in the upper rows have such a colour, too, and are counted


def test_what_is_counted_apart_is_hatched_in_grey_and_has_no_say_in_the_scale():
    delta_e = np.full((60, 200), 1.5)
    delta_e[:20] = 19.0
    apart = delta_e > 10
    shown = pictures.difference_picture(pictures.Difference(delta_e, 1.5, 1.5, 1.5, 0.1, 1 / 3, 19.0, apart))[:60]
    above, below = shown[:20].astype(int), shown[20:60].astype(int)
    assert (np.ptp(above, axis=2) == 0).all() and len(np.unique(above)) == 2  # two greys
    assert (np.ptp(below, axis=2) > 50).all()  # colours of the scale, which ends at 2 and not at 20
    end = pictures.scale_end(pictures.Difference(delta_e, 1.5, 1.5, 1.5, 0.1, 1 / 3, 19.0, apart))
    assert end == 2.0 and "hatched" in " ".join(
        pictures.caption(pictures.Difference(delta_e, 1, 1, 1, 0, 1 / 3, 19.0, apart))
    )


def test_a_picture_of_such_background_alone_is_still_measured():
    image = np.full((8, 8, 3), [-0.1, 0.5, 0.2])
    first = replace(rendered(image, 0.0, 1), background=np.ones((8, 8), bool))
    found = pictures.compare(first, rendered(np.maximum(image, 0), 0.0, 2), gain=1.0)
    assert found.outside == 1 and found.mean == found.outside_mean > 2
    assert pictures.scale_end(found) >= found.mean  # all of it says how far the scale goes, as none else can


# ---- the command ----


@pytest.mark.parametrize("size", ["960", "0x10", "axb", "9000x540"])
def test_a_size_that_is_none_is_refused(made, tmp_path, size):
    done = CliRunner().invoke(main, ["mitsuba", str(made), "-o", str(tmp_path), "--size", size])
    assert done.exit_code == 2 and "WIDTHxHEIGHT" in done.output


def test_the_command_writes_the_scene(made, tmp_path):
    done = CliRunner().invoke(
        main, ["mitsuba", str(made), "-o", str(tmp_path), "--no-render", "--size", "64x36", "--json"]
    )
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["figures"] == {"rendered": False}
    assert 'name="width" value="64"' in (tmp_path / "scene.xml").read_text(encoding="utf-8")


# ---- with Mitsuba ----


@pytest.mark.slow
def test_the_scene_is_rendered_under_both_lightings(made, tmp_path):
    pytest.importorskip("mitsuba")
    from envcal.mitsuba import llvm

    if llvm.best(llvm.libraries()) is None:
        pytest.skip("no LLVM that Mitsuba can use")
    done = CliRunner().invoke(
        main, ["mitsuba", str(made), "-o", str(tmp_path), "--size", "48x27", "--spp", "64", "--json"]
    )
    assert done.exit_code == 0, done.output
    figures = json.loads(done.stdout)["figures"]
    assert json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))["variant"] == "llvm_ad_spectral"
    pair = [exr.read_rgb(tmp_path / f"{name}.exr")[1] for name in ("uplift", "scaled")]
    # The background is the map itself and has the same colours under both; the chart's spheres have not, under FL11.
    np.testing.assert_allclose(pair[0][:4].mean(axis=(0, 1)), pair[1][:4].mean(axis=(0, 1)), rtol=0.05)
    assert figures["difference"]["mean"] > figures["difference"]["noise"]
    assert all((tmp_path / f"{name}.png").stat().st_size > 1000 for name in ("uplift", "scaled", "difference"))


#: Renders of each kind, whose scatter tells the standard error: with ten degrees of freedom, 6 of it is what the largest of
#: 72 figures reaches once in a hundred runs. On top, 2e-3: single precision and the 1 nm table of the film's responses.
RUNS, STANDARD_ERRORS, TABLES = 6, 6.0, 2e-3


@pytest.mark.slow
def test_passes_without_the_plugin_give_the_picture_that_the_plugin_gives(tmp_path):
    """A scene of coloured spheres in a map of two lamps, smooth so that both interpolate alike."""
    pytest.importorskip("mitsuba")
    import runpy

    from envcal.mitsuba import llvm, set_variant

    if llvm.best(llvm.libraries()) is None:
        pytest.skip("no LLVM that Mitsuba can use")
    import mitsuba as mi

    from envcal.export.basis import export_basis

    source, _ = small_uplift(tmp_path, height=64, smooth=True)
    export_basis(source, tmp_path / "basis")
    set_variant("llvm_ad_spectral")
    size = '<integer name="width" value="48"/><integer name="height" value="32"/><rfilter type="box"/>'
    spectra = "".join(f'<spectrum name="{axis}" filename="$basis/{axis}_$light.spd"/>' for axis in "XYZ")
    (tmp_path / "plugin.xml").write_text(
        _balls(
            '<emitter type="envcal"><string name="filename" value="uplift.exr"/></emitter>',
            f'<film type="hdrfilm">{size}</film>',
        )
    )
    (tmp_path / "native.xml").write_text(
        _balls(
            '<emitter type="envmap"><string name="filename" value="$basis/blank.exr"/></emitter>',
            f'<film type="specfilm">{size}{spectra}</film>',
        )
    )
    script = runpy.run_path(str(tmp_path / "basis" / "passes.py"))
    scene = mi.load_file(str(tmp_path / "plugin.xml"))
    ours = np.stack([np.asarray(mi.render(scene, spp=256, seed=k)) for k in range(RUNS)])
    theirs = np.stack([script["render"](tmp_path / "native.xml", 256, 256, seed=100 + k) for k in range(RUNS)])
    blocks = [part.reshape(RUNS, 4, 8, 6, 8, 3).mean(axis=(2, 4)) for part in (ours, theirs)]
    error = np.sqrt(sum(part.var(axis=0, ddof=1) for part in blocks) / RUNS)
    means = [part.mean(axis=0) for part in blocks]
    assert (np.abs(means[0] - means[1]) < STANDARD_ERRORS * error + TABLES * means[0]).all()
    np.testing.assert_allclose(theirs.mean(axis=(0, 1, 2)), ours.mean(axis=(0, 1, 2)), rtol=5e-3)


def _balls(emitter, film):
    def ball(x, values):
        return (
            f'<shape type="sphere"><point name="center" x="{x}" y="1" z="0"/><float name="radius" value="1"/>'
            f'<bsdf type="diffuse"><spectrum name="reflectance" value="{values}"/></bsdf></shape>'
        )

    return (
        '<scene version="3.0.0"><default name="basis" value="."/><default name="light" value="light0"/>'
        '<integrator type="path"><integer name="max_depth" value="5"/></integrator>'
        '<sensor type="perspective"><float name="fov" value="40"/><transform name="to_world">'
        f'<lookat origin="0,2,6" target="0,0.8,0" up="0,1,0"/></transform>{film}<sampler type="independent"/></sensor>{emitter}'
        '<shape type="disk"><transform name="to_world"><scale value="5"/><rotate x="1" angle="-90"/></transform>'
        '<bsdf type="twosided"><bsdf type="diffuse"><spectrum name="reflectance" value="0.5"/></bsdf></bsdf></shape>'
        + ball(-1.2, "360:0.1, 400:0.1, 500:0.2, 600:0.7, 830:0.9")
        + ball(1.2, "360:0.7, 480:0.6, 550:0.3, 650:0.1, 830:0.1")
        + "</scene>"
    )
