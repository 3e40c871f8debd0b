import functools

import cv2
import numpy as np
import pytest

from calibrate import CalibrateError
from calibrate.chart import chart_from_corners, chart_reference, find_chart, measure_patches
from calibrate.chart.gaps import between_gaps
from calibrate.chart.geometry import CLASSIC, box_corners, patch_quads, signed_area
from calibrate.chart.homographies import agreed_homographies
from calibrate.chart.judge import covered
from calibrate.chart.sheets import sheets
from calibrate.chart.views import view_at
from calibrate.correct import fit_matrix
from tests.calibrate.rendered import flat_picture, homography, latlong_picture, patch_colours

# A third of a gap between patches at these sizes; detectors alone are off by several pixels.
CORNER_PX = 0.8
# Noise of 0.003 on a dark patch of 0.02, averaged over a few hundred pixels, and a little blur.
PATCH_ERROR = 0.02
# Patches of 10 to 15 pixels in a map: a dozen samples or two.
MAP_PATCH_ERROR = 0.08

CORNERS = np.array([[200.0, 120.0], [430.0, 150.0], [420.0, 310.0], [190.0, 270.0]])


@functools.cache
def picture(light="A", seed=1):
    return flat_picture(CORNERS, patch_colours(light), seed=seed)


@functools.cache
def environment(**place):
    return latlong_picture(patch_colours("A"), height=512, supersampling=2, **place)


@functools.cache
def corrected(image_key):
    """Fitted colours [24, 3] of the chart in a transformed picture."""
    image = TRANSFORMED[image_key](picture())
    found = find_chart(image, chart_reference("BabelColor Average"))
    patches = measure_patches(image, found.quads)
    fit = fit_matrix(patches.rgb, chart_reference("BabelColor Average"), rgb_from_xyz=np.eye(3))
    return fit.fitted_rgb


TRANSFORMED = {
    "as it is": lambda image: image,
    "a quarter turn": np.rot90,
    "half a turn": lambda image: np.rot90(image, 2),
    "three quarters": lambda image: np.rot90(image, 3),
    "brighter by 300": lambda image: image * np.float32(300),
    "darker by 1e-5": lambda image: image * np.float32(1e-5),
    "other channel gains": lambda image: image * np.array([1.9, 1.0, 1.6], np.float32),
}


@pytest.mark.parametrize("light", ["A", "D65", "FL2"])
def test_the_chart_is_found_to_a_pixel_under_any_light(light):
    found = find_chart(picture(light), chart_reference())
    np.testing.assert_allclose(found.corners, CORNERS, atol=CORNER_PX)
    assert found.score < 5
    assert found.warnings == ()


def test_patches_read_what_was_rendered_within_their_noise():
    image = picture()
    patches = measure_patches(image, find_chart(image).quads)
    np.testing.assert_allclose(patches.rgb, patch_colours("A"), rtol=PATCH_ERROR)
    deviations = (patches.rgb - patch_colours("A")) / patches.noise
    assert 0.5 < np.sqrt((deviations**2).mean()) < 2.0
    assert (patches.lost == 0).all()


@pytest.mark.parametrize("change", list(TRANSFORMED)[1:])
def test_turning_scaling_or_tinting_the_picture_does_not_change_the_corrected_colours(change):
    np.testing.assert_allclose(corrected(change), corrected("as it is"), atol=0.006)


def test_a_mirrored_chart_is_refused_as_mirrored():
    with pytest.raises(CalibrateError, match=r"is mirrored.*Flip the image"):
        find_chart(picture()[:, ::-1])


def test_a_picture_upside_down_is_no_mirrored_one():
    found = find_chart(np.rot90(picture(), 2))
    np.testing.assert_allclose(found.corners, np.array([639, 479]) - CORNERS, atol=CORNER_PX)
    assert signed_area(found.corners) > 0


def test_clutter_without_a_chart_is_refused():
    without = flat_picture(CORNERS + 3000, patch_colours("A"), size=(240, 320))
    with pytest.raises(CalibrateError, match=r"correct\.chart.*corners"):
        find_chart(without)


def test_a_chart_of_other_colours_is_refused_with_its_difference():
    shuffled = np.random.default_rng(5).permutation(patch_colours("A"))
    with pytest.raises(CalibrateError, match=r"correct\.chart"):
        find_chart(flat_picture(CORNERS, shuffled, size=(360, 480)))


