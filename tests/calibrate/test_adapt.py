import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibrate import CalibrateError
from calibrate.adapt import CONE_FROM_XYZ, TRANSFORMS, cone_matrix, von_kries_matrix

# IEC 61966-2-1 matrix, written out: the tests need some working space, not a certain one.
XYZ_FROM_RGB = np.array(
    [[0.4123908, 0.3575843, 0.1804808], [0.2126390, 0.7151687, 0.0721923], [0.0193308, 0.1191948, 0.9505322]]
)
ROUNDING = 1e-12

whites = st.lists(st.floats(0.2, 5.0), min_size=3, max_size=3).map(np.array)


@pytest.mark.parametrize("transform", TRANSFORMS)
@settings(deadline=None, max_examples=30)
@given(source=whites, destination=whites)
def test_the_source_comes_out_as_the_destination_in_every_space(transform, source, destination):
    matrix = von_kries_matrix(source, destination, transform=transform, xyz_from_rgb=XYZ_FROM_RGB)
    np.testing.assert_allclose(matrix @ source, destination, rtol=0, atol=ROUNDING * 100)


@pytest.mark.parametrize("transform", TRANSFORMS)
def test_a_source_that_is_the_destination_changes_nothing(transform):
    white = np.array([0.9, 1.1, 0.7])
    matrix = von_kries_matrix(white, white, transform=transform, xyz_from_rgb=XYZ_FROM_RGB)
    np.testing.assert_allclose(matrix, np.eye(3), atol=ROUNDING)


@pytest.mark.parametrize("transform", TRANSFORMS)
def test_there_and_back_is_the_identity(transform):
    warm, white = np.array([1.6, 0.9, 0.4]), np.ones(3)
    there = von_kries_matrix(warm, white, transform=transform, xyz_from_rgb=XYZ_FROM_RGB)
    back = von_kries_matrix(white, warm, transform=transform, xyz_from_rgb=XYZ_FROM_RGB)
    np.testing.assert_allclose(back @ there, np.eye(3), atol=ROUNDING)


@pytest.mark.parametrize("transform", TRANSFORMS)
def test_keeping_luminance_changes_the_chromaticity_alone(transform):
    source = np.array([3.2, 1.8, 0.8])
    matrix = von_kries_matrix(source, np.ones(3), transform=transform, xyz_from_rgb=XYZ_FROM_RGB, luminance="keep")
    adapted = matrix @ source
    assert adapted == pytest.approx(np.full(3, XYZ_FROM_RGB[1] @ source), abs=ROUNDING * 10)


def test_the_rgb_space_is_a_plain_white_balance():
    matrix = von_kries_matrix(np.array([2.0, 1.0, 0.5]), np.ones(3), transform="RGB", xyz_from_rgb=XYZ_FROM_RGB)
    np.testing.assert_allclose(matrix, np.diag([0.5, 1.0, 2.0]), atol=ROUNDING)


@pytest.mark.parametrize("transform", list(CONE_FROM_XYZ))
def test_the_matrices_are_the_published_ones(transform):
    import colour

    expected = colour.CHROMATIC_ADAPTATION_TRANSFORMS[transform]
    np.testing.assert_allclose(CONE_FROM_XYZ[transform], expected, atol=ROUNDING)
    xyz_source, xyz_white = XYZ_FROM_RGB @ [1.6, 0.9, 0.4], XYZ_FROM_RGB @ np.ones(3)
    theirs = colour.adaptation.matrix_chromatic_adaptation_VonKries(xyz_source, xyz_white, transform=transform)
    ours = von_kries_matrix(np.array([1.6, 0.9, 0.4]), np.ones(3), transform=transform, xyz_from_rgb=XYZ_FROM_RGB)
    np.testing.assert_allclose(XYZ_FROM_RGB @ ours @ np.linalg.inv(XYZ_FROM_RGB), theirs, atol=1e-10)


def test_an_unknown_space_is_refused_with_the_known_ones():
    with pytest.raises(CalibrateError, match=r"'CAT97'.*CAT16, Bradford.*balance\.transform"):
        cone_matrix("CAT97", XYZ_FROM_RGB)


@pytest.mark.parametrize("source", [[0.0, 0.0, 0.0], [0.1, 0.1, -2.0], [np.nan, 1.0, 1.0]])
def test_a_white_without_positive_cones_is_refused_naming_the_space(source):
    with pytest.raises(CalibrateError, match=r"source .*'Bradford'.*balance\.lamp"):
        von_kries_matrix(np.array(source), np.ones(3), transform="Bradford", xyz_from_rgb=XYZ_FROM_RGB)


def test_an_unknown_handling_of_luminance_is_refused():
    with pytest.raises(CalibrateError, match=r"balance\.luminance: 'both'"):
        von_kries_matrix(np.ones(3), np.ones(3), xyz_from_rgb=XYZ_FROM_RGB, luminance="both")  # type: ignore[arg-type]


def test_a_white_without_luminance_cannot_keep_it():
    # All channels positive, but a space whose luminance counts one of them negatively.
    odd_space = XYZ_FROM_RGB * np.array([[1.0], [-1.0], [1.0]])
    with pytest.raises(CalibrateError, match=r"must be positive to be kept"):
        von_kries_matrix(np.ones(3), np.ones(3), transform="RGB", xyz_from_rgb=odd_space, luminance="keep")
