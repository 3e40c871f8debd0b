"""Truth: the colour of each spectrum by a slow sum, spectra that made the colours, and symmetries of the problem."""

import dataclasses
import os
from pathlib import Path

import numba
import numpy as np
import pytest

from tests.uplift.lights_for_tests import NAMES, light
from uplift import UpliftError
from uplift.difference import delta_e_2000
from uplift.pixels import (
    Buffers,
    Status,
    fallback_emissions,
    fallback_tables,
    rgb_of,
    spectra_of,
    uplift_pixels,
)
from uplift.sigmoid import reflectance
from uplift.spectrum import illuminant, observer, rgb_space, rgb_weights, xyz_of
from uplift.surface import CUBIC, CURVED, LINEAR
from uplift.table import build_table

EYES = observer()
SPACE = rgb_space("ITU-R BT.2020")
D65 = illuminant("D65", EYES)
ROUND_TRIP = 1e-10  # ΔE2000: the promise of the package; what remains is rounding
CORNER = 2e-3  # of the largest component
SUMMED = 1e-12  # relative: the order of 81 additions, and coefficients that are stored for λ in nm
SAME_SPECTRUM = 1e-9  # relative: two solutions of one equation, each exact to rounding, where the equation is stiff


def uplifted(rgb, name="D65", space=SPACE, precision="exact", **settings):
    table = build_table(light(name), observer=EYES, space=space, **settings)
    return uplift_pixels(rgb, np.zeros(rgb.shape[:2], np.uint32), [table], precision=precision)


def back(result, space=SPACE):
    return rgb_of(result.coefficients, result.scale, result.emission, result.emissions, observer=EYES, space=space)


def smooth_reflectances(count, seed):
    """Return reflectances [count, 81] in 0.02 … 1: mixtures of broad and narrow bumps and steps."""
    rng = np.random.default_rng(seed)
    centres, widths = rng.uniform(400, 700, (count, 3, 1)), rng.uniform(15, 120, (count, 3, 1))
    bumps = np.exp(-0.5 * ((EYES.wavelengths_nm - centres) / widths) ** 2) * rng.random((count, 3, 1))
    return 0.02 + 0.98 * bumps.sum(axis=1) / 3


@pytest.mark.parametrize("space", ["ITU-R BT.2020", "sRGB"])
@pytest.mark.parametrize("name", NAMES)
def test_the_round_trip_of_every_colour_in_gamut_is_exact(name, space):
    space = rgb_space(space)
    rng = np.random.default_rng(6)
    rgb = rng.random((20, 150, 3)) ** rng.choice([1.0, 3.0], (20, 150, 1)) * 10 ** rng.uniform(-6, 4, (20, 150, 1))
    result = uplifted(rgb, name, space)
    exact = (result.status == Status.EXACT) | (result.status == Status.FALLBACK)
    difference = delta_e_2000(rgb, back(result, space), space, white=None)[exact]
    assert difference.max() < ROUND_TRIP
    # The primaries of BT.2020 are single wavelengths, and none of the grid's: its corners are out of reach.
    corner = rgb.min(axis=2) < CORNER * rgb.max(axis=2)
    assert exact[~corner].all()
    assert exact.mean() > 0.99 if space is SPACE else exact.all()


@pytest.mark.parametrize("space", ["ITU-R BT.2020", "sRGB", "ACEScg", "ACES2065-1"])
@pytest.mark.parametrize("name", ["D65", "FL11", "1200 K", "1000 K"])
def test_a_colour_made_by_a_reflectance_is_exact_under_its_light(name, space):
    space = rgb_space(space)
    made = smooth_reflectances(1000, seed=7) @ rgb_weights(light(name), EYES, space).T
    result = uplifted(made.reshape(25, 40, 3), name, space)
    assert result.counts[Status.EXACT] == 1000
    assert delta_e_2000(made.reshape(25, 40, 3), back(result, space), space, white=None).max() < ROUND_TRIP