def test_an_image_of_nothing_is_refused():
    for nothing in (np.zeros((64, 64, 3), np.float32), np.full((64, 64, 3), np.nan, np.float32)):
        with pytest.raises(CalibrateError, match="no ColorChecker found"):
            find_chart(nothing)
    with pytest.raises(CalibrateError, match="at least 32 pixels"):
        find_chart(np.zeros((8, 8, 3), np.float32))


def test_lost_and_negative_pixels_do_not_hide_the_chart_nor_enter_its_patches():
    image = picture().copy()
    rng = np.random.default_rng(4)
    image[rng.random(image.shape[:2]) < 0.02] = np.nan
    image[rng.random(image.shape[:2]) < 0.02] = -0.01
    before = image.copy()
    found = find_chart(image)
    np.testing.assert_allclose(found.corners, CORNERS, atol=2 * CORNER_PX)
    patches = measure_patches(image, found.quads)
    np.testing.assert_allclose(patches.rgb, patch_colours("A"), rtol=2 * PATCH_ERROR)
    assert 0.005 < patches.lost.mean() < 0.04
    np.testing.assert_array_equal(image, before)


@pytest.mark.parametrize(
    "place",
    [
        {"width_degrees": 30.0},
        {"yaw": -100.0, "pitch": -50.0, "roll": 70.0, "width_degrees": 30.0},
        {"yaw": 100.0, "pitch": 10.0, "width_degrees": 45.0},
    ],
    ids=["below the horizon", "far down and turned", "large"],
)
def test_a_chart_in_a_map_is_found_and_its_patches_follow_the_distortion(place):
    image, corners = environment(**place)
    found = find_chart(image, latlong=True)
    np.testing.assert_allclose(found.corners, corners, atol=CORNER_PX)
    patches = measure_patches(image, found.quads, latlong=True)
    np.testing.assert_allclose(patches.rgb, patch_colours("A"), rtol=MAP_PATCH_ERROR)


def test_a_chart_across_the_seam_is_the_chart_of_the_rolled_map():
    image, corners = environment(width_degrees=30.0)
    to_seam = 1024 - round(corners[:, 0].mean())
    rolled = np.roll(image, to_seam, axis=1)
    found = find_chart(rolled, latlong=True)
    offset = found.corners - (corners + np.array([to_seam, 0]))
    np.testing.assert_allclose(offset - 1024 * np.round(offset / 1024), 0, atol=CORNER_PX)
    # All four corners went to the same side: continuous across the seam.
    assert np.ptp(found.corners[:, 0]) < 200
    patches = measure_patches(rolled, found.quads, latlong=True)
    np.testing.assert_allclose(patches.rgb, patch_colours("A"), rtol=MAP_PATCH_ERROR)


def test_a_view_shows_the_direction_it_looks_at():
    view = view_at(0.7, -0.4, field_of_view=1.0, side=101, map_size=(512, 1024))
    x, y = view.map_points(np.array([50.0, 50.0]))
    assert 2 * np.pi * ((x + 0.5) / 1024 - 0.5) == pytest.approx(0.7)
    assert np.pi / 2 - np.pi * (y + 0.5) / 512 == pytest.approx(-0.4)
    right, down = view.map_points(np.array([60.0, 50.0])), view.map_points(np.array([50.0, 60.0]))
    assert right[0] > x
    assert down[1] > y


def test_a_view_of_a_smooth_map_is_the_map():
    from tests.calibrate.rendered import map_directions

    directions = map_directions(256).astype(np.float32)
    view = view_at(3.0, 0.3, field_of_view=1.2, side=65, map_size=(256, 512))
    shown = view.render(directions)
    shown /= np.linalg.norm(shown, axis=2, keepdims=True)
    # The map holds its own directions; half a degree of a 0.7° grid is interpolation.
    np.testing.assert_allclose(shown[32, 32], view.axes[2], atol=0.01)
    edge = view.axes[2] + view.axes[0] * np.tan(0.6) * 64 / 65
    np.testing.assert_allclose(shown[32, 64], edge / np.linalg.norm(edge), atol=0.01)


