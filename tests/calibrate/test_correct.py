import cv2
import numpy as np
import pytest

from calibrate import CalibrateError
from calibrate.chart import AFTER_2014, CLASSIC, ChartReference, chart_reference
from calibrate.correct import apply_matrix, fit_matrix
from calibrate.difference import D65_XYZ, delta_e_2000, lab_from_xyz
from tests.calibrate.rendered import patch_colours

RGB_FROM_XYZ = np.linalg.inv(
    np.array([[0.6369580, 0.1446169, 0.1688810], [0.2627002, 0.6779981, 0.0593017], [0.0, 0.0280727, 1.0609851]])
)
ROUNDING = 1e-9
# A matrix in float32, applied to values near one.
FLOAT32 = 1e-6
LUTHER = np.array([[0.6, 0.3, 0.05], [0.25, 0.8, -0.02], [0.02, -0.1, 0.7]])


@pytest.fixture(scope="module")
def reference() -> ChartReference:
    return chart_reference("BabelColor Average")


@pytest.mark.parametrize("weighting", ["lightness", "linear"])
@pytest.mark.parametrize("white", [None, "patch", "neutrals"])
def test_the_matrix_of_a_luther_camera_is_recovered_exactly(reference, weighting, white):
    camera = 3.7 * reference.XYZ @ LUTHER.T
    fit = fit_matrix(
        camera,
        reference,
        rgb_from_xyz=RGB_FROM_XYZ,
        weighting=weighting,
        white_preserving=white is not None,
        white=white or "patch",
    )
    np.testing.assert_allclose(fit.matrix, RGB_FROM_XYZ @ np.linalg.inv(3.7 * LUTHER), atol=ROUNDING)
    assert fit.delta_e.max() < 1e-6
    assert fit.delta_e_loo.max() < 1e-6


@pytest.mark.parametrize("light", ["A", "D65", "FL2"])
def test_a_preserved_white_comes_out_exactly_as_published(reference, light):
    camera = patch_colours(light)
    fit = fit_matrix(camera, reference, rgb_from_xyz=RGB_FROM_XYZ, white_preserving=True)
    np.testing.assert_allclose(fit.fitted_rgb[CLASSIC.white_patch], fit.target_rgb[CLASSIC.white_patch], atol=ROUNDING)
    assert fit.delta_e[CLASSIC.white_patch] < 1e-6
    neutrals = fit_matrix(camera, reference, rgb_from_xyz=RGB_FROM_XYZ, white_preserving=True, white="neutrals")
    np.testing.assert_allclose(neutrals.fitted_rgb[18:].mean(0), neutrals.target_rgb[18:].mean(0), atol=ROUNDING)


@pytest.mark.parametrize("light", ["A", "D65", "FL2"])
def test_what_is_left_out_is_predicted_worse_on_average(reference, light):
    fit = fit_matrix(patch_colours(light), reference, rgb_from_xyz=RGB_FROM_XYZ)
    assert fit.delta_e_loo.mean() > fit.delta_e.mean()


def test_leave_one_out_is_a_fit_without_that_patch(reference):
    camera = patch_colours("A")
    fit = fit_matrix(camera, reference, rgb_from_xyz=RGB_FROM_XYZ, shading="none")
    kept = np.arange(24) != 7
    solution = np.linalg.solve(camera[kept].T @ camera[kept], camera[kept].T @ reference.XYZ[kept])
    expected = delta_e_2000(lab_from_xyz(camera[7] @ solution), lab_from_xyz(reference.XYZ[7]))
    assert fit.delta_e_loo[7] == pytest.approx(expected, abs=1e-6)


MIXED = np.array([[0.3, 0.1, 0.0], [0.0, 2.0, 0.2], [0.1, 0.0, 40.0]])


@pytest.mark.parametrize("white_preserving", [False, True])
@pytest.mark.parametrize(("shading", "changed"), [("plane", np.diag([0.3, 2.0, 40.0])), ("none", MIXED)])
def test_gains_of_the_camera_and_the_exposure_leave_the_result_unchanged(reference, white_preserving, shading, changed):
    # Without a plane even channels that are mixed do; the plane comes from roots, which mean another thing in other channels.
    camera = patch_colours("A")
    one, other = (
        fit_matrix(c, reference, rgb_from_xyz=RGB_FROM_XYZ, white_preserving=white_preserving, shading=shading)
        for c in (camera, camera @ changed)
    )
    np.testing.assert_allclose(one.fitted_rgb, other.fitted_rgb, atol=ROUNDING)
    np.testing.assert_allclose(one.delta_e_loo, other.delta_e_loo, atol=1e-6)