@pytest.mark.parametrize(("precision", "largest"), [("exact", ROUND_TRIP), ("float", 1e-4), ("preview", 0.05)])
@pytest.mark.parametrize("space", ["ITU-R BT.2020", "sRGB"])
@pytest.mark.parametrize("name", NAMES)
def test_each_precision_keeps_its_promise_and_the_status_of_every_pixel(name, space, precision, largest):
    space = rgb_space(space)
    rng = np.random.default_rng(21)
    rgb = (rng.random((40, 250, 3)) ** rng.choice([0.3, 1.0, 2.0], (40, 250, 1))).astype(np.float32)
    result = uplifted(rgb, name, space, precision)
    kept = (result.status == Status.EXACT) | (result.status == Status.FALLBACK)
    assert delta_e_2000(rgb, back(result, space), space, white=None)[kept].max() < largest
    np.testing.assert_array_equal(result.status, uplifted(rgb, name, space).status)
    assert sum(result.counts.values()) == rgb.shape[0] * rgb.shape[1]


@pytest.mark.parametrize("name", ["D65", "A", "LED-B3", "FL11"])
def test_colours_like_those_of_maps_make_the_round_trip_to_rounding(name):
    rgb = 0.05 + np.random.default_rng(22).random((60, 200, 3))
    difference = delta_e_2000(rgb, back(uplifted(rgb, name)), SPACE, white=None)
    assert difference.mean() < 5e-13 and difference.max() < 1e-10


@pytest.mark.parametrize("precision", ["float", "preview"])
def test_tiles_and_threads_change_no_bit_at_lower_precision(precision):
    rgb = np.random.default_rng(23).normal(0.5, 0.4, (150, 80, 3))
    whole = uplifted(rgb, "FL2", precision=precision)
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        tile = uplifted(rgb[41:97, 5:], "FL2", precision=precision)
    finally:
        numba.set_num_threads(threads)
    for name in ("coefficients", "scale", "status"):
        np.testing.assert_array_equal(getattr(whole, name)[41:97, 5:], getattr(tile, name))


@pytest.mark.parametrize("space", ["ITU-R BT.2020", "sRGB"])
@pytest.mark.parametrize("name", ["D65", "A", "FL2", "FL11", "LED-B3", "1200 K"])
def test_previews_keep_their_promise_all_over_the_cells_that_only_they_look_up_cubically(name, space):
    space = rgb_space(space)
    table = build_table(light(name), observer=EYES, space=space)
    m, i, j = np.nonzero((table.grades & (LINEAR | CUBIC | CURVED)) == CURVED)
    assert m.size > 100
    rng = np.random.default_rng(24)
    G = np.ones((m.size, 8, 3))  # eight places in each cell
    for step, corner in ((1, i), (2, j)):
        ratio = (corner[:, None] + rng.random((m.size, 8))) / table.grades.shape[1]
        np.put_along_axis(G, ((m + step) % 3)[:, None, None], ratio[..., None], axis=2)
    rgb = G @ np.linalg.inv(table.axes).T
    result = uplift_pixels(rgb, np.zeros(rgb.shape[:2], np.uint32), [table], precision="preview")
    assert result.counts[Status.EXACT] == rgb.shape[0] * rgb.shape[1]
    difference = delta_e_2000(rgb, back(result, space), space, white=None)
    assert difference.max() < 0.05
    assert np.median(difference) > ROUND_TRIP  # or Newton's method had answered


def test_an_unknown_precision_is_refused():
    with pytest.raises(UpliftError, match="expected one of exact, float, preview"):
        uplifted(np.ones((1, 1, 3)), precision="double")


@pytest.mark.parametrize("name", NAMES)
def test_the_light_itself_gets_its_own_spectrum(name):
    w = rgb_weights(light(name), EYES, SPACE).sum(axis=1)
    result = uplifted(7.0 * w.reshape(1, 1, 3), name)
    P = spectra_of(result.coefficients, result.scale, result.emission, result.emissions, EYES.wavelengths_nm)
    np.testing.assert_allclose(P[0, 0], 7.0 * light(name), rtol=SUMMED)


