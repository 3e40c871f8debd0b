"""Truth: the definition of the scaled reflectance uplift, and the exact uplift under D65, which shares no code with it."""

import numpy as np
import pytest

from tests.uplift.lights_for_tests import light
from uplift import UpliftError
from uplift.difference import delta_e_2000
from uplift.pixels import Status, rgb_of, uplift_pixels
from uplift.scaled import uplift_scaled
from uplift.spectrum import illuminant, observer, rgb_space
from uplift.table import build_table

EYES = observer()
SRGB = rgb_space("sRGB")
ROUND_TRIP = 1e-8  # ΔE2000
TWO_SOLVERS = 1e-7  # of the coefficients in nm, whose constant term is some hundreds: rounding of both solutions


def back(result, space=SRGB):
    return rgb_of(result.coefficients, result.scale, result.emission, result.emissions, observer=EYES, space=space)


def test_colours_of_srgb_make_the_round_trip_under_D65():
    rgb = np.random.default_rng(14).random((20, 50, 3)) ** 2 * 30
    result = uplift_scaled(rgb, observer=EYES, space=SRGB)
    assert result.counts[Status.EXACT] == 1000 and result.warnings == ()
    assert delta_e_2000(rgb, back(result), SRGB, white=None).max() < ROUND_TRIP
    np.testing.assert_array_equal(result.scale, 2 * rgb.max(axis=2))
    np.testing.assert_array_equal(result.emissions, [illuminant("D65", EYES)])
    assert not result.emission.any()


def test_the_exact_uplift_under_D65_finds_the_same_spectra():
    rgb = np.random.default_rng(15).random((20, 50, 3)) ** 2
    table = build_table(light("D65"), observer=EYES, space=SRGB, factor=2)  # as scaled has it
    exact = uplift_pixels(rgb, np.zeros((20, 50), int), [table])
    scaled = uplift_scaled(rgb, observer=EYES, space=SRGB)
    np.testing.assert_allclose(scaled.coefficients, exact.coefficients, atol=TWO_SOLVERS)
    np.testing.assert_allclose(scaled.scale, exact.scale, rtol=1e-12)


def test_the_factor_sets_the_scale():
    result = uplift_scaled(np.full((1, 1, 3), 0.3), observer=EYES, space=SRGB, factor=4.0)
    assert result.scale[0, 0] == pytest.approx(1.2)
    np.testing.assert_allclose(back(result), 0.3, rtol=1e-12)


def test_negative_components_count_as_zero_and_are_reported():
    rgb = np.array([[[0.5, 0.4, -0.1], [-1.0, -1.0, -1.0], [0.5, 0.4, 0.0]]])
    result = uplift_scaled(rgb, observer=EYES, space=SRGB)
    np.testing.assert_array_equal(result.status, [[Status.CLOSEST, Status.CLOSEST, Status.EXACT]])
    np.testing.assert_allclose(back(result)[0, 0], [0.5, 0.4, 0.0], atol=1e-10)
    np.testing.assert_array_equal(back(result)[0, 1], 0)
    assert result.largest_shift > 0 and len(result.warnings) == 1


def test_colours_too_saturated_to_be_that_bright_are_reported():
    space = rgb_space("ITU-R BT.2020")
    result = uplift_scaled(np.eye(3).reshape(1, 3, 3), observer=EYES, space=space)
    assert result.counts[Status.CLOSEST] == 3
    assert np.isfinite(result.coefficients).all() and result.largest_shift < 10


def test_black_and_missing_pixels_have_no_radiance():
    rgb = np.array([[[0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0]]], dtype=np.float32)
    result = uplift_scaled(rgb, observer=EYES, space=SRGB)
    np.testing.assert_array_equal(result.status, [[Status.BLACK, Status.MISSING, Status.MISSING]])
    np.testing.assert_array_equal(back(result), 0)


def test_what_is_no_map_or_no_factor_is_refused():
    with pytest.raises(UpliftError, match="expected floats"):
        uplift_scaled(np.zeros((2, 3)), observer=EYES, space=SRGB)
    with pytest.raises(UpliftError, match="more than 1"):
        uplift_scaled(np.zeros((1, 2, 3)), observer=EYES, space=SRGB, factor=1.0)
