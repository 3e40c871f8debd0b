"""The parts of the emitter alone: directions, corners, emissions and densities, each against numpy."""

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba", reason="Mitsuba is not installed: pip install 'envcal[mitsuba]'")
em = pytest.importorskip("envcal.mitsuba")

from envcal.mitsuba import geometry, radiance, sampling  # noqa: E402

#: A few roundings of single precision.
SINGLE = 1e-6
GRID = np.arange(380.0, 781.0, 5.0)
HEIGHT, WIDTH = 6, 12


@pytest.fixture
def V():
    em.set_variant("llvm_ad_spectral")
    import mitsuba.llvm_ad_spectral

    return mitsuba.llvm_ad_spectral


def places(count=2000, seed=0):
    return np.random.default_rng(seed).uniform(0, 1, (2, count)).astype(np.float32)


def test_place_and_direction_are_each_others_inverse(V):
    u, v = places()
    d, inverse_sine = geometry.direction_of(V, V.Float(u), V.Float(v))
    np.testing.assert_allclose(np.linalg.norm(np.array(d), axis=0), 1, atol=SINGLE)
    found_u, found_v, found_sine = (np.array(part) for part in geometry.place_of(d))
    np.testing.assert_allclose(found_v, v, atol=SINGLE)
    apart = np.abs(found_u - u) * np.sin(np.pi * v)  # beside a pole u means little
    assert np.minimum(apart, np.sin(np.pi * v) - apart).max() < SINGLE
    np.testing.assert_allclose(found_sine, np.array(inverse_sine), rtol=1e-3)  # 1 / sin θ at 1e-3 of a pole


def test_the_directions_are_those_of_mitsubas_maps(V):
    """Down the left edge −Z, a quarter from it +X, the middle +Z, the top +Y."""
    u, v = np.array([[0, 0.5], [0.25, 0.5], [0.5, 0.5], [0.3, 0]], np.float32).T
    d, _ = geometry.direction_of(V, V.Float(u), V.Float(v))
    np.testing.assert_allclose(np.array(d).T, [[0, 0, -1], [1, 0, 0], [0, 0, 1], [0, 1, 0]], atol=SINGLE)


def test_corners_weigh_to_one_and_wrap_around_but_not_over_the_poles(V):
    u, v = places()
    u[:3], v[:3] = [0, 0.999, 0.5], [0.5, 0.5, 0]
    around = radiance.corners(V, (HEIGHT, WIDTH), V.Float(u), V.Float(v))
    texels, weights = np.array([np.array(t) for t in around.texels]), np.array([np.array(w) for w in around.weights])
    np.testing.assert_allclose(weights.sum(axis=0), 1, atol=SINGLE)
    assert weights.min() >= 0 and texels.max() < HEIGHT * WIDTH
    assert set(texels[:, 0] % WIDTH) == set(texels[:, 1] % WIDTH) == {0, WIDTH - 1}
    assert weights[texels[:, 2] // WIDTH == 0, 2].sum() == pytest.approx(1, abs=SINGLE)
    # The weighted mean of the corners' places is the place, away from the seam and the poles.
    inside = (np.abs(u - 0.5) < 0.4) & (np.abs(v - 0.5) < 0.4)
    for places_of, expected, size in ((texels % WIDTH, u, WIDTH), (texels // WIDTH, v, HEIGHT)):
        found = (((places_of + 0.5) * weights).sum(axis=0) / size)[inside]
        np.testing.assert_allclose(found, expected[inside], atol=SINGLE)


@pytest.mark.parametrize("slots", [1, radiance.PACKET, radiance.PACKET + 3])
def test_emissions_are_linear_between_the_nodes_and_zero_outside_for_few_lights_and_many(V, slots):
    rng = np.random.default_rng(slots)
    used = np.sort(rng.permutation(slots + 4)[:slots])
    emissions = rng.uniform(0, 2, (slots + 4, len(GRID))).astype(np.float32)
    wavelengths = rng.uniform(361, 829, (4, 500)).astype(np.float32)
    table = radiance.table_of(V, V.TensorXf(emissions), used)
    corner_slots = rng.integers(0, slots, (4, 500)).astype(np.uint32)
    packed = V.UInt32(sum(corner_slots[k] << np.uint32(8 * k) for k in range(4)))
    of_corner = radiance.emissions_around(V, table, used, GRID, packed, V.Spectrum(wavelengths), True)
    for corner in range(4):
        expected = [
            [np.interp(w, GRID, emissions[used[slot]], 0, 0) for w, slot in zip(row, corner_slots[corner], strict=True)]
            for row in wavelengths
        ]
        np.testing.assert_allclose(
            np.array(of_corner(corner)) * mi.MI_CIE_Y_NORMALIZATION, expected, atol=2e-5
        )  # a step is 5 nm


def test_the_reflectance_of_deep_colours_keeps_its_digits(V):
    wavelengths = np.full((4, 5), 580.0, np.float32)
    x = np.array([-1e4, -100, 0, 100, 1e8])
    zero = np.zeros(5, np.float32)
    found = radiance.reflectance(V, V.Vector3f(zero, zero, x.astype(np.float32)), V.Spectrum(wavelengths))
    expected = np.where(
        x < 0, 1 / (2 * (1 + x * x) * (1 + np.abs(x) / np.sqrt(1 + x * x))), 0.5 + x / (2 * np.hypot(1, x))
    )
    np.testing.assert_allclose(np.array(found)[0], expected, rtol=SINGLE)


def test_places_are_drawn_by_the_density_that_is_told(V):
    luminance = np.random.default_rng(5).uniform(0, 1, (HEIGHT, WIDTH)).astype(np.float32) ** 3
    warp = V.Hierarchical2D0(sampling.nodes(luminance))
    u, v, drawn = sampling.draw_place(V, warp, (HEIGHT, WIDTH), V.Point2f(places()), True)
    told = sampling.density(V, warp, (HEIGHT, WIDTH), u, v, True)
    np.testing.assert_allclose(np.array(told), np.array(drawn), rtol=1e-3, atol=1e-4)  # beside a pole it falls to 0


def test_a_black_map_is_drawn_evenly_over_the_sphere():
    nodes = sampling.nodes(np.zeros((HEIGHT, WIDTH), np.float32))
    sine = np.sin(np.pi * (np.arange(HEIGHT) + 0.5) / HEIGHT)
    np.testing.assert_allclose(nodes[1:-1], np.repeat(sine[:, None], WIDTH + 1, axis=1), rtol=SINGLE)
    assert not nodes[[0, -1]].any()


def test_every_wavelength_is_drawn_now_and_then_and_lamps_by_their_light():
    emission = np.zeros((2, len(GRID)))
    emission[0, 10], emission[1, 30] = 1.0, 1.0
    mean = sampling.mean_emission(emission, np.array([[0, 1]]), np.array([[3.0, 1.0]], np.float32))
    assert mean.min() > 0 and mean[10] == pytest.approx(3 * mean[30], rel=5e-3)
    dark = sampling.mean_emission(emission, np.array([[0, 1]]), np.zeros((1, 2), np.float32))
    assert dark[10] == dark[30] > 100 * dark[0]