def test_white_under_D65_is_D65():
    result = uplifted(np.ones((2, 3, 3), np.float32))
    P = spectra_of(result.coefficients, result.scale, result.emission, result.emissions, EYES.wavelengths_nm)
    np.testing.assert_allclose(P, np.broadcast_to(D65, P.shape), rtol=SUMMED)


def test_reflectances_stay_between_zero_and_one():
    rgb = np.random.default_rng(8).random((20, 50, 3)) ** 4
    R = reflectance(uplifted(rgb, "FL11").coefficients, EYES.wavelengths_nm)
    assert R.min() > 0 and R.max() < 1


@pytest.mark.parametrize("k", [1e-30, 0.37, 2.0**40])
def test_k_times_the_map_has_k_times_the_spectrum(k):
    rgb = np.random.default_rng(9).random((10, 50, 3)) ** 2 + 0.01
    once, scaled = uplifted(rgb, "FL2"), uplifted(k * rgb, "FL2")
    for result, factor in ((once, 1.0), (scaled, k)):
        spectra = spectra_of(result.coefficients, result.scale, result.emission, result.emissions, [450, 550.5, 620])
        if factor == 1.0:
            expected = spectra
    np.testing.assert_allclose(spectra, k * expected, rtol=SAME_SPECTRUM)


def test_permuting_or_tiling_the_pixels_does_the_same_to_the_result():
    rng = np.random.default_rng(10)
    rgb = rng.normal(0.3, 0.3, (30, 20, 3)) ** 3  # some of it negative
    cluster = rng.integers(0, 2, (30, 20))
    tables = [build_table(light(name), observer=EYES, space=SPACE) for name in ("A", "FL11")]
    whole = uplift_pixels(rgb, cluster, tables)
    order = rng.permutation(600)
    shuffled = uplift_pixels(rgb.reshape(600, 1, 3)[order], cluster.reshape(600, 1)[order], tables)
    np.testing.assert_array_equal(shuffled.coefficients[:, 0], whole.coefficients.reshape(600, 3)[order])
    tile = uplift_pixels(rgb[7:9], cluster[7:9], tables)
    for name in ("coefficients", "scale", "emission", "status"):
        np.testing.assert_array_equal(getattr(tile, name), getattr(whole, name)[7:9])


@pytest.mark.parametrize("precision", ["exact", "preview"])
def test_lights_pixel_by_pixel_give_the_bits_of_lights_in_large_areas(precision):
    rng = np.random.default_rng(14)
    rgb = rng.normal(0.4, 0.3, (1, 6000, 3)).astype(np.float32)  # more than one thread takes at a time
    cluster = rng.integers(0, 3, (1, 6000), dtype=np.uint32)
    tables = [build_table(light(name), observer=EYES, space=SPACE) for name in ("A", "FL11", "D65")]
    scattered = uplift_pixels(rgb, cluster, tables, precision=precision)
    order = np.argsort(cluster[0], kind="stable")
    areas = uplift_pixels(rgb[:, order], cluster[:, order], tables, precision=precision)
    for name in ("coefficients", "scale", "emission", "status"):
        np.testing.assert_array_equal(getattr(scattered, name)[:, order], getattr(areas, name))
    cluster[0, 4321] = 3
    with pytest.raises(UpliftError, match="run from 0 to 3, but there are 3 tables"):
        uplift_pixels(rgb, cluster, tables, precision=precision)


def test_the_number_of_threads_changes_no_bit():
    rgb = np.random.default_rng(11).normal(0.5, 0.5, (40, 40, 3))
    threads = numba.get_num_threads()
    whole = uplifted(rgb, "LED-B1")
    numba.set_num_threads(1)
    try:
        alone = uplifted(rgb, "LED-B1")
    finally:
        numba.set_num_threads(threads)
    for name in ("coefficients", "scale", "emission", "status", "counts", "largest_shift"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(alone, name))


