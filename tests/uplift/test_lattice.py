"""Truth: the evenly spaced cube itself, mixtures added up slowly, and a search through every cell."""

import numba
import numpy as np
import pytest

from tests.uplift.lights_for_tests import NAMES, light
from uplift import UpliftError
from uplift.difference import delta_e_2000
from uplift.lattice import (
    build_cube,
    build_lattice,
    nodes_and_weights,
    rgb_of_lattice,
    spectra_of_lattice,
    uplift_lattice,
)
from uplift.pixels import Status
from uplift.sigmoid import sigmoid
from uplift.spectrum import illuminant, observer, rgb_space, rgb_weights

EYES = observer()
SRGB, WIDE = rgb_space("sRGB"), rgb_space("ITU-R BT.2020")
CUBE = build_cube(observer=EYES, space=SRGB, size=12)
WIDE_CUBE = build_cube(observer=EYES, space=WIDE, size=12)
ROUND_TRIP = 1e-10  # ΔE2000: rounding of 81 × 8 additions
ROUNDING = 1e-12  # of colours of size one
ON_A_NODE = 1e-10  # where a node may lie beside its place in the cube; its colour is measured, so nothing follows


def seen(name, count=600, seed=1, space=SRGB):
    """Return colours [20, count / 20, 3] of smooth reflectances under a light."""
    rng = np.random.default_rng(seed)
    centres, widths = rng.uniform(420, 680, (count, 1)), rng.uniform(60, 200, (count, 1))
    bumps = np.exp(-0.5 * ((EYES.wavelengths_nm - centres) / widths) ** 2)
    reflectances = 0.2 + 0.6 * bumps * rng.random((count, 1))
    rgb = reflectances @ rgb_weights(light(name), EYES, space).T
    return (rgb * 10 ** rng.uniform(-4, 3, (count, 1))).reshape(20, -1, 3)


def uplifted(rgb, name="D65", cube=CUBE, **settings):
    return uplift_lattice(rgb, np.zeros(rgb.shape[:2], int), [build_lattice(light(name), cube)], **settings)


def back(result, cube=CUBE):
    parts = (result.cell, result.position, result.scale, result.emission)
    return rgb_of_lattice(*parts, result.emissions, cube)


def test_under_D65_nothing_is_skewed():
    even = np.stack(np.meshgrid(*[np.arange(12) / 11] * 3, indexing="ij"), axis=-1)
    for cube in (CUBE, WIDE_CUBE):
        lattice = build_lattice(illuminant("D65", EYES), cube)
        np.testing.assert_allclose(lattice.rgb[cube.filled], even[cube.filled], atol=ON_A_NODE)
        assert np.isnan(lattice.rgb[~cube.filled]).all()


def test_every_colour_of_sRGB_has_a_reflectance_and_pure_colours_of_a_wide_space_have_none():
    assert CUBE.filled.all()
    assert not WIDE_CUBE.filled[6, 0, 0] and not WIDE_CUBE.filled[0, 6, 0] and not WIDE_CUBE.filled[0, 0, 6]
    assert WIDE_CUBE.filled[range(12), range(12), range(12)].all()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("cube", [CUBE, WIDE_CUBE], ids=lambda cube: cube.space.name)
def test_the_round_trip_of_what_the_lattice_holds_is_exact(name, cube):
    rgb = seen(name, space=cube.space)
    result = uplifted(rgb, name, cube)
    kept = (result.status == Status.EXACT) | (result.status == Status.FALLBACK)
    assert (result.status == Status.EXACT).mean() > 0.8
    difference = delta_e_2000(rgb, back(result, cube), cube.space, white=None)
    assert difference[kept].max() < ROUND_TRIP
    assert sum(result.counts.values()) == result.status.size


def test_the_mixture_of_the_nodes_colours_is_the_pixel():
    rgb = seen("A")
    lattice = build_lattice(light("A"), CUBE)
    result = uplift_lattice(rgb, np.zeros((20, 30), int), [lattice])
    held = result.status == Status.EXACT
    nodes, weights = nodes_and_weights(result.cell[held], result.position[held], 12)
    assert nodes.shape == weights.shape == (held.sum(), 8)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=ROUNDING)
    assert weights.min() > -ROUNDING
    mixed = np.einsum("pi,pic->pc", weights, lattice.rgb.reshape(-1, 3)[nodes])
    np.testing.assert_allclose(mixed, rgb[held] / result.scale[held][:, None], atol=ROUNDING)
    np.testing.assert_array_equal(result.scale, 2 * rgb.max(axis=2))


