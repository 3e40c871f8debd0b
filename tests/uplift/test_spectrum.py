"""Truth: the tables of the CIE as colour-science publishes them, and identities of linear algebra."""

import re

import numpy as np
import pytest

from uplift import UpliftError
from uplift.spectrum import RGB_SPACES, illuminant, normalised, observer, rgb_space, rgb_weights, xyz_of

ROUNDING = 1e-12  # a few hundred float64 operations on numbers near one
PUBLISHED_WHITE = 1e-4  # the standards round D65 and D50 to four digits, and 5 nm sums differ in the fifth


def test_the_observer_samples_the_published_functions():
    eyes = observer()
    assert eyes.wavelengths_nm[0] == 380 and eyes.wavelengths_nm[-1] == 780 and eyes.cmfs.shape == (81, 3)
    assert eyes.step_nm == 5
    np.testing.assert_allclose(eyes.cmfs[(555 - 380) // 5], [0.5120501, 1.0, 0.005749999], atol=1e-9)  # CIE 018:2019
    assert observer() is observer(380, 780, 5)
    assert rgb_space("sRGB") is rgb_space("sRGB", observer=observer())


def test_half_nanometres_are_interpolated():
    coarse, fine = observer(400, 700, 1), observer(400, 700, 0.5)
    np.testing.assert_allclose(fine.cmfs[1::2], (coarse.cmfs[1:] + coarse.cmfs[:-1]) / 2, atol=ROUNDING)


def test_observers_and_spaces_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        observer().cmfs[0, 0] = 1
    with pytest.raises(ValueError, match="read-only"):
        rgb_space("sRGB").xyz_from_rgb[0, 0] = 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((780, 380, 5), "empty"),
        ((380, 780, -5), "empty"),
        ((380, 780, 7), "does not end on its stop"),
        ((300, 780, 5), "leaves the range"),
        ((380, 780, 5, "Observer of nobody"), "unknown"),
    ],
)
def test_impossible_grids_are_refused(arguments, message):
    with pytest.raises(UpliftError, match=message):
        observer(*arguments)


@pytest.mark.parametrize("name", RGB_SPACES)
def test_matrices_agree_with_colour_science_up_to_the_rounded_white(name):
    import colour

    space, published = rgb_space(name), colour.RGB_COLOURSPACES[name]
    np.testing.assert_allclose(space.white_xy, published.whitepoint, atol=PUBLISHED_WHITE)
    np.testing.assert_allclose(space.primaries_xy, published.primaries, atol=ROUNDING)
    derived = colour.normalised_primary_matrix(published.primaries, space.white_xy)
    np.testing.assert_allclose(space.xyz_from_rgb, derived, atol=ROUNDING)
    np.testing.assert_allclose(space.rgb_from_xyz @ space.xyz_from_rgb, np.eye(3), atol=ROUNDING)
    assert space.luminance_weights.sum() == pytest.approx(1, abs=ROUNDING)


@pytest.mark.parametrize("name", ["ITU-R BT.2020", "sRGB", "P3-D65"])
def test_the_spectrum_of_D65_is_the_white_of_its_spaces(name):
    eyes = observer()
    np.testing.assert_allclose(
        rgb_weights(illuminant("D65", eyes), eyes, rgb_space(name)).sum(axis=1), 1, atol=ROUNDING
    )


def test_the_white_follows_the_observer():
    eyes = observer(380, 780, 10, "CIE 1964 10 Degree Standard Observer")
    space = rgb_space("sRGB", observer=eyes)
    np.testing.assert_allclose(rgb_weights(illuminant("D65", eyes), eyes, space).sum(axis=1), 1, atol=ROUNDING)


@pytest.mark.parametrize(
    ("name", "xy"),  # CIE 015:2018, tables 5 and 12.1: published chromaticities, 2 degrees
    [
        ("A", (0.44758, 0.40745)),
        ("D65", (0.31272, 0.32903)),
        ("FL2", (0.3721, 0.3751)),
        ("FL11", (0.3805, 0.3769)),
    ],
)
def test_illuminants_have_their_published_chromaticity(name, xy):
    XYZ = xyz_of(illuminant(name, observer()), observer())
    assert XYZ[1] == pytest.approx(1, abs=ROUNDING)
    np.testing.assert_allclose(XYZ[:2] / XYZ.sum(), xy, atol=PUBLISHED_WHITE)


def test_weights_turn_reflectances_into_rgb():
    eyes, space = observer(), rgb_space("ITU-R BT.2020")
    reflectance = np.random.default_rng(1).random(81)
    emission = normalised(7.5 * illuminant("FL2", eyes), eyes)
    rgb = space.rgb_from_xyz @ xyz_of(emission * reflectance, eyes)
    np.testing.assert_allclose(rgb_weights(emission, eyes, space) @ reflectance, rgb, atol=ROUNDING)


def test_normalising_works_in_any_unit():
    eyes = observer()
    emission = illuminant("A", eyes)
    for unit in (1e-300, 1e300):
        np.testing.assert_allclose(normalised(emission * unit, eyes), emission, rtol=ROUNDING)


@pytest.mark.parametrize(
    ("emission", "message"),
    [
        (np.ones(80), "resample"),
        (np.full(81, -1.0), "380 nm"),
        (np.full(81, np.nan), "not finite"),
        (np.zeros(81), "Y = 0"),
    ],
)
def test_what_is_no_light_is_refused(emission, message):
    with pytest.raises(UpliftError, match=message):
        normalised(emission, observer())


def test_unknown_names_and_wrong_lengths_are_refused():
    with pytest.raises(UpliftError, match=r"ITU-R BT\.2020"):
        rgb_space("ProFoto")
    with pytest.raises(UpliftError, match="D65"):
        illuminant("D6500", observer())
    with pytest.raises(UpliftError, match="last axes"):
        xyz_of(np.ones((2, 80)), observer())


@pytest.mark.parametrize(
    ("asked", "meant"),
    [
        ("srgb", "sRGB"),
        ("Rec2020", "ITU-R BT.2020"),
        ("Rec.2020", "ITU-R BT.2020"),
        ("BT.2020", "ITU-R BT.2020"),
        ("linear Rec.709", "sRGB"),
        ("Display P3", "P3-D65"),
        ("acescg", "ACEScg"),
        ("ACES 2065-1", "ACES2065-1"),
        ("AdobeWideGamut", "Adobe Wide Gamut RGB"),
    ],
)
def test_a_misspelt_space_is_told_the_one_that_is_meant(asked, meant):
    with pytest.raises(
        UpliftError, match=re.escape(f"did you mean {meant!r}? Expected one of {', '.join(RGB_SPACES)}")
    ):
        rgb_space(asked)


def test_a_space_that_is_like_none_gets_no_guess():
    with pytest.raises(UpliftError, match="'film' is unknown; expected one of"):
        rgb_space("film")


def test_an_emission_of_another_length_is_told_what_brings_it_to_the_grid():
    with pytest.raises(
        UpliftError, match=r"resample it first: illuminants\.measured_emission\(wavelengths_nm, power, observer\)"
    ):
        normalised(np.ones(31), observer())