def test_each_pixel_takes_the_light_of_its_cluster():
    tables = [build_table(light(name), observer=EYES, space=SPACE) for name in ("A", "LED-B3")]
    rgb = np.full((1, 2, 3), [0.8, 0.7, 0.4])
    result = uplift_pixels(rgb, np.array([[1, 0]]), tables)
    np.testing.assert_array_equal(result.emission, [[1, 0]])
    np.testing.assert_allclose(result.emissions[:3], [light("A"), light("LED-B3"), D65], rtol=SUMMED)
    np.testing.assert_array_equal(result.emissions[2:], fallback_emissions(EYES))
    np.testing.assert_allclose(back(result), rgb, rtol=SUMMED)


def test_black_and_missing_pixels_have_no_radiance():
    rgb = np.array([[[0, 0, 0], [np.nan, 1, 1], [1, np.inf, 1], [-0.0, 0, 0]]], dtype=np.float32)
    result = uplifted(rgb)
    np.testing.assert_array_equal(result.status, [[Status.BLACK, Status.MISSING, Status.MISSING, Status.BLACK]])
    np.testing.assert_array_equal(result.scale, 0)
    np.testing.assert_array_equal(result.coefficients, np.broadcast_to([0, 0, -np.inf], (1, 4, 3)))
    np.testing.assert_array_equal(back(result), 0)
    assert result.counts[Status.BLACK] == 2 and result.counts[Status.MISSING] == 2
    assert len(result.warnings) == 1 and "2 pixels (50.0000%) are NaN" in result.warnings[0]


def test_tiny_and_huge_values_are_exact():
    rgb = np.array([0.9, 0.5, 0.2]) * np.array([1e-300, 1e-45, 1.0, 1e38, 1e300]).reshape(1, 5, 1)
    result = uplifted(rgb, "A")
    assert result.counts[Status.EXACT] == 5
    np.testing.assert_allclose(back(result), rgb, rtol=SUMMED)


def test_slightly_negative_colours_inside_the_cone_are_exact():
    space = rgb_space("sRGB")
    rgb = np.array([[[0.02, 0.9, 0.05]]]) @ (space.rgb_from_xyz @ SPACE.xyz_from_rgb).T  # a green of BT.2020
    assert rgb.min() < 0
    result = uplifted(rgb, "D65", space)
    assert result.counts[Status.EXACT] == 1
    np.testing.assert_allclose(back(result, space), rgb, atol=SUMMED)


def test_what_the_light_cannot_show_keeps_its_colour_under_D65():
    lines = np.isin(EYES.wavelengths_nm, (450, 540, 620)).astype(float)
    table = build_table(lines, observer=EYES, space=SPACE)
    rgb = np.array([[[0.9, 0.9, 0.9], [0.02, 0.9, 0.3]]])  # a green to which three lines do not reach
    result = uplift_pixels(rgb, np.zeros((1, 2), int), [table])
    np.testing.assert_array_equal(result.status, [[Status.EXACT, Status.FALLBACK]])
    np.testing.assert_array_equal(result.emission, [[0, 1]])
    np.testing.assert_allclose(back(result), rgb, rtol=SUMMED)
    assert result.largest_shift == 0 and "keep their colour under another light" in result.warnings[0]


@pytest.mark.parametrize("name", ["D65", "LED-RGB1", "1000 K"])
def test_what_no_light_can_show_moves_towards_the_lights_white_at_its_luminance(name):
    rgb = np.array([[[1.0, 0.0, 0.0], [-0.4, 1.0, 0.1], [0.01, -0.02, 0.9], [-0.5, 0.5, 0.5]]])
    result = uplifted(rgb, name)
    assert (result.status == Status.CLOSEST).all()
    shown = back(result)
    np.testing.assert_allclose(shown @ SPACE.luminance_weights, rgb @ SPACE.luminance_weights, rtol=1e-9)
    Y = rgb @ SPACE.luminance_weights
    for pixel in range(4):
        light_rgb = rgb_weights(result.emissions[result.emission[0, pixel]], EYES, SPACE).sum(axis=1)
        towards, moved = Y[0, pixel] * light_rgb - rgb[0, pixel], shown[0, pixel] - rgb[0, pixel]
        share = moved @ towards / (towards @ towards)
        assert 0 < share < 1
        np.testing.assert_allclose(moved, share * towards, atol=1e-9)
    assert result.largest_shift == pytest.approx(delta_e_2000(rgb, shown, SPACE).max())
    assert f"{result.largest_shift:.3g}" in result.warnings[0]