@pytest.mark.parametrize("white_preserving", [False, True])
def test_light_that_falls_off_across_the_chart_is_told_from_the_camera(reference, white_preserving):
    places = np.stack([np.arange(24) % 6 / 5 - 0.5, np.arange(24) // 6 / 3 - 0.5], axis=-1)
    light = np.exp(places @ [0.3, -0.2])
    exact = fit_matrix(
        reference.XYZ @ LUTHER.T * light[:, None],
        reference,
        rgb_from_xyz=RGB_FROM_XYZ,
        white_preserving=white_preserving,
    )
    np.testing.assert_allclose(exact.shading, light, atol=1e-7)
    np.testing.assert_allclose(exact.matrix, RGB_FROM_XYZ @ np.linalg.inv(LUTHER), atol=1e-6)
    # A real camera: whatever it is, the fall-off changes nothing but the shading.
    camera = patch_colours("A")
    even = fit_matrix(camera, reference, rgb_from_xyz=RGB_FROM_XYZ, white_preserving=white_preserving)
    uneven = fit_matrix(
        camera * light[:, None], reference, rgb_from_xyz=RGB_FROM_XYZ, white_preserving=white_preserving
    )
    np.testing.assert_allclose(uneven.matrix, even.matrix, atol=1e-6)
    np.testing.assert_allclose(uneven.shading, even.shading * light, atol=1e-6)
    plain = fit_matrix(camera * light[:, None], reference, rgb_from_xyz=RGB_FROM_XYZ, shading="none")
    assert plain.delta_e.mean() > even.delta_e.mean()
    assert (plain.shading == 1).all()


@pytest.mark.parametrize("light", ["A", "LED-B3"])
def test_what_a_matrix_misses_of_a_camera_is_hardly_taken_for_a_fall_off(reference, light):
    # A plane fitted together with the matrix reads 2.5 % of fall-off into illuminant A.
    shading = fit_matrix(patch_colours(light), reference, rgb_from_xyz=RGB_FROM_XYZ).shading.reshape(4, 6)
    assert shading[:, -1].mean() / shading[:, 0].mean() == pytest.approx(1, abs=0.015)


def test_a_chart_half_in_shadow_is_warned_about(reference):
    shadow = np.exp(np.arange(24) % 6 / 5)
    fit = fit_matrix(patch_colours("D65") * shadow[:, None], reference, rgb_from_xyz=RGB_FROM_XYZ)
    assert any("the light on the chart differs" in warning for warning in fit.warnings)
    assert fit_matrix(patch_colours("D65"), reference, rgb_from_xyz=RGB_FROM_XYZ).warnings == ()


def test_a_real_camera_under_daylight_fits_as_well_as_the_literature_says(reference):
    # 3×3 fits of the chart under D65 give 0.9 on average over 52 cameras; illuminant A 2.4.
    assert fit_matrix(patch_colours("D65"), reference, rgb_from_xyz=RGB_FROM_XYZ).delta_e.mean() < 1.5
    assert fit_matrix(patch_colours("A"), reference, rgb_from_xyz=RGB_FROM_XYZ).delta_e.mean() < 3.5


def test_colour_differences_are_those_of_an_independent_implementation():
    import colour

    rng = np.random.default_rng(3)
    lab_1 = np.column_stack([rng.uniform(0, 100, 2000), rng.uniform(-90, 90, (2000, 2))])
    lab_2 = np.where(rng.random((2000, 1)) < 0.5, lab_1 + rng.normal(0, 3, (2000, 3)), rng.permutation(lab_1))
    lab_2[:5, 1:] = 0  # greys have no hue
    expected = colour.delta_E(lab_1, lab_2, method="CIE 2000")
    np.testing.assert_allclose(delta_e_2000(lab_1, lab_2), expected, atol=1e-9)
    xyz = rng.uniform(0, 1, (500, 3))
    x, y = 0.3127, 0.3290
    np.testing.assert_allclose(lab_from_xyz(xyz), colour.XYZ_to_Lab(xyz, np.array([x, y])), atol=1e-9)


def test_opposite_hues_differ_the_same_both_ways():
    lab_1, lab_2 = np.array([50.0, 30.0, 0.0]), np.array([50.0, -30.0, 0.0])
    assert delta_e_2000(lab_1, lab_2) == pytest.approx(delta_e_2000(lab_2, lab_1), abs=1e-9)


def test_the_reference_is_the_published_data_adapted_to_d65():
    import colour

    reference = chart_reference()
    assert reference.name == AFTER_2014
    assert reference.names[0] == "dark skin"
    assert reference.names[18].startswith("white")
    published = colour.CCS_COLOURCHECKERS[AFTER_2014]
    xyz = np.array([colour.xyY_to_XYZ(value) for value in published.data.values()])
    white = colour.xyY_to_XYZ([*published.illuminant, 1.0])
    expected = colour.chromatic_adaptation(xyz, white, D65_XYZ, method="Von Kries", transform="Bradford")
    np.testing.assert_allclose(reference.XYZ, expected, atol=ROUNDING)
    # Neutral patches stay nearly neutral, at their published Y.
    assert np.abs(lab_from_xyz(reference.XYZ[18:])[:, 1:]).max() < 4
    assert reference.XYZ[18, 1] == pytest.approx(0.8807, abs=0.02)


def test_an_unknown_edition_is_refused_with_the_known_ones():
    with pytest.raises(CalibrateError, match=r"'ColorChecker SG'.*After November 2014"):
        chart_reference("ColorChecker SG")


def test_a_matrix_is_applied_to_every_pixel_and_missing_pixels_stay_missing():
    rng = np.random.default_rng(0)
    image = rng.random((37, 53, 3)).astype(np.float32)
    image[5, 6] = np.nan
    image[7, 8, 1] = np.nan
    before = image.copy()
    matrix = rng.normal(size=(3, 3))
    result = apply_matrix(image, matrix)
    assert result.dtype == np.float32
    expected = image.astype(np.float64) @ matrix.T
    np.testing.assert_allclose(result, expected, atol=10 * FLOAT32)
    np.testing.assert_array_equal(np.isnan(result), np.isnan(expected))
    np.testing.assert_array_equal(image, before)


def test_the_number_of_threads_does_not_change_a_bit():
    image = np.random.default_rng(1).random((301, 407, 3)).astype(np.float32)
    matrix = np.array([[1.7, -0.4, 0.1], [-0.2, 1.5, -0.3], [0.05, -0.6, 2.1]])
    threads = cv2.getNumThreads()
    try:
        results = []
        for count in (1, 2, 4):
            cv2.setNumThreads(count)
            results.append(apply_matrix(image, matrix).tobytes())
    finally:
        cv2.setNumThreads(threads)
    assert len(set(results)) == 1


def test_views_that_are_not_contiguous_are_read_as_they_look():
    image = np.random.default_rng(2).random((10, 12, 3)).astype(np.float32)
    np.testing.assert_array_equal(apply_matrix(image[::-1, :, ::-1], np.eye(3)), image[::-1, :, ::-1])


def test_a_grey_image_is_refused():
    with pytest.raises(CalibrateError, match=r"expected \(height, width, 3\)"):
        apply_matrix(np.zeros((4, 4), np.float32), np.eye(3))


def test_a_lost_patch_is_refused_by_name(reference):
    camera = patch_colours("A").copy()
    camera[14] = np.nan
    with pytest.raises(CalibrateError, match=r"no finite camera RGB for red"):
        fit_matrix(camera, reference, rgb_from_xyz=RGB_FROM_XYZ)


def test_channels_that_do_not_differ_are_refused(reference):
    with pytest.raises(CalibrateError, match="do not differ"):
        fit_matrix(np.repeat(reference.XYZ[:, 1:2], 3, axis=1), reference, rgb_from_xyz=RGB_FROM_XYZ)


def test_a_white_patch_without_light_is_refused(reference):
    camera = patch_colours("A").copy()
    camera[18] = 0
    with pytest.raises(CalibrateError, match="the white patch reads"):
        fit_matrix(camera, reference, rgb_from_xyz=RGB_FROM_XYZ)


def test_too_few_patches_and_unknown_settings_are_refused(reference):
    camera = patch_colours("A")
    with pytest.raises(CalibrateError, match=r"shape \(23, 3\)"):
        fit_matrix(camera[1:], reference, rgb_from_xyz=RGB_FROM_XYZ)
    with pytest.raises(CalibrateError, match=r"correct\.weighting: 'log'"):
        fit_matrix(camera, reference, rgb_from_xyz=RGB_FROM_XYZ, weighting="log")  # type: ignore[arg-type]
    with pytest.raises(CalibrateError, match=r"correct\.shading: 'cubic'"):
        fit_matrix(camera, reference, rgb_from_xyz=RGB_FROM_XYZ, shading="cubic")  # type: ignore[arg-type]
    with pytest.raises(CalibrateError, match=r"correct\.white: 'grey'"):
        fit_matrix(camera, reference, rgb_from_xyz=RGB_FROM_XYZ, white="grey")  # type: ignore[arg-type]


@pytest.mark.parametrize("exposure", [0.01, 300.0])
def test_a_root_polynomial_means_the_same_at_every_exposure(reference, exposure):
    camera = patch_colours("A")
    fit = fit_matrix(camera, reference, rgb_from_xyz=RGB_FROM_XYZ, model="root-polynomial", shading="none")
    assert fit.matrix.shape == (3, 6)
    image = camera.reshape(4, 6, 3).astype(np.float32)
    once = apply_matrix(image, fit.matrix)
    np.testing.assert_allclose(once.reshape(24, 3), fit.fitted_rgb, atol=1e-5)
    np.testing.assert_allclose(apply_matrix(image * np.float32(exposure), fit.matrix), once * exposure, rtol=1e-4)


def test_a_root_polynomial_is_applied_as_a_slow_loop_does():
    rng = np.random.default_rng(8)
    image = rng.normal(0.3, 0.4, (300, 5, 3)).astype(np.float32)
    image[7, 2, 1] = np.nan
    matrix = rng.normal(size=(3, 6))
    result = apply_matrix(image, matrix)
    for y, x in ((0, 0), (255, 4), (256, 1), (299, 3)):
        r, g, b = (float(v) for v in image[y, x])
        p, q, s = max(r, 0), max(g, 0), max(b, 0)
        expected = matrix @ [r, g, b, (p * q) ** 0.5, (q * s) ** 0.5, (s * p) ** 0.5]
        np.testing.assert_allclose(result[y, x], expected, atol=1e-5)
    assert np.isnan(result[7, 2]).all()


def test_auto_takes_what_predicts_unseen_patches_better(reference):
    luther = fit_matrix(reference.XYZ @ LUTHER.T, reference, rgb_from_xyz=RGB_FROM_XYZ, model="auto")
    assert luther.model == "linear"
    measured = fit_matrix(patch_colours("A"), reference, rgb_from_xyz=RGB_FROM_XYZ, model="auto")
    linear = fit_matrix(patch_colours("A"), reference, rgb_from_xyz=RGB_FROM_XYZ)
    assert (measured.model == "root-polynomial") == (measured.delta_e_loo.mean() < 0.85 * linear.delta_e_loo.mean())
    with pytest.raises(CalibrateError, match=r"correct\.fit: 'cubic'"):
        fit_matrix(patch_colours("A"), reference, rgb_from_xyz=RGB_FROM_XYZ, model="cubic")  # type: ignore[arg-type]


@pytest.mark.parametrize("patch", [1, 7, 18])
def test_glare_on_a_patch_leaves_it_out_and_the_matrix_as_it_was(reference, patch):
    camera = patch_colours("D65")
    shiny = camera.copy()
    shiny[patch] += 0.5 * camera[18]
    clean = fit_matrix(camera, reference, rgb_from_xyz=RGB_FROM_XYZ, shading="none")
    fit = fit_matrix(shiny, reference, rgb_from_xyz=RGB_FROM_XYZ, shading="none")
    assert np.flatnonzero(fit.left_out).tolist() == [patch]
    assert any(f"left out of the fit: {reference.names[patch]}" in warning for warning in fit.warnings)
    # One patch of 24 less: as much as leaving it out changes a clean fit.
    np.testing.assert_allclose(fit.matrix, clean.matrix, atol=0.05 * np.abs(clean.matrix).max())
    kept = fit_matrix(shiny, reference, rgb_from_xyz=RGB_FROM_XYZ, shading="none", spoilt="keep")
    assert not kept.left_out.any()
    assert kept.delta_e.mean() > 1.5 * clean.delta_e.mean()


def test_no_patch_of_a_clean_chart_is_left_out(reference):
    for light in ("A", "D65", "FL2", "LED-B3"):
        fit = fit_matrix(patch_colours(light), reference, rgb_from_xyz=RGB_FROM_XYZ)
        assert not fit.left_out.any()


def test_a_chart_that_something_covers_is_refused(reference):
    covered = patch_colours("D65").reshape(4, 6, 3).copy()
    covered[:, 4:] = 0.4
    with pytest.raises(CalibrateError, match=r"correct\.chart: .*(Photograph it again|photograph the chart again)"):
        fit_matrix(covered.reshape(24, 3), reference, rgb_from_xyz=RGB_FROM_XYZ)