def test_four_corners_give_the_quads_of_an_independent_homography():
    found = chart_from_corners(CORNERS)
    lifted = np.concatenate([patch_quads().reshape(-1, 2), np.ones((96, 1))], axis=1)
    mapped = lifted @ homography(box_corners(), CORNERS).T
    np.testing.assert_allclose(found.quads, (mapped[:, :2] / mapped[:, 2:]).reshape(24, 4, 2), atol=1e-3)
    patches = measure_patches(picture(), found.quads)
    np.testing.assert_allclose(patches.rgb, patch_colours("A"), rtol=PATCH_ERROR)


def test_patches_lie_where_the_chart_is_printed():
    quads = patch_quads(1.0)
    np.testing.assert_allclose(quads[0], [[0.25, 0.25], [2.75, 0.25], [2.75, 2.75], [0.25, 2.75]])
    np.testing.assert_allclose(quads[23, 2], np.array(CLASSIC.box) - 0.25)


def test_corners_in_a_wrong_order_are_refused():
    with pytest.raises(CalibrateError, match="anticlockwise"):
        chart_from_corners(CORNERS[::-1])
    with pytest.raises(CalibrateError, match="no convex quadrilateral"):
        chart_from_corners(CORNERS[[0, 2, 1, 3]])
    with pytest.raises(CalibrateError, match="expected four points"):
        chart_from_corners(CORNERS[:3])


def test_a_patch_with_too_few_valid_pixels_is_named():
    image = picture().copy()
    found = chart_from_corners(CORNERS)
    x, y = found.quads[14].mean(axis=0).astype(int)
    image[y - 15 : y + 16, x - 15 : x + 16] = np.nan
    with pytest.raises(CalibrateError, match=r"red has 0 valid of \d+ pixels.*exposure"):
        measure_patches(image, found.quads, names=chart_reference().names)


def test_a_patch_beyond_the_image_is_named():
    found = chart_from_corners(CORNERS - [230, 0])
    with pytest.raises(CalibrateError, match="dark skin reaches beyond the image"):
        measure_patches(picture(), found.quads, names=chart_reference().names)


def test_marked_pixels_count_as_lost_and_outliers_do_not_count():
    rng = np.random.default_rng(8)
    image = (0.5 + 0.01 * rng.standard_normal((40, 40, 3))).astype(np.float32)
    quad = np.array([[[5.0, 5.0], [34.0, 5.0], [34.0, 34.0], [5.0, 34.0]]])
    clean = measure_patches(image, quad)
    image[10:12, 10:20] = 9.0  # a highlight
    lost = np.zeros((40, 40), np.bool_)
    lost[20:25, 5:35] = True
    patches = measure_patches(image, quad, lost=lost)
    np.testing.assert_allclose(patches.rgb, clean.rgb, atol=0.002)
    assert patches.lost[0] == pytest.approx(5 / 30)
    assert patches.pixels[0] == 25 * 30
    assert clean.noise[0] == pytest.approx(np.full(3, 0.01 / 30), rel=0.1)


def test_dependent_samples_enlarge_the_standard_error():
    image = np.random.default_rng(9).random((40, 40, 3)).astype(np.float32)
    quad = np.array([[[5.0, 5.0], [34.0, 5.0], [34.0, 34.0], [5.0, 34.0]]])
    plain = measure_patches(image, quad)
    bayer = measure_patches(image, quad, independent=(0.25, 0.5, 0.25))
    np.testing.assert_allclose(bayer.noise / plain.noise, [[2, np.sqrt(2), 2]], rtol=1e-6)


def test_the_answer_does_not_depend_on_the_number_of_threads_or_on_what_was_searched_before():
    threads = cv2.getNumThreads()
    try:
        found = []
        for count in (1, 3):
            cv2.setNumThreads(count)
            found.append(find_chart(picture("D65")).corners.tobytes())
    finally:
        cv2.setNumThreads(threads)
    assert len(set(found)) == 1


def test_a_chart_whose_first_column_is_beyond_the_border_is_refused():
    with pytest.raises(CalibrateError, match=r"correct\.chart"):
        find_chart(np.ascontiguousarray(picture()[100:330, 225:450]))


