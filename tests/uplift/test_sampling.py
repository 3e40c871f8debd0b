"""Truth: `spectra_of`, which takes the same wavelengths for every pixel, and shares no code with this."""

import numpy as np
import pytest

from uplift import UpliftError
from uplift.radiance import spectra_of
from uplift.sampling import radiance_at
from uplift.spectrum import illuminant, observer

EYES = observer()
LIGHTS = np.stack([illuminant("D65", EYES), illuminant("FL11", EYES)])
#: Two ways round the same polynomial.
ROUNDING = 1e-9


def pixels(count=50, seed=4):
    rng = np.random.default_rng(seed)
    at, c0 = rng.uniform(300, 900, count), rng.uniform(-2e-4, 2e-4, count)
    coefficients = np.stack([c0, -2 * c0 * at, rng.uniform(-2, 2, count) + c0 * at**2], axis=-1)
    return coefficients, rng.uniform(0, 100, count), rng.integers(0, 2, count)


def test_every_ray_has_wavelengths_of_its_own():
    parts = pixels()
    asked = np.random.default_rng(5).uniform(350, 820, (50, 4))
    got = radiance_at(*parts, LIGHTS, asked, observer=EYES)
    for p in range(50):
        one = [each[p : p + 1] for each in parts]
        np.testing.assert_allclose(got[p], spectra_of(*one, LIGHTS, asked[p], observer=EYES)[0], rtol=ROUNDING)
    assert not got[(asked < 380) | (asked > 780)].any()
    assert (got[(asked > 380) & (asked < 780)] > 0).all()


def test_the_ends_of_the_grid_belong_to_it_and_what_is_no_number_has_no_radiance():
    parts = pixels(1)
    got = radiance_at(*parts, LIGHTS, np.array([[380.0, 780.0, 379.99, np.nan, np.inf]]), observer=EYES)
    assert (got[0, :2] > 0).all()
    assert not got[0, 2:].any()


def test_black_pixels_have_no_radiance():
    black = np.array([[0.0, 0.0, -np.inf], [0.0, 0.0, 0.0]])
    assert not radiance_at(black, np.zeros(2), np.zeros(2, int), LIGHTS, np.full((2, 3), 500.0), observer=EYES).any()


def test_any_shape_of_pixels_is_kept():
    c, s, k = pixels()
    asked = np.full((5, 10, 4), 555.0)
    got = radiance_at(c.reshape(5, 10, 3), s.reshape(5, 10), k.reshape(5, 10), LIGHTS, asked, observer=EYES)
    assert got.shape == (5, 10, 4)


@pytest.mark.parametrize("asked", [550.0, [550.0], [500.0, 550.0, 600.0]])
def test_one_list_of_wavelengths_for_all_pixels_is_sent_to_the_function_for_it(asked):
    with pytest.raises(UpliftError, match=r"For one list of wavelengths use radiance\.spectra_of"):
        radiance_at(*pixels(), LIGHTS, np.asarray(asked), observer=EYES)
    assert spectra_of(*pixels(), LIGHTS, asked, observer=EYES).shape == (50, np.size(asked))


def test_a_single_pixel_takes_a_list_but_no_bare_number():
    one = [each[0] for each in pixels()]
    got = radiance_at(*one, LIGHTS, np.array([500.0, 550.0]), observer=EYES)
    np.testing.assert_allclose(got, spectra_of(*one, LIGHTS, [500.0, 550.0], observer=EYES), rtol=ROUNDING)
    with pytest.raises(UpliftError, match=r"wavelengths of shape \(\) for pixels of shape \(\)"):
        radiance_at(*one, LIGHTS, np.array(550.0), observer=EYES)


def test_emissions_of_another_grid_are_told_what_brings_them_to_the_observers():
    with pytest.raises(UpliftError, match="measured_emission"):
        radiance_at(*pixels(), LIGHTS[:, :9], np.full((50, 4), 500.0), observer=EYES)
    with pytest.raises(UpliftError, match="measured_emission"):
        spectra_of(*pixels(), LIGHTS[:, :9], [500.0], observer=EYES)


def test_what_does_not_fit_together_is_refused():
    c, s, k = pixels()
    asked = np.full((50, 4), 500.0)
    with pytest.raises(UpliftError, match="disagree"):
        radiance_at(c, s, k, LIGHTS, asked[:7], observer=EYES)
    with pytest.raises(UpliftError, match="disagree"):
        radiance_at(c, s, k.astype(float), LIGHTS, asked, observer=EYES)
    with pytest.raises(UpliftError, match=r"expected \[K, 81\]"):
        radiance_at(c, s, k, LIGHTS[:, :9], asked, observer=EYES)
    with pytest.raises(UpliftError, match="run from 2 to 3"):
        radiance_at(c, s, k + 2 - k.min(), LIGHTS, asked, observer=EYES)
