"""The matrix from sensitivities: exact where it can be, and better than the chart's where the lights differ in kind."""

import numpy as np
import pytest

from calibrate import CalibrateError
from calibrate.adapt import von_kries_matrix
from calibrate.chart import ChartReference, chart_reference
from calibrate.correct import fit_matrix
from calibrate.trained import matrix_of_sensitivities, training_reflectances
from samples.spectra import WAVELENGTHS_NM, camera_sensitivities, cct_of, chart_reflectances, cmfs, lamp

CAMERA = camera_sensitivities().T
D65 = lamp("D65")


def trained(reading, sensitivities=CAMERA, light=D65):
    return matrix_of_sensitivities(
        reading, sensitivities, lamp=light, daylight=D65, observer=cmfs(), wavelengths_nm=WAVELENGTHS_NM
    )


def cct(xyz):
    import colour

    return colour.temperature.uv_to_CCT_Ohno2013(colour.UCS_to_uv(colour.XYZ_to_UCS(xyz)))[0]


@pytest.mark.parametrize("light", ["D65", "D65 module"])
def test_the_lamp_gets_its_own_colour_whatever_the_gains_of_the_camera(light):
    spectrum = lamp(light)
    expected = spectrum @ cmfs() / (spectrum @ cmfs()[:, 1])
    for gains in (np.ones(3), np.array([1.9, 1.0, 0.4])):
        reading = 7.0 * spectrum @ CAMERA * gains
        np.testing.assert_allclose(trained(reading, light=spectrum) @ reading, expected, rtol=1e-9)


def test_a_camera_that_sees_as_the_eye_does_is_exact_for_every_spectrum():
    eye = cmfs() @ np.array([[0.6, 0.3, 0.0], [0.2, 0.8, -0.1], [0.1, 0.0, 0.9]]).T
    matrix = trained(D65 @ eye, eye)
    for name in ("FL11", "LED-RGB1", "A"):
        true = lamp(name) @ cmfs() / (D65 @ cmfs()[:, 1])
        np.testing.assert_allclose(matrix @ (lamp(name) @ eye), true, rtol=1e-6)


def test_there_are_more_than_190_reflectances_and_none_is_impossible():
    reflectances = training_reflectances(WAVELENGTHS_NM)
    assert len(reflectances) > 190
    assert reflectances.min() >= 0
    assert reflectances.max() < 1.1


@pytest.mark.parametrize("name", ["A", "LED-B1", "LED-B3"])
def test_the_colour_temperature_of_a_smooth_light_comes_out_within_two_percent(name):
    matrix = trained(D65 @ CAMERA)
    assert cct(matrix @ (lamp(name) @ CAMERA)) == pytest.approx(cct_of(lamp(name))[0], rel=0.02)


def test_a_lamp_of_another_kind_than_the_charts_light_is_read_better_than_by_the_chart():
    """The chart gets 94 % of its light from an LED; a tungsten globe stands in view."""
    chart_light = 0.94 * lamp("LED-B4") + 0.06 * lamp("A")
    patches = chart_reflectances()
    camera = patches * chart_light @ CAMERA
    target = patches * D65 @ cmfs() / (D65 @ cmfs()[:, 1])
    fit = fit_matrix(
        camera, ChartReference("measured", chart_reference().names, target), rgb_from_xyz=np.eye(3), shading="none"
    )
    white = D65 @ cmfs() / (D65 @ cmfs()[:, 1])
    balance = von_kries_matrix(fit.matrix @ (D65 @ CAMERA), white, xyz_from_rgb=np.eye(3))
    globe, truth = lamp("A") @ CAMERA, cct_of(lamp("A"))[0]
    by_chart = cct(balance @ fit.matrix @ globe) / truth - 1
    by_sensitivities = cct(trained(D65 @ CAMERA) @ globe) / truth - 1
    assert abs(by_chart) > 0.03
    assert abs(by_sensitivities) < 0.01


def test_what_cannot_be_balanced_is_refused():
    with pytest.raises(CalibrateError, match=r"balance\.camera: the lamp reads"):
        trained(np.array([0.1, 0.0, 0.2]))
    with pytest.raises(CalibrateError, match=r"every channel positive"):
        trained(np.ones(3), CAMERA * [1, 1, 0])
