"""The camera's noise, clipping and mosaic against the model that they claim."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from samples import Camera, expose, spectra
from samples.sensor import bayer, colour_matrix, hot_pixels, poisson, uniform

CLEAN = Camera(hot_pixels=0)
SECOND = Fraction(1)


@pytest.mark.parametrize("mean", [0.3, 5.0, 63.0, 65.0, 300.0, 4000.0, 49000.0])
def test_photon_numbers_are_quantiles_of_poisson(mean: float) -> None:
    from scipy.stats import poisson as exact

    chance = uniform((1, 2), 20000)
    found = poisson(np.full(20000, mean), chance)
    expected = exact.ppf(chance, mean)
    # The expansion may round to the neighbouring integer.
    assert np.abs(found - expected).max() <= (0.0 if mean < 64.0 else 1.0)
    assert np.mean(found != expected) < 0.02


@pytest.mark.parametrize("filled", [0.0, 1e-4, 0.003, 0.1, 0.8])
def test_mean_and_variance_of_counts_follow_photons_and_reading(filled: float) -> None:
    pixels = 256 * 512
    counts = expose(np.full((256, 512, 3), filled), SECOND, camera=CLEAN).astype(float)
    electrons = filled * (CLEAN.white_dn - 512) * CLEAN.gain_e_per_dn
    variance = (electrons + CLEAN.read_noise_e**2) / CLEAN.gain_e_per_dn**2 + 1.0 / 12.0  # rounding
    # Four standard errors of a mean and of a variance.
    assert counts.mean() - 512.0 == pytest.approx(electrons / CLEAN.gain_e_per_dn, abs=4 * np.sqrt(variance / pixels))
    assert counts.var() == pytest.approx(variance, rel=4 * np.sqrt(2.0 / pixels))


def test_frames_have_noise_of_their_own_and_seeds_repeat_it() -> None:
    rgb = np.full((16, 16, 3), 0.1)
    first = expose(rgb, SECOND, camera=CLEAN, seed=1, frame=0)
    np.testing.assert_array_equal(first, expose(rgb, SECOND, camera=CLEAN, seed=1, frame=0))
    assert (first != expose(rgb, SECOND, camera=CLEAN, seed=1, frame=1)).mean() > 0.9
    assert (first != expose(rgb, SECOND, camera=CLEAN, seed=2, frame=0)).mean() > 0.9


def test_the_random_numbers_are_the_same_with_every_numpy() -> None:
    # PCG64 (O'Neill 2014) and SeedSequence are fixed algorithms; these are their first raw bits for this seed.
    raw = np.random.PCG64(np.random.SeedSequence((3, 4))).random_raw(2)
    np.testing.assert_array_equal(uniform((3, 4), 2), [(int(n) // 2048 + 0.5) / 2**53 for n in raw])
    np.testing.assert_allclose(uniform((20260101,), 1), [0.2323], atol=5e-6)


def test_a_bright_pixel_clips_at_white_and_a_noise_free_one_is_rounded() -> None:
    still = replace(CLEAN, noise=False, black_dn=(500, 510, 520, 530))
    assert (expose(np.full((4, 4, 3), 3.0), SECOND, camera=still) == still.white_dn).all()
    dark = expose(np.zeros((4, 4, 3)), SECOND, camera=still)
    np.testing.assert_array_equal(dark, np.tile([[500, 510], [520, 530]], (2, 2)))
    half = expose(np.full((2, 2, 3), 0.5), SECOND, camera=still)
    np.testing.assert_array_equal(half, np.floor(np.array([[500, 510], [520, 530]]) * 0.5 + 16383 * 0.5 + 0.5))


@pytest.mark.parametrize("cfa", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_a_mosaic_holds_the_named_colour_at_every_place(cfa: str) -> None:
    rgb = np.random.default_rng(0).random((4, 6, 3))
    mosaic = bayer(rgb, cfa)
    for y in range(4):
        for x in range(6):
            assert mosaic[y, x] == rgb[y, x, "RGB".index(cfa[2 * (y % 2) + x % 2])]


def test_hot_pixels_stay_where_they_are() -> None:
    leak = hot_pixels(Camera(), (100, 200), 5)
    assert 30 <= np.count_nonzero(leak) <= Camera().hot_pixels
    np.testing.assert_array_equal(leak, hot_pixels(Camera(), (100, 200), 5))


def test_equal_energy_at_the_saturation_exposure_fills_the_green_channel() -> None:
    camera = Camera()
    flat = spectra.of_luminance_one(np.ones(81)) * camera.white_luminance_s
    assert camera.responses[1] @ flat == pytest.approx(1.0, rel=1e-12)


def test_the_colour_matrix_maps_the_white_near_the_cameras_own() -> None:
    light = spectra.lamp("D65")
    camera = Camera()
    white = colour_matrix() @ spectra.xyz_of(light)
    # A camera is no colorimeter: its matrix misses white by some per cent.
    np.testing.assert_allclose(white / white.max(), camera.white_balance(light), atol=0.05)