def test_the_primaries_of_the_working_space_hardly_move():
    shift = uplifted(np.eye(3).reshape(1, 3, 3)).largest_shift
    assert 0 < shift < 1.0  # ΔE2000; they are monochromatic, and the grid's wavelengths lie between theirs


def test_colours_without_luminance_become_black_and_are_counted():
    result = uplifted(np.array([[[-1.0, -1, -1], [0.1, -0.2, 0.05]]]))
    assert result.counts[Status.CLOSEST] == 2
    np.testing.assert_array_equal(result.scale, 0)
    assert result.largest_shift > 0


def test_radiance_sums_to_the_colour_it_came_from():
    rgb = np.random.default_rng(12).random((10, 30, 3)) + 0.01
    result = uplifted(rgb, "FL2")
    P = spectra_of(result.coefficients, result.scale, result.emission, result.emissions, EYES.wavelengths_nm)
    np.testing.assert_allclose(xyz_of(P, EYES) @ SPACE.rgb_from_xyz.T, back(result), rtol=SUMMED)
    slow = np.zeros((10, 30, 3))
    for i, nm in enumerate(EYES.wavelengths_nm):
        x = (result.coefficients * np.array([nm * nm, nm, 1.0])).sum(axis=-1)
        slow += (result.scale * light("FL2")[i] * (0.5 + x / (2 * np.sqrt(1 + x * x))))[..., None] * EYES.cmfs[i] * 5
    np.testing.assert_allclose(slow @ SPACE.rgb_from_xyz.T, rgb, rtol=1e-11)


def test_between_the_grids_wavelengths_the_light_is_linear_and_outside_it_is_dark():
    result = uplifted(np.full((1, 1, 3), 0.4), "FL11")
    wavelengths = np.array([300.0, 437.5, 380.0, 780.0, 780.1])
    P = spectra_of(result.coefficients, result.scale, result.emission, result.emissions, wavelengths)[0, 0]
    E = np.interp(wavelengths, EYES.wavelengths_nm, light("FL11"), left=0, right=0)
    R = reflectance(result.coefficients[0, 0], wavelengths)
    np.testing.assert_allclose(P, result.scale[0, 0] * E * R, rtol=SUMMED)
    assert P[0] == 0 and P[-1] == 0
    single = spectra_of(
        result.coefficients, result.scale, result.emission, result.emissions, wavelengths, dtype=np.float32
    )
    assert single.dtype == np.float32
    np.testing.assert_allclose(single[0, 0], P, rtol=1e-6)


def test_the_fallback_is_built_once():
    assert fallback_tables(EYES, SPACE) is fallback_tables(EYES, SPACE)


def test_arguments_are_left_alone_and_may_be_views():
    rgb = np.random.default_rng(13).random((8, 9, 6)).astype(np.float32)
    before = rgb.copy()
    view = rgb[::2, ::-1, ::2]
    result = uplifted(view)
    np.testing.assert_array_equal(rgb, before)
    np.testing.assert_array_equal(result.scale, uplifted(view.copy()).scale)


def test_an_empty_map_is_no_mistake():
    assert sum(uplifted(np.empty((0, 5, 3))).counts.values()) == 0


