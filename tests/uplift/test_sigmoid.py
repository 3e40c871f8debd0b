"""Truth: the formulas of Jakob and Hanika (2019), finite differences, and the inverse of each conversion."""

import numpy as np
import pytest

from uplift.newton import integrals, solve
from uplift.sigmoid import (
    coefficients_in_nm,
    coefficients_in_t,
    grey,
    normalisation,
    normalised_wavelengths,
    reflectance,
    sigmoid,
)
from uplift.spectrum import illuminant, observer, rgb_space, rgb_weights

ROUNDING = 1e-13  # the polynomial in nm cancels terms some hundred times its value
SLOPE = 1e-8  # central differences with a step of 1e-5


@pytest.fixture(scope="module")
def weights():
    eyes = observer()
    return rgb_weights(illuminant("FL2", eyes), eyes, rgb_space("ITU-R BT.2020"))


def test_the_grid_spans_minus_one_to_one():
    t = normalised_wavelengths(observer())
    assert t[0] == -1 and t[-1] == 1 and abs(t[40]) < 1e-15


def test_conversions_undo_each_other_and_keep_the_reflectance():
    rng = np.random.default_rng(2)
    a, b = normalisation(observer())
    c = rng.normal(size=(50, 3)) * 5
    in_nm = coefficients_in_nm(c, a, b)
    np.testing.assert_allclose(coefficients_in_t(in_nm, a, b), c, rtol=1e-11, atol=1e-11)
    wavelengths = np.array([400.0, 555.5, 800.0])
    t = (wavelengths - a) * b
    expected = 0.5 + (x := c[:, :1] * t**2 + c[:, 1:2] * t + c[:, 2:]) / (2 * np.sqrt(1 + x**2))
    np.testing.assert_allclose(reflectance(in_nm, wavelengths), expected, atol=ROUNDING)


def test_grey_is_constant_and_black_and_white_are_its_limits():
    v = np.array([0.0, 1e-6, 0.25, 0.5, 0.999, 1.0])
    c = grey(v)
    assert c[0, 2] == -np.inf and c[-1, 2] == np.inf
    np.testing.assert_allclose(reflectance(c, [380, 555, 780]), np.repeat(v[:, None], 3, axis=1), rtol=1e-9)
    a, b = normalisation(observer())
    np.testing.assert_array_equal(coefficients_in_nm(c[1:-1], a, b), c[1:-1])


def test_the_sigmoid_keeps_relative_precision_in_the_dark():
    x = np.array([-1e8, -1e12, -np.inf, np.inf, 0.0])
    np.testing.assert_allclose(sigmoid(x), [2.5e-17, 2.5e-25, 0.0, 1.0, 0.5], rtol=1e-12)


def test_the_integrals_are_the_slow_sums_and_their_slopes(weights):
    t = normalised_wavelengths(observer())
    c = np.array([1.5, -0.7, -0.3])

    def slow(c):
        total = np.zeros(3)
        for k in range(t.size):
            x = c[0] * t[k] ** 2 + c[1] * t[k] + c[2]
            total += weights[:, k] * (0.5 + x / (2 * np.sqrt(1 + x * x)))
        return total

    found = np.array(integrals(weights, t, 0.0, *c))
    np.testing.assert_allclose(found[:3], slow(c), atol=ROUNDING)
    for i in range(3):
        step = np.zeros(3)
        step[i] = 1e-5
        slope = (slow(c + step) - slow(c - step)) / 2e-5
        np.testing.assert_allclose(found[3:].reshape(3, 3)[:, i], slope, atol=SLOPE)


def test_solving_finds_the_reflectance_behind_a_colour(weights):
    t = normalised_wavelengths(observer())
    truth = np.array([2.0, 1.0, -0.5])
    g = integrals(weights, t, 0.0, *truth)[:3]
    *c, error = solve(weights, t, 0.0, *g, 0.0, 0.0, 0.0, 1e-15, 50)
    np.testing.assert_allclose(c, truth, atol=1e-11)
    assert error < 1e-14


def test_solving_an_impossible_colour_reports_its_error(weights):
    t = normalised_wavelengths(observer())
    *_, error = solve(weights, t, 0.0, -1.0, 0.5, 0.5, 0.0, 0.0, 0.0, 1e-15, 50)
    assert error > 0.1
