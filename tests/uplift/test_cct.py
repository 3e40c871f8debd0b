"""CCT and Duv against published values, the Planckian forward model and colour-science."""

import numpy as np
import pytest

from uplift.cct import cct_duv, mccamy, mired, nearest_cct, planck, planckian_uv, xy_of_rgb
from uplift.illuminants import cct_duv_of
from uplift.spectrum import illuminant, observer, rgb_space

# CIE 15 and CIE 015:2018 print whole kelvin; 5 nm sums and rounded tables move them by less than
PUBLISHED_K = 12.0
FORWARD_K = 0.05  # the parabola between entries 0.1 % apart
# colour-science's own round trip is off by 0.13 K at 27 000 K, where its two solutions meet
COLOUR_K = 0.2


@pytest.mark.parametrize(
    ("name", "cct"),
    [
        ("A", 2856), ("D50", 5003), ("D55", 5503), ("D65", 6504), ("D75", 7504),
        ("FL1", 6430), ("FL2", 4230), ("FL3", 3450), ("FL4", 2940), ("FL5", 6350), ("FL6", 4150),
        ("FL7", 6500), ("FL8", 5000), ("FL9", 4150), ("FL10", 5000), ("FL11", 4000), ("FL12", 3000),
        ("LED-B1", 2733), ("LED-B2", 2998), ("LED-B3", 4103), ("LED-B4", 5109), ("LED-B5", 6598),
    ],
)  # fmt: skip
def test_published_ccts_of_cie_illuminants_are_met(name, cct):
    got, _ = cct_duv_of(illuminant(name, observer()), observer())
    assert abs(got - cct) < PUBLISHED_K


def test_duv_of_greenish_lamps_is_positive_and_as_published():
    assert cct_duv_of(illuminant("FL5", observer()), observer())[1] == pytest.approx(0.011, abs=5e-4)
    assert cct_duv_of(illuminant("FL1", observer()), observer())[1] == pytest.approx(0.007, abs=5e-4)
    assert cct_duv_of(illuminant("D65", observer()), observer())[1] == pytest.approx(0.0032, abs=1e-4)


def _off_locus(cct, duv):
    """Chromaticities at a temperature and a distance along the normal of the locus: the definition, run forwards."""
    uv = planckian_uv(cct)
    tangent = planckian_uv(cct * 1.0005) - planckian_uv(cct * 0.9995)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    normal = np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1)
    normal *= np.sign(normal[..., 1:])
    u, v = np.moveaxis(uv + duv[..., np.newaxis] * normal, -1, 0)
    scale = 2.0 * u - 8.0 * v + 4.0
    return np.stack([3.0 * u / scale, 2.0 * v / scale], axis=-1)


def test_cct_and_duv_of_points_made_from_them_come_back():
    rng = np.random.default_rng(1)
    # on entries of the table the locus and its normal are known exactly
    cct = 1000.0 * 1.001 ** rng.integers(20, 3380, 500)
    duv = rng.uniform(-0.03, 0.03, 500)
    got_cct, got_duv = cct_duv(_off_locus(cct, duv))
    slack = 3e-4  # of the normal, which is a difference here
    np.testing.assert_allclose(got_cct, cct, rtol=slack)
    np.testing.assert_allclose(got_duv, duv, atol=2e-6)


def test_colour_science_agrees_from_1000_to_30000_kelvin():
    import colour
    from colour.temperature import CCT_to_uv_Ohno2013, uv_to_CCT_Ohno2013

    rng = np.random.default_rng(2)
    cct = np.geomspace(1002.0, 29_990.0, 60)
    duv = rng.uniform(-0.03, 0.03, 60)
    duv[::4] *= 0.03
    uv = np.array([CCT_to_uv_Ohno2013(pair) for pair in zip(cct, duv, strict=True)])
    got_cct, got_duv = cct_duv(colour.UCS_uv_to_xy(uv))
    assert np.abs(got_cct - cct).max() < FORWARD_K
    assert np.abs(got_duv - duv).max() < 1e-6
    theirs = uv_to_CCT_Ohno2013(uv)
    assert np.abs(got_cct - theirs[:, 0]).max() < COLOUR_K


def test_black_bodies_lie_on_the_locus_up_to_100000_kelvin():
    wide = observer(360, 780, 1)
    for kelvin in (1000.0, 2856.0, 30_000.0, 100_000.0):
        cct, duv = cct_duv_of(planck(wide.wavelengths_nm, kelvin), wide)
        assert cct == pytest.approx(kelvin, rel=1e-5)
        assert abs(duv) < 1e-6


def test_undefined_ccts_are_nan_in_both_numbers():
    cct, duv = cct_duv([[0.2, 0.2], [0.7, 0.25], [0.3, 0.6], [np.nan, 0.3], [0.24, 0.2342], [0.6650, 0.3350]])
    assert np.isnan(cct).all()
    assert np.isnan(duv).all()


def test_shapes_pass_through():
    xy = np.full((3, 4, 2), 1 / 3)
    assert cct_duv(xy)[0].shape == (3, 4)
    assert cct_duv(xy[0, 0])[0].shape == ()
    assert cct_duv(np.empty((0, 2)))[0].shape == (0,)
    assert xy_of_rgb(np.ones((2, 5, 3)), np.eye(3)).shape == (2, 5, 2)


def test_mccamy_is_off_as_its_critics_say():
    kelvin = np.array([6500.0, 10_000.0, 20_000.0])
    uv = planckian_uv(kelvin)
    scale = 2.0 * uv[:, 0] - 8.0 * uv[:, 1] + 4.0
    xy = np.stack([3.0 * uv[:, 0] / scale, 2.0 * uv[:, 1] / scale], axis=1)
    np.testing.assert_allclose(mccamy(xy) - kelvin, [0.0, -118.0, -2883.0], atol=5.0)


def test_white_of_a_d65_space_has_the_cct_of_d65():
    space = rgb_space("ITU-R BT.2020")
    cct, _ = cct_duv(xy_of_rgb([1.0, 1.0, 1.0], space.xyz_from_rgb))
    assert cct == pytest.approx(cct_duv_of(illuminant("D65", observer()), observer())[0], abs=1e-6)


def test_colours_without_light_have_no_chromaticity():
    assert np.isnan(xy_of_rgb([[0.0, 0.0, 0.0], [np.nan, 1.0, 1.0]], np.eye(3))).all()


def test_the_nearest_cct_answers_where_there_is_none():
    assert nearest_cct([0.24, 0.2342])[0] == pytest.approx(100_000.0, rel=0.02)
    cct, duv = nearest_cct([0.3, 0.6])
    assert 1000 <= cct <= 100_000
    assert duv > 0.05
    assert np.isnan(nearest_cct([np.nan, np.nan])[0])
    assert nearest_cct([0.3127, 0.3290])[0] == pytest.approx(float(cct_duv([0.3127, 0.3290])[0]))


def test_mired_is_reciprocal():
    assert mired(4000.0) == pytest.approx(250.0)