@pytest.mark.slow
def test_a_chart_that_is_cut_off_by_the_border_is_refused_in_clutter_too():
    from benchmarks.chart_scenes import scene_without_chart

    scene = scene_without_chart(25)
    assert scene.what == "partial charts"
    with pytest.raises(CalibrateError, match=r"correct\.chart"):
        find_chart(scene.image)


@pytest.mark.parametrize("light", ["A", "D65", "FL2", "LED-B3"])
def test_neighbours_that_read_the_same_are_covered_and_those_of_a_whole_chart_do_not(light):
    patches = patch_colours(light)
    assert covered(patches, chart_reference()) <= 2
    hidden = patches.copy()
    hidden[18:] = [0.2, 0.3, 0.1]
    assert covered(hidden, chart_reference()) == 6
    hidden[20] = np.nan  # parts the row in two
    assert covered(hidden, chart_reference()) == 3


@pytest.mark.slow
def test_a_chart_that_is_partly_covered_is_called_that():
    from benchmarks.chart_scenes import scene_without_chart

    scene = scene_without_chart(30166)
    assert scene.what == "covered charts"
    with pytest.raises(CalibrateError, match=r"6 neighbouring patches.*read the same: something covers them"):
        find_chart(scene.image)


def test_glare_across_the_chart_moves_its_box_by_less_than_half_a_percent():
    height, width = picture().shape[:2]
    y, x = np.mgrid[:height, :width]
    spot = np.exp(-0.5 * ((x - 250) ** 2 + (y - 180) ** 2) / 45**2)
    image = picture() + (0.4 * patch_colours("A")[18].mean() * spot[..., None]).astype(np.float32)
    misses = np.hypot(*(find_chart(image).corners - CORNERS).T)
    # The patches' levels and the outlines of their zones, which glare changes, were off by two percent of the width.
    assert misses.max() < 0.005 * np.hypot(*(CORNERS[1] - CORNERS[0]))


def test_a_box_off_by_a_quarter_of_a_patch_is_drawn_to_the_gaps():
    # In pixels, of which a patch has 33.
    moved = CORNERS + np.array([[8.0, 4.0], [5.0, 7.0], [7.0, 6.0], [5.0, 8.0]])
    drawn = between_gaps(picture("D65"), moved)
    assert drawn is not None
    np.testing.assert_allclose(drawn, CORNERS, atol=CORNER_PX)


def test_where_there_are_no_gaps_no_box_is_drawn():
    noise = np.random.default_rng(6).random((400, 600, 3)).astype(np.float32)
    assert between_gaps(noise, CORNERS) is None
    assert between_gaps(np.full((400, 600, 3), np.nan, np.float32), CORNERS) is None


@pytest.mark.parametrize("pole", [1, 0, -1])
def test_a_sheet_of_a_map_shows_the_directions_it_names(pole):
    from tests.calibrate.rendered import map_directions

    sheet = next(each for each in sheets(map_directions(256).astype(np.float32)) if each.pole == pole)
    height, width = sheet.pixels.shape[:2]
    points = np.random.default_rng(7).uniform([8, 8], [width - 9, height - 9], (200, 2)).round()
    if pole:  # within the cap
        points = points[np.hypot(*(points - sheet.first).T) < 0.95 * sheet.first]
    x, y = points.astype(int).T
    shown = sheet.pixels[y, x] / np.linalg.norm(sheet.pixels[y, x], axis=1, keepdims=True)
    # The map holds its own directions; half a degree of a 0.7° grid is interpolation.
    np.testing.assert_allclose(shown, sheet.directions(points), atol=0.01)


def test_a_homography_through_a_grid_is_exact_and_leaves_strays_out():
    places = np.stack(np.meshgrid(np.arange(6), np.arange(4)), -1).reshape(-1, 2).astype(float)
    truth = np.array([[40.0, 5.0, 100.0], [-3.0, 35.0, 80.0], [0.01, 0.02, 1.0]])
    lifted = np.column_stack([places, np.ones(24)]) @ truth.T
    points = lifted[:, :2] / lifted[:, 2:]
    points[[3, 17]] += 9.0
    solved = agreed_homographies(places, points, np.ones((1, 24), np.bool_))[0]
    np.testing.assert_allclose(solved / solved[2, 2], truth, rtol=1e-6, atol=1e-6)