def test_the_spectrum_is_the_light_times_the_mixture_and_lies_between_black_and_white():
    rgb = seen("FL11")
    result = uplifted(rgb, "FL11")
    parts = (result.cell, result.position, result.scale, result.emission)
    spectra = spectra_of_lattice(*parts, result.emissions, CUBE)
    nodes, weights = nodes_and_weights(result.cell, result.position, 12)
    c = CUBE.coefficients.reshape(-1, 3)[nodes]
    x = (c[..., 0, None] * CUBE.t + c[..., 1, None]) * CUBE.t + c[..., 2, None]
    reflectance = np.einsum("hwi,hwin->hwn", weights, sigmoid(x))
    assert reflectance.min() >= 0 and reflectance.max() <= 1
    slow = result.scale[..., None] * result.emissions[result.emission] * reflectance
    np.testing.assert_allclose(spectra, slow, rtol=1e-9, atol=1e-12)
    weights_of_light = SRGB.rgb_from_xyz @ EYES.cmfs.T * EYES.step_nm
    np.testing.assert_allclose(spectra @ weights_of_light.T, back(result), rtol=1e-9)
    some = spectra_of_lattice(*parts, result.emissions, CUBE, wavelengths_nm=[550.0, 380.0, 300.0])
    np.testing.assert_allclose(some[..., :2], spectra[..., [34, 0]], rtol=ROUNDING)
    assert not some[..., 2].any()


def holding_cells(lattice, colour):
    """Return whether some cell holds `colour`, by Newton's method from several places in every one of them."""
    side = lattice.rgb.shape[0] - 1
    for i, j, k in np.ndindex(side, side, side):
        corners = lattice.rgb[i : i + 2, j : j + 2, k : k + 2]
        if np.isnan(corners).any():
            continue
        for start in (0.5, 0.1, 0.9):
            p = np.full(3, start)
            for _ in range(20):
                w = [np.array([1 - p[a], p[a]]) for a in range(3)]
                d = np.array([-1.0, 1.0])
                slopes = np.stack(
                    [np.einsum("ijkc,i,j,k->c", corners, *[d if b == a else w[b] for b in range(3)]) for a in range(3)],
                    axis=1,
                )
                rest = colour - np.einsum("ijkc,i,j,k->c", corners, *w)
                p = p + np.linalg.lstsq(slopes, rest, rcond=None)[0]
            if np.abs(rest).max() < ROUNDING and p.min() > -1e-9 and p.max() < 1 + 1e-9:
                return True
    return False


def test_a_search_through_every_cell_finds_no_pixel_that_the_walk_missed():
    cube = build_cube(observer=EYES, space=WIDE, size=4)
    lattice = build_lattice(light("2200 K"), cube)
    rgb = np.random.default_rng(3).random((4, 6, 3)) * [1.0, 0.6, 0.3]
    result = uplift_lattice(rgb, np.zeros((4, 6), int), [lattice])
    asked = rgb / (2 * rgb.max(axis=2, keepdims=True))
    truth = np.array([[holding_cells(lattice, colour) for colour in row] for row in asked])
    assert 0 < truth.sum() < truth.size  # the test sees both
    np.testing.assert_array_equal(result.status == Status.EXACT, truth)


def test_dark_pixels_outside_keep_their_colour_under_D65_and_bright_ones_take_the_nearest():
    blue = np.array([0.05, 0.1, 0.9])  # more than a candle has
    result = uplifted(np.stack([blue, 128 * blue]).reshape(1, 2, 3), "2200 K")
    np.testing.assert_array_equal(result.status, [[Status.FALLBACK, Status.CLOSEST]])
    np.testing.assert_array_equal(result.emission, [[1, 0]])
    np.testing.assert_allclose(back(result)[0, 0], blue, rtol=1e-10)
    assert result.largest_shift > 1 and len(result.warnings) == 2
    assert "nearest colour" in result.warnings[1]
    raised = uplifted(np.stack([blue, 128 * blue]).reshape(1, 2, 3), "2200 K", bright=1e3)
    np.testing.assert_array_equal(raised.status, [[Status.FALLBACK, Status.FALLBACK]])
    np.testing.assert_array_equal(raised.position[0, 0], raised.position[0, 1])


