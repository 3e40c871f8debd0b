"""The chart as a spectrometer: lamps that the prior does not know come back, and what is no single light is refused."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from uplift import UpliftError
from uplift.illuminants import cct_duv_of
from uplift.spectrometer import FAMILIES, Reading, anchored, chart_reflectances, measure_light, reading_of
from uplift.spectrometer.camera import fitted_model, model_of, typical_camera
from uplift.spectrometer.chart import covariance, responses
from uplift.spectrometer.lamps import PUBLISHED, lamps, planck, published
from uplift.spectrometer.posterior import posterior
from uplift.spectrometer.prior import Prior, prior_of
from uplift.spectrometer.refusal import believed
from uplift.spectrometer.safety import HARDLY, MOST_UNKNOWN, relight_losses, smooth_of_colour, trusted
from uplift.spectrum import illuminant, normalised, observer, xyz_of

EYES = observer()
NM = EYES.wavelengths_nm
NOISE = 0.005
#: Root mean square of the error over that of the spectrum. Lamps of narrow lines cannot be had better from 72 broad readings:
#: 0.13 is the median over 79 lamps at this noise.
NEAR = 0.25


@cache
def camera(name="Nikon 5100 (NPL)"):
    import colour

    known = colour.MSDS_CAMERA_SENSITIVITIES[name]
    return np.stack([np.interp(NM, known.wavelengths, known.values[:, c], left=0, right=0) for c in range(3)], axis=-1)


def read(light, *, curves=None, noise=NOISE, seed=0, surfaces=None, anchor=None):
    """A reading of the chart under a light, by the sums written out."""
    curves = camera() if curves is None else curves
    surfaces = chart_reflectances(EYES) if surfaces is None else surfaces
    exact = np.array([[(r * s * light).sum() for s in curves.T] for r in surfaces])
    chance = np.random.default_rng(seed).standard_normal((24, 3))
    anchor = illuminant("D65", EYES) if anchor is None else anchor
    lamp = [(anchor * s).sum() for s in curves.T]
    return reading_of(exact * (1 + noise * chance), noise * exact, lamp)


def off(measured, light):
    return np.linalg.norm(measured.emission - light) / np.linalg.norm(light)


def bulb(kelvin):
    return normalised(planck(np.array([float(kelvin)]), NM)[0], EYES)


@cache
def without(*names):
    return prior_of(EYES, frozenset(names))


LEFT_OUT = {
    "LED-B3": "led",
    "LED-B5": "led",
    "FL11": "fluorescent",
    "FL2": "fluorescent",
    "D50": "daylight",
    "A": "incandescent",
}


@cache
def prior_without_those():
    return without(*LEFT_OUT, "Philips TL-84", "Cool White FL", "FL6", "F34/CW/RS/EW (Cool White FL)", "ID50")


@pytest.mark.parametrize("name", LEFT_OUT)
def test_a_lamp_that_the_prior_does_not_know_is_measured_and_its_family_named(name):
    light = illuminant(name, EYES)
    found = measure_light(read(light), camera=camera(), observer=EYES, prior=prior_without_those())
    assert off(found, light) < NEAR
    assert found.family == LEFT_OUT[name]
    assert not found.refused
    cct, duv = cct_duv_of(light, EYES)
    assert abs(found.cct - cct) < 4 * found.cct_sigma + 0.005 * cct
    assert abs(found.duv - duv) < 4 * found.duv_sigma + 0.0005


@pytest.mark.parametrize("name", ["LED-B3", "FL11", "A"])
def test_an_unknown_camera_is_fitted_along_and_costs_certainty(name):
    light = illuminant(name, EYES)
    known = measure_light(read(light), camera=camera(), observer=EYES, prior=prior_without_those())
    unknown = measure_light(read(light), camera=None, observer=EYES, prior=prior_without_those())
    assert off(unknown, light) < 1.5 * NEAR
    assert unknown.family == LEFT_OUT[name]
    assert known.camera_loss == 1.0 < unknown.camera_loss
    assert unknown.cct_sigma > known.cct_sigma


def test_the_measured_light_is_a_light_of_luminance_one():
    found = measure_light(read(illuminant("FL11", EYES)), camera=camera(), observer=EYES)
    assert found.emission.min() >= 0
    assert xyz_of(found.emission, EYES)[1] == pytest.approx(1)
    assert found.sigma.shape == found.emission.shape and found.sigma.min() > 0
    assert sum(found.families.values()) == pytest.approx(1) and tuple(found.families) == FAMILIES


def test_brightness_of_the_light_and_units_of_the_camera_do_not_matter():
    light = illuminant("LED-B2", EYES)
    one = measure_light(read(light), camera=camera(), observer=EYES)
    other = measure_light(
        read(50 * light, curves=camera() * [3.0, 1.0, 7.0]), camera=camera() * [0.2, 4.0, 1.0], observer=EYES
    )
    np.testing.assert_allclose(other.emission, one.emission, rtol=1e-6, atol=1e-9)


def test_less_noise_never_makes_it_less_sure():
    light = illuminant("LED-B3", EYES)
    sigma = [
        np.linalg.norm(measure_light(read(light, noise=n), camera=camera(), observer=EYES).sigma)
        for n in (0.001, 0.01, 0.05)
    ]
    assert sigma == sorted(sigma)


# ---- the lamp of known spectrum ----


@pytest.mark.parametrize("curves", [camera(), None], ids=["known camera", "unknown camera"])
@pytest.mark.parametrize("anchor", ["LED-B1", "FL7"])
def test_beside_a_lamp_of_its_own_spectrum_the_light_comes_out_as_beside_d65(anchor, curves):
    light, lamp = illuminant("FL11", EYES), illuminant(anchor, EYES)
    beside_d65 = measure_light(read(light), camera=curves, observer=EYES, prior=prior_without_those())
    reading = read(light, anchor=lamp)
    declared = measure_light(reading, camera=curves, observer=EYES, prior=prior_without_those(), lamp=7.0 * lamp)
    assert not declared.refused and off(declared, light) < NEAR
    # A known camera makes the anchors alike, but for the scale of the prior, which is the mean of all readings and so weighs the
    # channels by the anchor; an unknown one makes them differ by less than their own error.
    assert abs(declared.cct - beside_d65.cct) < (beside_d65.cct_sigma if curves is None else 0.005 * beside_d65.cct)


def test_a_warm_lamp_believed_to_be_d65_spoils_the_light_and_declared_does_not():
    light, lamp = illuminant("FL11", EYES), illuminant("LED-B1", EYES)
    reading = read(light, anchor=lamp)
    believed = measure_light(reading, camera=camera(), observer=EYES)
    declared = measure_light(reading, camera=camera(), observer=EYES, lamp=lamp)
    assert believed.refused or abs(believed.cct - 3999) > 1000
    assert not declared.refused and declared.cct == pytest.approx(3999, rel=0.02)


def test_the_model_of_cameras_is_anchored_to_another_lamp_as_each_camera_is():
    lamp = illuminant("LED-B5", EYES)
    model = typical_camera(EYES)
    moved = model.anchored_to(lamp, EYES)
    for j in range(len(model.directions)):
        amounts = np.eye(len(model.directions))[j]
        exact = anchored(model.curves(amounts), EYES, lamp)
        # The first order: what is left is the square of some per cent.
        assert np.abs(moved.curves(amounts) - exact).max() < 0.005 * exact.max()


def test_a_lamp_that_a_channel_does_not_see_or_that_is_none_is_refused():
    red = np.where(NM > 720, 1.0, 0.0)
    blind = camera() * (NM < 700)[:, np.newaxis]
    with pytest.raises(UpliftError, match="does not see the lamp"):
        measure_light(read(bulb(2800)), camera=blind, observer=EYES, lamp=red)
    with pytest.raises(UpliftError, match="negative or not finite"):
        measure_light(read(bulb(2800)), camera=camera(), observer=EYES, lamp=-red)
    with pytest.raises(UpliftError, match="shape"):
        measure_light(read(bulb(2800)), camera=camera(), observer=EYES, lamp=red[:40])


# ---- refusals ----


def refused(reading, curves=None):
    return measure_light(reading, camera=curves, observer=EYES).refused


def two_lights(one="LED-B3", kelvin=2400, across=0.6):
    """Their shares go by `across` from one side of the chart to the other."""
    a, b = read(illuminant(one, EYES)), read(bulb(kelvin))
    share = 0.5 + across * ((np.arange(24) % 6)[:, np.newaxis] / 5 - 0.5)
    return Reading(share * a.values + (1 - share) * b.values, a.noise)


def veiled():
    reading = read(illuminant("LED-B3", EYES))
    return Reading(reading.values + 0.05 * reading.values[18], reading.noise)


def upside_down():
    reading = read(illuminant("LED-B3", EYES))
    return Reading(reading.values[::-1].copy(), reading.noise)


def another_chart():
    """One whose dark patches are a third lighter, as if faded."""
    return read(illuminant("LED-B3", EYES), surfaces=chart_reflectances(EYES) ** 0.8)


@pytest.mark.parametrize("curves", [camera(), None], ids=["known camera", "unknown camera"])
@pytest.mark.parametrize(
    ("reading", "told"),
    [
        (veiled(), "most likely a veil of light lies over all patches"),
        (two_lights(), "most likely the colour of the light changes across the chart: several lights reach it"),
        (upside_down(), "none of the usual reasons"),
        (another_chart(), "Check that the chart is a ColorChecker Classic"),
    ],
    ids=["veil", "two lights", "upside down", "another chart"],
)
def test_what_no_single_light_explains_is_refused_and_its_reason_named(reading, told, curves):
    text = refused(reading, curves)
    assert told in text and "chi²" in text and text.endswith(".")


def test_lights_of_like_colours_betray_themselves_by_the_order_of_the_misfit():
    assert "from its middle to a rim" in refused(two_lights("LED-B1", across=0.35), camera())


def narrow_camera():
    return np.exp(-0.5 * ((NM[:, np.newaxis] - [640.0, 500.0, 430.0]) / 14.0) ** 2)


def test_the_sensitivities_of_another_camera_are_refused_and_named():
    narrow = camera() * np.exp(-0.5 * ((NM[:, np.newaxis] - [590.0, 540.0, 440.0]) / 20.0) ** 2)
    assert "most likely the sensitivities are those of another camera" in refused(
        read(illuminant("LED-B3", EYES)), narrow
    )


def moved(by_nm):
    """The camera with its sensitivities so much farther towards red."""
    return np.stack([np.interp(NM - by_nm, NM, camera()[:, c]) for c in range(3)], axis=-1)


def test_a_camera_that_is_hardly_unlike_the_others_is_read_but_believed_less():
    light = illuminant("LED-B3", EYES)
    like, hardly = (measure_light(read(light, curves=moved(by)), camera=None, observer=EYES) for by in (6.0, 10.0))
    assert like.refused == hardly.refused == ""
    assert hardly.camera_loss > 2 * like.camera_loss
    assert hardly.trusted <= HARDLY < like.trusted <= MOST_UNKNOWN


def test_the_wider_fit_is_believed_where_it_is_clearly_the_more_probable_one_and_the_usual_one_explains_the_reading():
    def a_fit(chi2, evidence):
        return SimpleNamespace(chi2=chi2, posterior=SimpleNamespace(log_evidence=evidence))

    usual, better, hardly_better, bad = a_fit(1.0, 5.0), a_fit(0.5, 8.0), a_fit(0.5, 6.0), a_fit(9.0, 5.0)
    assert believed(usual, better) is better
    assert believed(usual, hardly_better) is usual
    assert believed(usual, None) is usual
    assert believed(bad, better) is bad


@pytest.mark.slow
def test_a_camera_unlike_all_others_is_refused_and_named_whether_or_not_its_light_seems_to_fit():
    told = "the camera's sensitivities are unlike those of the cameras known here"
    text = refused(read(illuminant("LED-B3", EYES), curves=narrow_camera()))
    assert "no light explains the patches" in text and told in text and "`balance.camera`" in text
    text = refused(read(illuminant("LED-B3", EYES), curves=moved(15.0)))
    assert told in text and "`balance.camera`" in text
    assert refused(read(illuminant("LED-B3", EYES))) == ""


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"camera_rgb": np.ones((23, 3))}, "24 patches"),
        ({"camera_rgb": np.full((24, 3), np.nan)}, "not finite"),
        ({"lamp_rgb": [1.0, 0.0, 1.0]}, "positive raw values"),
        ({"noise": np.full((24, 3), -1.0)}, "not negative"),
    ],
)
def test_a_reading_that_is_none_is_refused(change, told):
    given = {"camera_rgb": np.ones((24, 3)), "noise": np.ones((24, 3)), "lamp_rgb": [1.0, 1.0, 1.0]} | change
    with pytest.raises(UpliftError, match=told):
        reading_of(**given)


def test_sensitivities_and_reflectances_of_another_grid_are_refused():
    with pytest.raises(UpliftError, match="sensitivities"):
        measure_light(read(bulb(2800)), camera=camera()[:40], observer=EYES)
    with pytest.raises(UpliftError, match="does not see D65"):
        anchored(camera() * [1, 0, 1], EYES)
    with pytest.raises(UpliftError, match="reflectances of shape"):
        measure_light(read(bulb(2800)), camera=camera(), observer=EYES, reflectances=np.ones((24, 9)))


# ---- how far the measured spectrum is followed ----


@pytest.mark.parametrize("name", ["FL11", "A", "LED-B1", "HP3"])
def test_the_smooth_spectrum_has_the_very_colour_of_the_measured(name):
    light = illuminant(name, EYES)
    np.testing.assert_allclose(xyz_of(smooth_of_colour(light, EYES), EYES), xyz_of(light, EYES), rtol=1e-9)


def test_a_spectrum_that_is_sure_is_followed_and_one_that_is_not_less():
    light = illuminant("FL11", EYES)
    shares = []
    for sigma in (1e-6, 3.0):  # of the mean radiance
        used, share = trusted(light, (sigma * light.mean()) ** 2 * np.eye(NM.size), chart_reflectances(EYES), EYES)
        np.testing.assert_allclose(xyz_of(used, EYES), xyz_of(light, EYES), rtol=1e-9)
        shares.append(share)
    assert shares[0] == 1.0 > shares[1]


def test_no_more_is_followed_than_the_most_that_is_allowed():
    light, sure = illuminant("FL11", EYES), 1e-12 * np.eye(NM.size)
    used, share = trusted(light, sure, chart_reflectances(EYES), EYES, most=0.85)
    assert share == 0.85
    np.testing.assert_allclose(used, 0.85 * light + 0.15 * smooth_of_colour(light, EYES), rtol=1e-9)


def test_a_spectrum_that_suits_the_uplift_badly_is_hardly_followed_though_it_is_sure():
    # A daylight tube: its own spectrum relights no better than D65 does.
    light, sure = illuminant("FL7", EYES), 1e-12 * np.eye(NM.size)
    assert trusted(light, sure, chart_reflectances(EYES), EYES)[1] <= HARDLY


@pytest.mark.slow
def test_what_is_used_is_the_trusted_share_of_what_was_measured():
    noisy = read(illuminant("LED-B3", EYES), noise=0.1)
    found = measure_light(noisy, camera=None, observer=EYES)
    assert found.trusted < 1.0
    smooth = smooth_of_colour(found.measured, EYES)
    np.testing.assert_allclose(found.emission, found.trusted * found.measured + (1 - found.trusted) * smooth, rtol=1e-9)
    assert (found.sigma >= np.abs(found.emission - found.measured)).all()


@pytest.mark.parametrize("curves", [camera(), None], ids=["known camera", "unknown camera"])
def test_the_fit_says_what_the_patches_should_have_read(curves):
    reading = read(illuminant("LED-B3", EYES), noise=0.01)
    found = measure_light(reading, camera=curves, observer=EYES)
    # Their noise of 1 % and what the anchor's gains are believed to be off; the rest of the errors is not simulated.
    np.testing.assert_allclose(found.explained, reading.values, rtol=0.05)


def test_believing_the_truth_costs_less_than_believing_another_light():
    truth = illuminant("FL11", EYES)
    losses = relight_losses(
        truth[np.newaxis], [truth, smooth_of_colour(truth, EYES), illuminant("A", EYES)], chart_reflectances(EYES), EYES
    )[0]
    assert losses[0] == losses.min() > 0


# ---- parts ----


def test_for_one_gaussian_it_is_the_wiener_filter():
    rng = np.random.default_rng(2)
    n = 30
    root = rng.standard_normal((n, n)) / n + 0.2 * np.eye(n)
    C, mean, A = root @ root.T, 3.0 + rng.random(n), rng.random((72, n))
    N = np.diag(rng.uniform(0.5, 2.0, 72))
    light = mean + root @ rng.standard_normal(n)
    m = A @ light
    m *= (A @ mean).mean() / m.mean()  # so that the prior's scale, which is fitted to the reading, is one
    prior = Prior(
        mean[np.newaxis], C[np.newaxis], np.linalg.inv(np.linalg.cholesky(C))[np.newaxis], np.zeros(1), np.zeros(1, int)
    )
    found = posterior(m, A, N, prior, positive=False)
    gain = C @ A.T @ np.linalg.inv(A @ C @ A.T + N)
    np.testing.assert_allclose(found.light, mean + gain @ (m - A @ mean), rtol=1e-8)
    np.testing.assert_allclose(found.covariance, C - gain @ A @ C, rtol=1e-6, atol=1e-12)
    # Where the most probable light is positive anyway, asking for that changes nothing.
    np.testing.assert_allclose(posterior(m, A, N, prior).light, found.light, rtol=1e-6)


def test_the_covariance_of_a_reading_is_one_and_holds_the_noise():
    reading = read(bulb(3000), noise=0.02)
    A = responses(chart_reflectances(EYES), anchored(camera(), EYES), EYES.step_nm)
    light = bulb(3000)
    full = covariance(reading, A, light, EYES)
    np.testing.assert_allclose(full, full.T)
    assert np.linalg.eigvalsh(full).min() > 0
    assert (np.diag(full) > reading.noise.reshape(-1) ** 2).all()


def test_every_lamp_of_the_prior_is_a_white_light_of_luminance_one():
    for family in lamps(EYES):
        np.testing.assert_allclose(xyz_of(family.emissions, EYES)[:, 1], 1, rtol=1e-9)
        assert family.emissions.min() >= 0
        assert len(family.emissions) - family.published >= 300
    assert {name.family for name in lamps(EYES)} == set(FAMILIES) == set(PUBLISHED)


def test_a_lamp_left_out_is_not_among_the_lamps():
    every, fewer = lamps(EYES)[0], lamps(EYES, frozenset({"LED-B3"}))[0]
    lamp = published("LED-B3", EYES)
    assert (np.abs(every.emissions - lamp).max(axis=1) == 0).any()
    assert not (np.abs(fewer.emissions - lamp).max(axis=1) == 0).any()


def test_the_prior_is_the_same_each_time_and_its_shares_sum_to_one():
    one = prior_of(EYES)
    again = prior_of.__wrapped__(EYES, frozenset())
    np.testing.assert_array_equal(one.means, again.means)
    assert np.exp(one.log_share).sum() == pytest.approx(1)
    assert set(one.family) == set(range(len(FAMILIES)))


def test_the_typical_camera_sees_d65_as_one_along_every_direction():
    model = typical_camera(EYES)
    day = illuminant("D65", EYES)
    np.testing.assert_allclose(day @ model.mean * EYES.step_nm, 1, rtol=1e-12)
    # Directions keep the response to D65, up to the rounding of the table and the resolution of its nodes.
    assert np.abs(np.einsum("n,jnc->jc", day, model.directions) * EYES.step_nm).max() < 0.01
    assert model.curves(np.full(len(model.directions), 9.0)).min() == 0.0


def test_a_model_fitted_to_cameras_describes_them():
    rng = np.random.default_rng(5)
    peaks = np.array([600.0, 535.0, 455.0]) + rng.normal(0, 4, (30, 3))
    curves = np.exp(-0.5 * ((NM[:, np.newaxis] - peaks[:, np.newaxis, :]) / 32.0) ** 2)
    curves = np.array([anchored(c, EYES) for c in curves])
    model = model_of(*fitted_model(curves, NM, 6), EYES)
    flat = model.directions.reshape(6, -1)
    for one in curves:
        amounts = np.linalg.lstsq(flat.T, (one - model.mean).reshape(-1), rcond=None)[0]
        assert np.linalg.norm(model.curves(amounts) - one) < 0.02 * np.linalg.norm(one)
        assert np.abs(amounts).max() < 4


@pytest.mark.slow
def test_over_many_lamps_the_errors_are_as_large_as_it_says_and_no_single_light_is_refused():
    deviations, wrong = [], []
    for family in lamps(EYES):
        for k, light in enumerate(family.emissions[family.published :: 97]):
            found = measure_light(read(light, noise=0.01, seed=k), camera=camera(), observer=EYES)
            deviations.append(np.sqrt((((found.emission - light) / found.sigma) ** 2).mean()))
            wrong.append(found.refused)
    assert 0.3 < np.median(deviations) < 1.5
    assert np.mean([bool(text) for text in wrong]) <= 0.02