def test_maps_clusters_and_tables_that_do_not_fit_are_refused():
    table = build_table(D65, observer=EYES, space=SPACE, nodes=4)
    other = build_table(D65, observer=EYES, space=SPACE, nodes=5)
    rgb, cluster = np.ones((2, 2, 3)), np.zeros((2, 2), int)
    for arguments, message in [
        ((np.ones((2, 2)), cluster, [table]), r"expected floats \[H, W, 3\]"),
        ((np.ones((2, 2, 3), int), cluster, [table]), "expected floats"),
        ((rgb, np.zeros((2, 3), int), [table]), "index of each pixel's table"),
        ((rgb, np.zeros((2, 2)), [table]), "expected integers"),
        ((rgb, cluster, []), "no tables"),
        ((rgb, cluster, table), r"one Table; expected .* such as \[table\]"),
        ((rgb, cluster, [D65]), "no sequence of Tables"),
        ((rgb, cluster, D65), "no sequence of Tables"),
        ((rgb, cluster + 1, [table]), "give one for each cluster"),
        ((rgb, cluster - 1, [table]), "give one for each cluster"),
        ((rgb, np.array([[0, 0], [1, 0]], np.uint32), [table]), "run from 0 to 1"),
        ((rgb, cluster + (1 << 32), [table]), "give one for each cluster"),
        ((rgb, cluster, [table, other]), "differ in observer"),
    ]:
        with pytest.raises(UpliftError, match=message):
            uplift_pixels(*arguments)


@pytest.mark.parametrize("precision", ["exact", "float", "preview"])
def test_memory_that_is_given_is_used_and_changes_no_bit(precision):
    rgb = np.random.default_rng(24).normal(0.4, 0.4, (30, 40, 3))
    cluster, tables = np.zeros((30, 40), np.uint32), [build_table(light("FL2"), observer=EYES, space=SPACE)]
    alone = uplift_pixels(rgb, cluster, tables, precision=precision)
    memory = Buffers.of(1500)
    uplift_pixels(rgb[::-1], cluster, tables, precision=precision, out=memory)  # something else before
    result = uplift_pixels(rgb, cluster, tables, precision=precision, out=memory)
    for name in ("coefficients", "scale", "emission", "status"):
        np.testing.assert_array_equal(getattr(result, name), getattr(alone, name))
        assert np.shares_memory(getattr(result, name), getattr(memory, name))
    assert result.counts == alone.counts and len(set(result.counts.values())) > 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scale": np.empty(3)}, r"out.scale has shape \(3,\) of float64; expected .* at least 4 pixels"),
        ({"status": np.empty(4, np.int8)}, "expected writeable, contiguous uint8"),
        ({"coefficients": np.empty((4, 4))}, r"out.coefficients has shape \(4, 4\)"),
        ({"emission": np.empty(8, np.uint32)[::2]}, "out.emission .* contiguous"),
    ],
)
def test_memory_that_does_not_fit_is_refused(change, message):
    table = build_table(D65, observer=EYES, space=SPACE, nodes=4)
    memory = dataclasses.replace(Buffers.of(4), **change)
    with pytest.raises(UpliftError, match=message):
        uplift_pixels(np.ones((2, 2, 3)), np.zeros((2, 2), int), [table], out=memory)


def test_spectra_that_do_not_fit_are_refused():
    c, scale, index = np.zeros((2, 3)), np.ones(2), np.zeros(2, int)
    for arguments, message in [
        ((c[:1], scale, index, [D65], [500]), "disagree"),
        ((c, scale, index.astype(float), [D65], [500]), "disagree"),
        ((c, scale, index, [D65[:80]], [500]), r"expected \[K, 81\]"),
        ((c, scale, index + 1, [D65], [500]), "there are 1 emissions"),
        ((c, scale, index, [D65], [[500]]), "list of nm"),
    ]:
        with pytest.raises(UpliftError, match=message):
            spectra_of(*arguments)


@pytest.mark.skipif("ENVCAL_DATA" not in os.environ, reason="ENVCAL_DATA names no folder with real maps")
@pytest.mark.parametrize("name", ["D65", "A", "FL11"])
def test_real_maps_make_the_round_trip(name):
    import cv2

    maps = sorted(Path(os.environ["ENVCAL_DATA"]).glob("real/*.hdr"))
    assert maps
    space = rgb_space("sRGB")
    for path in maps:
        rgb = np.ascontiguousarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1])
        result = uplifted(rgb, name, space)
        assert result.counts[Status.EXACT] + result.counts[Status.BLACK] == rgb.shape[0] * rgb.shape[1]
        assert delta_e_2000(rgb, back(result, space), space, white=1.0).max() < ROUND_TRIP
