"""Rounding three coefficients together keeps the colour; rounding them one by one is what it is compared with."""

import numpy as np
import pytest

from uplift import UpliftError
from uplift.difference import delta_e_2000
from uplift.radiance import rgb_of
from uplift.spectrum import illuminant, observer, rgb_space
from uplift.storage import stored_coefficients

EYES = observer()
SPACE = rgb_space("ITU-R BT.2020")
LIGHT = illuminant("D65", EYES)[None]
#: ΔE2000 of a peak a few nanometres wide from 32 bits; one by one its coefficients give more than 0.3.
OF_PEAKS = 0.08
#: ΔE2000 of a smooth reflectance from 32 bits.
OF_SMOOTH = 1.5e-4


def peaks(count=400, seed=1):
    """Coefficients [count, 3] of peaks 3 to 20 nm wide, none of them higher than the sigmoid's steep part."""
    rng = np.random.default_rng(seed)
    at, width, height = rng.uniform(430, 680, count), rng.uniform(3, 20, count), rng.uniform(-1, 2, count)
    c0 = -4 / width**2
    return np.stack([c0, -2 * c0 * at, height + c0 * at**2], axis=-1)


def smooth(count=400, seed=2):
    rng = np.random.default_rng(seed)
    at, c0, height = rng.uniform(300, 900, count), rng.uniform(-2e-4, 2e-4, count), rng.uniform(-2, 2, count)
    return np.stack([c0, -2 * c0 * at, height + c0 * at**2], axis=-1)


def moved(before, after):
    ones, first = np.ones(len(before)), np.zeros(len(before), int)
    rgb = [rgb_of(c, ones, first, LIGHT, observer=EYES, space=SPACE) for c in (before, np.asarray(after, np.float64))]
    return delta_e_2000(*rgb, SPACE, white=None)


def test_narrow_peaks_keep_their_colour_where_rounding_one_by_one_loses_it():
    coefficients = peaks()
    together = stored_coefficients(coefficients, observer=EYES)
    assert together.dtype == np.float32 and together.shape == coefficients.shape
    assert moved(coefficients, together).max() < OF_PEAKS
    assert moved(coefficients, coefficients.astype(np.float32)).max() > 4 * OF_PEAKS


def test_smooth_reflectances_come_off_no_worse_than_one_by_one():
    coefficients = smooth()
    together = moved(coefficients, stored_coefficients(coefficients, observer=EYES))
    assert together.max() < OF_SMOOTH
    assert together.mean() < moved(coefficients, coefficients.astype(np.float32)).mean()


def test_what_float32_holds_already_stays():
    grey = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.25], [0.0, 0.0, -np.inf], [0.0, 0.5, 2.0]])
    np.testing.assert_array_equal(stored_coefficients(grey, observer=EYES), grey)


def test_neighbours_do_not_matter():
    coefficients = np.concatenate([peaks(), smooth()])
    whole = stored_coefficients(coefficients, observer=EYES)
    np.testing.assert_array_equal(stored_coefficients(coefficients[::-7], observer=EYES), whole[::-7])
    np.testing.assert_array_equal(
        stored_coefficients(coefficients.reshape(2, -1, 3), observer=EYES).reshape(-1, 3), whole
    )


def test_what_is_no_coefficients_is_refused():
    with pytest.raises(UpliftError, match=r"shape \(4,\); expected"):
        stored_coefficients(np.zeros(4), observer=EYES)
