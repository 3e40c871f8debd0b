"""Truth: the 34 pairs of Sharma, Wu and Dalal (2005), and colour-science."""

import numpy as np
import pytest

from uplift import UpliftError
from uplift.difference import _ciede2000, delta_e_2000
from uplift.spectrum import rgb_space

AS_COLOUR_SCIENCE = 1e-10
PUBLISHED_DIGITS = 5.1e-5

# Sharma, Wu and Dalal (2005), table 1: L1, a1, b1, L2, a2, b2, ΔE00. The pairs around the jumps of the mean hue.
SHARMA = [
    (50.0, 2.6772, -79.7751, 50.0, 0.0, -82.7485, 2.0425),
    (50.0, -1.3802, -84.2814, 50.0, 0.0, -82.7485, 1.0000),
    (50.0, 0.0, 0.0, 50.0, -1.0, 2.0, 2.3669),
    (50.0, 2.49, -0.001, 50.0, -2.49, 0.0009, 7.1792),
    (50.0, 2.49, -0.001, 50.0, -2.49, 0.0010, 7.1792),
    (50.0, 2.49, -0.001, 50.0, -2.49, 0.0011, 7.2195),
    (50.0, -0.001, 2.49, 50.0, 0.0009, -2.49, 4.8045),
    (50.0, -0.001, 2.49, 50.0, 0.0011, -2.49, 4.7461),
    (50.0, 2.5, 0.0, 73.0, 25.0, -18.0, 27.1492),
    (60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644),
    (22.7233, 20.0904, -46.694, 23.0331, 14.973, -42.5619, 2.0373),
    (2.0776, 0.0795, -1.135, 0.9033, -0.0636, -0.5514, 0.9082),
]


@pytest.mark.parametrize("pair", SHARMA)
def test_the_formula_gives_the_published_differences(pair):
    *labs, expected = pair
    assert _ciede2000(*labs) == pytest.approx(expected, abs=PUBLISHED_DIGITS)
    assert _ciede2000(*labs[3:], *labs[:3]) == pytest.approx(expected, abs=PUBLISHED_DIGITS)


@pytest.mark.parametrize("name", ["ITU-R BT.2020", "sRGB"])
def test_dark_colours_are_judged_beside_white_as_colour_science_does(name):
    import colour

    rng = np.random.default_rng(4)
    space = rgb_space(name)
    a = rng.random((40, 50, 3)) ** 3
    b = a * rng.uniform(0.8, 1.2, a.shape) + rng.uniform(0, 0.01, a.shape)
    labs = [colour.XYZ_to_Lab(rgb @ space.xyz_from_rgb.T, space.white_xy) for rgb in (a, b)]
    expected = colour.delta_E(*labs, method="CIE 2000")
    np.testing.assert_allclose(delta_e_2000(a, b, space), expected, atol=AS_COLOUR_SCIENCE)


def test_bright_colours_are_judged_at_the_references_luminance():
    space = rgb_space("sRGB")
    a, b = np.array([[30.0, 20.0, 10.0]]), np.array([[31.0, 20.0, 10.0]])
    Y = float(a[0] @ space.luminance_weights)
    np.testing.assert_allclose(delta_e_2000(a, b, space), delta_e_2000(a / Y, b / Y, space), rtol=1e-9)
    np.testing.assert_allclose(delta_e_2000(a, b, space, white=100.0), delta_e_2000(a / 100, b / 100, space), rtol=1e-9)


def test_without_a_white_scaling_both_maps_changes_nothing():
    rng = np.random.default_rng(5)
    a, b = rng.random((2, 100, 3))
    once = delta_e_2000(a, b, rgb_space("sRGB"), white=None)
    np.testing.assert_allclose(delta_e_2000(a * 1e-6, b * 1e-6, rgb_space("sRGB"), white=None), once, rtol=1e-9)


def test_equal_maps_do_not_differ_and_missing_ones_are_missing():
    space = rgb_space("sRGB")
    a = np.array([[0.0, 0, 0], [1, 2, 3], [-1, 0, 0], [np.nan, 0, 0], [np.inf, 0, 0]], dtype=np.float32)
    for white in (1.0, None):
        found = delta_e_2000(a, a, space, white=white)
        np.testing.assert_array_equal(found, [0, 0, 0, np.nan, np.nan])
    assert np.isnan(delta_e_2000(a[:1], a[1:2], space, white=None))[0]


def test_mismatched_maps_and_impossible_whites_are_refused():
    space = rgb_space("sRGB")
    with pytest.raises(UpliftError, match="shapes"):
        delta_e_2000(np.zeros((2, 3)), np.zeros((3, 3)), space)
    for white in (0.0, -1.0, np.inf):
        with pytest.raises(UpliftError, match="luminance of white"):
            delta_e_2000(np.zeros((2, 3)), np.zeros((2, 3)), space, white=white)
