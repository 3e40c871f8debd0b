"""Other charts than one Classic: the Digital SG, other proportions of patch and gap, several in one picture."""

import functools

import numpy as np
import pytest

from benchmarks.chart_kinds import PARTS, scene_with_passport, scene_with_sg, scene_with_two, sg_reflectances
from benchmarks.chart_scenes import patch_colours
from calibrate import CalibrateError
from calibrate.chart import (
    CLASSIC_ON_SG,
    SG,
    SG_AFTER_2014,
    chart_from_corners,
    chart_reference,
    find_chart,
    find_charts,
    measure_patches,
    measured_reference,
    other_charts,
)
from calibrate.correct import fit_matrix
from calibrate.crosscheck import check_chart
from calibrate.difference import D65_XYZ

# The benchmark's limit; what is met is a tenth of it.
CORNERS = 0.02
# The reflectances of the scenes have the published colours under D50; a Bradford transform takes these to D65, with a mean
# error of half a ΔE, and a 3×3 matrix leaves the rest of what a real camera makes of them.
FITTED = 4.0
ROUNDING = 1e-9
XYZ = np.eye(3)


@functools.cache
def sg_scene():
    return scene_with_sg(30017)


@functools.cache
def sg_found():
    return find_chart(sg_scene().image, chart_reference(SG_AFTER_2014))


def misses(found, corners):
    return np.hypot(*(found.corners - corners).T).max() / np.hypot(*(corners[1] - corners[0]))


def test_an_sg_is_found_with_all_its_140_patches():
    found = sg_found()
    assert found.quads.shape == (140, 4, 2)
    assert misses(found, sg_scene().corners) < CORNERS
    given = chart_from_corners(sg_scene().corners, SG)
    np.testing.assert_allclose(found.quads, given.quads, atol=1.0)


def test_a_matrix_is_fitted_to_all_patches_of_an_sg_and_its_whites_are_as_bright_as_published():
    reference = chart_reference(SG_AFTER_2014)
    patches = measure_patches(sg_scene().image, sg_found().quads, names=reference.names)
    fit = fit_matrix(patches.rgb, reference, rgb_from_xyz=XYZ)
    assert fit.delta_e.shape == (140,)
    assert fit.delta_e[~fit.left_out].mean() < FITTED
    assert fit.delta_e_loo.mean() < 1.1 * fit.delta_e.mean()
    # The frame of whites, greys and blacks tells the light on every side.
    assert fit.shading.max() / fit.shading.min() == pytest.approx(_drawn_fall_off(), rel=0.1)


def _drawn_fall_off():
    """How much brighter the brightest of the frame's patches is than the darkest of the same colour, as they read."""
    reference = chart_reference(SG_AFTER_2014)
    rgb = measure_patches(sg_scene().image, sg_found().quads).rgb[:, 1]
    whites = np.flatnonzero(reference.XYZ[:, 1] > 0.85)
    greys = np.flatnonzero((np.abs(reference.XYZ[:, 1] - 0.18) < 0.01) & (np.ptp(reference.XYZ, axis=1) < 0.03))
    logs, places = [], []
    for same in (whites, greys):
        logs.append(np.log(rgb[same]) - np.log(rgb[same]).mean())
        places.append(SG.places[same] - SG.places[same].mean(axis=0))
    slope = np.linalg.lstsq(np.concatenate(places), np.concatenate(logs), rcond=None)[0]
    return float(np.exp(np.ptp(SG.places @ slope)))


def test_an_sg_read_by_a_camera_that_sees_as_the_eye_is_fitted_exactly():
    reference = chart_reference(SG_AFTER_2014)
    mixed = reference.XYZ @ np.array([[0.9, 0.2, 0.1], [0.1, 1.1, 0.0], [0.0, 0.3, 0.7]])
    light = np.exp(SG.places @ [0.4, -0.2])
    fit = fit_matrix(mixed * light[:, None], reference, rgb_from_xyz=XYZ, white_preserving=True)
    np.testing.assert_allclose(fit.fitted_rgb, reference.XYZ, rtol=1e-6, atol=ROUNDING)
    assert fit.delta_e_loo.max() < 1e-4


def test_the_frame_of_an_sg_does_not_outweigh_its_colours():
    # The frame reads 5 % too blue (a reflection of the ceiling, say): the matrix follows the 96 patches inside.
    reference = chart_reference(SG_AFTER_2014)
    frame = (np.abs(SG.places) > 0.499).any(axis=1)
    tinted = reference.XYZ * np.where(frame[:, None], [1, 1, 1.05], 1.0)
    fit = fit_matrix(tinted, reference, rgb_from_xyz=XYZ, shading="none", spoilt="keep")
    assert abs(fit.matrix[2, 2] - 1) < 0.01
    assert frame.sum() == 44


def test_an_sg_is_refused_where_a_classic_is_expected():
    with pytest.raises(CalibrateError, match=r"the middle of a ColorChecker Digital SG.*ColorCheckerSG - After"):
        find_chart(sg_scene().image)


@pytest.mark.slow
def test_a_classic_is_refused_where_an_sg_is_expected():
    scene = scene_with_passport(30001)
    with pytest.raises(CalibrateError, match=r"ColorChecker Digital SG.*`correct.reference`"):
        find_chart(scene.image, chart_reference(SG_AFTER_2014))


def test_the_inner_patches_of_an_sg_are_those_of_a_classic():
    classic, sg = chart_reference(), chart_reference(SG_AFTER_2014)
    chosen = [sg.names[k] for k in CLASSIC_ON_SG]
    assert chosen[0] == "E2" and chosen[18] == "E5" and chosen[23] == "J5"
    inner = sg.XYZ[list(CLASSIC_ON_SG)]
    # Other pigments, the same hues and lightness: no other patch of the SG is as near in more than a third of the cases.
    assert np.abs(np.cbrt(inner) - np.cbrt(classic.XYZ)).mean() < 0.03
    assert sg.names[SG.white_patch] == "E5"