def test_no_node_is_nearer_than_the_nearest_colour():
    rgb = 50 * np.random.default_rng(5).random((5, 20, 3)) ** 3
    lattice = build_lattice(light("2200 K"), CUBE)
    result = uplift_lattice(rgb, np.zeros((5, 20), int), [lattice])
    moved = result.status == Status.CLOSEST
    assert moved.sum() > 5
    asked = rgb[moved] / result.scale[moved][:, None]
    given = back(result)[moved] / result.scale[moved][:, None]
    to_nodes = np.linalg.norm(asked[:, None] - lattice.rgb.reshape(1, -1, 3), axis=2).min(axis=1)
    assert (np.linalg.norm(asked - given, axis=1) <= to_nodes + ROUNDING).all()
    assert ((result.position[moved] >= 0) & (result.position[moved] <= 1)).all()


def test_black_missing_and_dark_negative_pixels_have_no_radiance_and_are_counted():
    rgb = np.array([[[0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0], [-1, -1, -2]]], dtype=np.float32)
    result = uplifted(rgb)
    np.testing.assert_array_equal(result.status, [[Status.BLACK, Status.MISSING, Status.MISSING, Status.CLOSEST]])
    np.testing.assert_array_equal(back(result), 0)
    assert result.counts[Status.MISSING] == 2 and len(result.warnings) == 2


def test_brightness_order_tiles_and_threads_do_not_matter():
    rgb = seen("LED-B3", seed=7)
    lattices = [build_lattice(light(name), CUBE) for name in ("LED-B3", "A")]
    cluster = np.random.default_rng(8).integers(0, 2, (20, 30))
    result = uplift_lattice(rgb, cluster, lattices)
    turned = uplift_lattice(rgb[::-1, 5:], cluster[::-1, 5:], lattices)
    for name in ("cell", "position", "scale", "status", "emission", "visited"):
        np.testing.assert_array_equal(getattr(turned, name), getattr(result, name)[::-1, 5:])
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        alone = uplift_lattice(rgb, cluster, lattices)
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(alone.position, result.position)
    brighter = uplift_lattice(rgb * 2.0, cluster, lattices, bright=2.0)
    np.testing.assert_array_equal(brighter.position, result.position)
    np.testing.assert_array_equal(brighter.scale, 2 * result.scale)


def test_what_is_no_map_no_cube_or_no_lattice_is_refused():
    lattice = build_lattice(light("A"), CUBE)
    rgb, cluster = np.full((2, 2, 3), 0.5), np.zeros((2, 2), int)
    with pytest.raises(UpliftError, match="expected 3 to 128"):
        build_cube(observer=EYES, space=SRGB, size=2)
    with pytest.raises(UpliftError, match="expected one value for each"):
        build_lattice(np.ones(3), CUBE)
    with pytest.raises(UpliftError, match="expected floats"):
        uplift_lattice(np.zeros((2, 3)), cluster, [lattice])
    with pytest.raises(UpliftError, match="expected integers"):
        uplift_lattice(rgb, np.zeros((3, 2), int), [lattice])
    with pytest.raises(UpliftError, match="no lattices"):
        uplift_lattice(rgb, cluster, [])
    with pytest.raises(UpliftError, match="clusters run from 1 to 1"):
        uplift_lattice(rgb, cluster + 1, [lattice])
    with pytest.raises(UpliftError, match="different cubes"):
        uplift_lattice(rgb, cluster, [lattice, build_lattice(light("A"), WIDE_CUBE)])
    with pytest.raises(UpliftError, match="factor 1"):
        uplift_lattice(rgb, cluster, [lattice], factor=1.0)
    result = uplift_lattice(rgb, cluster, [lattice])
    parts = (result.cell, result.position, result.scale, result.emission)
    with pytest.raises(UpliftError, match="disagree"):
        rgb_of_lattice(result.cell, result.position[0], result.scale, result.emission, result.emissions, CUBE)
    with pytest.raises(UpliftError, match="on the cube's grid"):
        rgb_of_lattice(*parts, result.emissions[:, :9], CUBE)
    with pytest.raises(UpliftError, match="there are 2 emissions"):
        spectra_of_lattice(*parts[:3], result.emission + 5, result.emissions, CUBE)
