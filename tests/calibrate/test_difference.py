"""Colour differences of patches, against the published pairs and the definition of CIELAB."""

import numpy as np
import pytest

from calibrate.difference import D65_XYZ, delta_e_2000, lab_from_xyz

#: The table has four digits.
PUBLISHED = 5e-5


@pytest.mark.parametrize(
    ("first", "second", "difference"),
    [
        # Sharma, Wu and Dalal 2005, table 1: pairs 1, 7, 9, 17 and 25.
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, 0.0, 0.0), (50.0, -1.0, 2.0), 2.3669),
        ((50.0, 2.49, -0.001), (50.0, -2.49, 0.0009), 7.1792),
        ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ],
)
def test_the_published_pairs_come_out(first: tuple[float, ...], second: tuple[float, ...], difference: float) -> None:
    assert delta_e_2000(np.array(first), np.array(second)) == pytest.approx(difference, abs=PUBLISHED)
    assert delta_e_2000(np.array([second]), np.array([first])) == pytest.approx([difference], abs=PUBLISHED)


def test_white_and_black_are_where_cielab_puts_them() -> None:
    np.testing.assert_allclose(lab_from_xyz(np.array([D65_XYZ, 0 * D65_XYZ])), [[100, 0, 0], [0, 0, 0]], atol=1e-12)


def test_what_lies_below_black_keeps_its_order() -> None:
    below = lab_from_xyz(np.array([-0.02, -0.01, 0.0, 0.01])[:, np.newaxis] * D65_XYZ)[:, 0]
    assert np.all(np.diff(below) > 0)
    assert np.isfinite(delta_e_2000(lab_from_xyz(-0.01 * D65_XYZ), lab_from_xyz(0.01 * D65_XYZ)))


def test_a_missing_colour_stays_missing() -> None:
    assert np.isnan(delta_e_2000(np.array([np.nan, 0, 0]), np.array([50.0, 0, 0])))