def test_measured_patches_of_an_sg_are_taken_and_wrongly_ordered_ones_refused():
    sg = chart_reference(SG_AFTER_2014)
    reference = measured_reference("mine", sg.XYZ, white=D65_XYZ)
    assert reference.layout is SG and not reference.published
    np.testing.assert_allclose(reference.XYZ, sg.XYZ, atol=ROUNDING)
    with pytest.raises(CalibrateError, match="expected the 61th, E5"):
        measured_reference("mine", np.roll(sg.XYZ, 3, axis=0), white=D65_XYZ)
    with pytest.raises(CalibrateError, match="or of the 140 of an SG"):
        measured_reference("mine", sg.XYZ[:96], white=D65_XYZ)


def test_the_reflectances_of_the_scenes_have_the_published_colours():
    import colour

    shape = colour.SpectralShape(400, 700, 10)
    eye = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values
    light = colour.SDS_ILLUMINANTS["D50"].copy().align(shape).values
    published = [colour.xyY_to_XYZ(value) for value in colour.CCS_COLOURCHECKERS[SG_AFTER_2014].data.values()]
    seen = (sg_reflectances() * light) @ eye / (light @ eye[:, 1])
    # No reflectance is above 1, which a few bright patches would need: they come out a hundredth darker.
    assert np.abs(seen - published).max() < 0.015
    assert np.median(np.abs(seen - published)) < 1e-6
    assert sg_reflectances().min() > 0 and sg_reflectances().max() <= 1


@pytest.mark.parametrize("seed", [30000, 30001])
def test_charts_of_other_proportions_are_found_and_their_patches_read_within_themselves(seed):
    scene = scene_with_passport(seed)
    assert scene.facts["part"] == PARTS[seed % 3] < 0.9
    found = find_chart(scene.image)
    assert misses(found, scene.corners) < CORNERS
    # The sampled squares lie within the patches as drawn: those are narrower than a Classic's.
    half = 0.5 * 2.5 / 2
    assert half + CORNERS * 16.75 / 2 < 0.5 * 2.75 * scene.facts["part"]


@functools.cache
def two(seed):
    scene = scene_with_two(seed)
    return scene, find_charts(scene.image)


def checked(seed):
    scene, charts = two(seed)
    reference = chart_reference()
    rgb = [measure_patches(scene.image, chart.quads).rgb for chart in charts]
    fit = fit_matrix(rgb[0], reference, rgb_from_xyz=XYZ)
    return fit, check_chart(rgb[1], fit, reference, rgb_from_xyz=XYZ)


@pytest.mark.parametrize("seed", [pytest.param(30000, marks=pytest.mark.slow), 30001])
def test_of_two_charts_both_are_found_the_larger_first(seed):
    scene, charts = two(seed)
    assert len(charts) == 2
    for found, corners in zip(charts, scene.corners, strict=True):
        assert misses(found, corners) < CORNERS
    # The smaller, named by its corners, has the larger as the other.
    (other,) = other_charts(scene.image, chart_from_corners(scene.corners[1]))
    np.testing.assert_allclose(other.corners, charts[0].corners, atol=1e-6)


def test_a_second_chart_in_another_light_is_told():
    _, other = checked(30001)
    assert other.another_light
    assert other.delta_e > other.delta_e_balanced


@pytest.mark.slow
def test_a_second_chart_in_the_same_light_agrees():
    fit, same = checked(30000)
    assert not same.another_light and not same.disagrees
    assert same.delta_e < fit.delta_e.mean() + 1


@pytest.mark.slow
def test_a_chart_has_no_other_chart_beside_it():
    scene = scene_with_passport(30001)
    assert len(find_charts(scene.image)) == 1


def test_the_light_on_the_second_chart_is_seen_from_the_first():
    reference = chart_reference()
    fit = fit_matrix(reference.XYZ, reference, rgb_from_xyz=XYZ)
    tint = np.array([1.05, 1.0, 0.8])
    check = check_chart(3 * reference.XYZ * tint, fit, reference, rgb_from_xyz=XYZ)
    x, y, z = D65_XYZ * tint
    u, v = np.array([4 * x, 9 * y]) / (x + 15 * y + 3 * z)
    assert check.level == pytest.approx(3.0)
    assert check.light_uv == pytest.approx(np.hypot(u - 0.19783, v - 0.46834), abs=1e-4)
    assert check.another_light and not check.disagrees
    even = check_chart(
        reference.XYZ * np.exp(reference.layout.places @ [0.5, 0.3])[:, None], fit, reference, rgb_from_xyz=XYZ
    )
    assert even.delta_e < 0.01 and not even.another_light


def test_a_second_chart_of_other_pigments_disagrees():
    reference = chart_reference()
    seen = patch_colours("D65", 0, np.ones(3))
    fit = fit_matrix(seen, reference, rgb_from_xyz=XYZ)
    faded = seen.copy()
    faded[:18] = 0.5 * (faded[:18] + faded[:18].mean(axis=1, keepdims=True))
    assert check_chart(faded, fit, reference, rgb_from_xyz=XYZ).disagrees
    assert not check_chart(seen, fit, reference, rgb_from_xyz=XYZ).disagrees
    with pytest.raises(CalibrateError, match="one row a patch"):
        check_chart(seen[:20], fit, reference, rgb_from_xyz=XYZ)
    with pytest.raises(CalibrateError, match="not positive under the matrix"):
        check_chart(-seen, fit, reference, rgb_from_xyz=XYZ)
