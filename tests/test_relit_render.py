"""The rendered relight benchmark: what it needs, and that its paths and its truth are what they are said to be."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import __main__ as program
from benchmarks import paths, relit_render
from envcal.errors import EnvcalError
from uplift.spectrum import illuminant


def test_without_the_folder_of_rooms_it_says_so_and_stops(capsys, monkeypatch):
    monkeypatch.delenv("ENVCAL_DATA", raising=False)
    assert program.main(["relit_render"]) == 0
    assert "skipped: the environment variable ENVCAL_DATA names no folder" in capsys.readouterr().out


def test_a_lamp_is_found_by_its_cie_name_or_in_the_measured_table(tmp_path):
    grid = range(380, 781)
    rows = ["name," + ",".join(map(str, grid)), "CIE S025 PhLED_3," + ",".join(str(w - 370) for w in grid)]
    (tmp_path / "led19_measured.csv").write_text("\n".join(rows), encoding="utf-8")
    eyes = relit_render.EYES
    np.testing.assert_array_equal(relit_render.lamp("FL2", tmp_path, eyes), illuminant("FL2", eyes))
    found = relit_render.lamp("CIE S025 PhLED_3", tmp_path, eyes)
    np.testing.assert_allclose(found / found[0], (eyes.wavelengths_nm - 370) / 10)


def test_the_transport_is_that_of_all_lamps_interpolated_to_our_grid(tmp_path):
    (tmp_path / "truth").mkdir()
    transport = np.random.default_rng(1).random((3, 2, 4, 41)).astype(np.float16)
    np.savez(tmp_path / "truth" / "room0.npz", transport=transport, wavelengths=np.arange(380.0, 781.0, 10.0))
    found = relit_render.transport_of(tmp_path, "room0")
    total = transport.astype(float).sum(axis=0)
    np.testing.assert_allclose(found[..., ::2], total, rtol=1e-5)
    np.testing.assert_allclose(found[..., 1::2], (total[..., :-1] + total[..., 1:]) / 2, rtol=1e-5)


def test_ratios_are_to_the_scaled_uplift_and_foreign_lamps_stand_apart(capsys):
    mean = {"declared": 0.1, "measured": 0.02, "scaled": 0.4}
    rows = [relit_render.Row("room0", lamp, "fluorescent", 1, mean, mean, mean) for lamp in ("FL2", "FL11")]
    assert [row.known for row in rows] == [True, False]
    assert rows[0].ratio("declared") == pytest.approx(0.25) and rows[0].ratio("measured") == pytest.approx(0.05)
    relit_render.summary(rows)
    shown = capsys.readouterr().out
    assert "families' tables, fluorescent: declared : scaled = 0.250 (0.250 … 0.250)" in shown
    assert "foreign lamps, fluorescent: declared : scaled = 0.250" in shown


def test_every_lamp_of_the_families_tables_is_measured():
    from uplift.illuminants import fluorescent, led

    assert set(relit_render.KNOWN) == {*fluorescent.NODES, *led.MEASURED}


def test_a_picture_is_the_sum_of_weight_radiance_and_reflectances_over_its_paths():
    rng = np.random.default_rng(2)
    size, bands, many = (2, 3), 4, 500
    lanes = np.sort(rng.integers(0, size[0] * size[1] * paths.GROUPS, many))
    texel = rng.integers(0, 32, many).astype(np.int32)
    weight = rng.random(many).astype(np.float32)
    patch = rng.integers(0, paths.PATCHES + 1, (many, paths.MAX_DEPTH - 1)).astype(np.uint8)
    starts = np.searchsorted(lanes, np.arange(size[0] * size[1] * paths.GROUPS + 1))
    radiance, reflectances = rng.random((4, 8, bands)).astype(np.float32), rng.random((paths.PATCHES, bands))
    expected = np.zeros((paths.GROUPS, *size, bands))
    for n, lane in enumerate(lanes):
        pixel, group = divmod(lane, paths.GROUPS)
        value = weight[n] * radiance[divmod(texel[n], 8)].astype(float)
        for number in patch[n]:
            value = value * (reflectances[number] if number < paths.PATCHES else 1.0)
        expected[group, *divmod(pixel, size[1])] += value
    found = paths.Paths(size, texel, weight, patch, starts).pictures(radiance, reflectances)
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_a_direction_draws_the_texels_around_it_by_their_bilinear_shares():
    """The middle of the map is at −Z and a quarter to the right is +X, as the scene turns it; rows are middles."""
    directions = {(0, 0, -1): (4, 8), (1, 0, 0): (4, 12), (0, 1, 0): (0, None), (0, -1, 0): (7, None)}
    for direction, (row, column) in directions.items():
        drawn = paths._texels(np.tile(np.array(direction, float), (4000, 1)), (8, 16), np.random.default_rng(1))
        rows, columns = np.divmod(drawn, 16)
        if column is None:
            assert (rows == row).all()
        else:
            assert rows.mean() == pytest.approx(row - 0.5, abs=0.05)
            assert columns.mean() == pytest.approx(column - 0.5, abs=0.05)
            assert np.ptp(rows) == np.ptp(columns) == 1


def test_two_pictures_that_differ_by_noise_alone_are_a_standard_error_apart():
    rng = np.random.default_rng(3)
    first, second = rng.normal(1.0, 0.1, (2, paths.GROUPS, 32, 32, 3))
    assert relit_render.standard_errors(first, second) == pytest.approx(1.08, abs=0.15)
    assert relit_render.standard_errors(first, second + 0.1) > 3


#: Noise alone gives 1.08 and fireflies a little more; half a row or a column of the map in the wrong place gives 3.
AGREES = 1.4


@pytest.mark.slow
def test_the_paths_give_the_picture_that_mitsuba_renders_in_plain_rgb(tmp_path):
    """Three bands through an RGB variant, whose channels are plain numbers, and along the paths."""
    em = pytest.importorskip("envcal.mitsuba", reason="Mitsuba is not installed: pip install 'envcal[mitsuba]'")
    try:
        em.set_variant("llvm_ad_rgb")
    except EnvcalError as error:
        pytest.skip(str(error))
    import mitsuba as mi

    from envcal import exr
    from envcal.scene import description
    from envcal.scene.make import native_rows

    rng = np.random.default_rng(5)
    chosen = SimpleNamespace(size=(32, 18), spp=256)
    room = np.repeat(np.repeat(rng.random((4, 8, 3)) ** 3, 4, axis=0), 4, axis=1).astype(np.float32)
    reflectances = rng.random((paths.PATCHES, 3))
    bands = np.concatenate([room, np.zeros((*room.shape[:2], relit_render.EYES.wavelengths_nm.size - 3))], axis=-1)
    traced, lit = relit_render.trace(tmp_path / "scene.xml", bands.astype(np.float32) + np.float32(0.01), chosen)
    exr.write(tmp_path / "scaled.exr", exr.rgb_planes(native_rows(room)), attributes={})
    (tmp_path / "scaled.xml").write_text(description.scaled_xml("scaled.exr"), encoding="utf-8")
    scene = mi.load_file(str(tmp_path / "scene.xml"), lighting="scaled")
    params = mi.traverse(scene)
    for k, values in enumerate(reflectances):
        params[f"patch_{k + 1:02d}.bsdf.reflectance.value"] = mi.Color3f(*(float(v) for v in values))
    params.update()
    theirs = np.stack([np.asarray(mi.render(scene, spp=32, seed=90 + k), np.float64) for k in range(paths.GROUPS)])
    ours = traced.pictures(room, reflectances)
    assert 0.2 < lit.mean() < 0.8
    assert relit_render.standard_errors(ours, theirs) < AGREES
    assert relit_render.standard_errors(ours, 1.1 * theirs) > 2 * AGREES
