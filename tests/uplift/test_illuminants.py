"""Families of lamps: the asked CCT, Y = 1, published members, and what is refused."""

import numpy as np
import pytest

from uplift import UpliftError
from uplift.illuminants import FAMILIES, cct_duv_of, family_emission, measured_emission
from uplift.illuminants.daylight import d_series
from uplift.illuminants.fluorescent import fluorescent_nodes
from uplift.illuminants.led import led_nodes
from uplift.illuminants.sunset import airmass, direct_beam
from uplift.spectrum import illuminant, observer, xyz_of

OBSERVER = observer()
CCT_K = 0.05  # the solver stops at 1e-6 K; a black body at 1000 K is taken at its own temperature
WHITE = 1e-12


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_has_the_asked_cct_over_its_whole_range(family):
    low, high = FAMILIES[family].low_k, FAMILIES[family].high_k
    for cct in [*np.geomspace(low, high, 23)[1:-1], low, high]:
        emission = family_emission(family, float(cct), OBSERVER)
        assert abs(cct_duv_of(emission, OBSERVER)[0] - cct) < CCT_K
        assert emission.min() >= 0
        assert abs(xyz_of(emission, OBSERVER)[1] - 1) < WHITE


@pytest.mark.parametrize("grid", [(380, 730, 10), (400, 700, 10), (360, 780, 1)])
@pytest.mark.parametrize(
    ("family", "cct"), [("led", 3500.0), ("daylight", 9000.0), ("sunset", 3000.0), ("smooth", 5000.0)]
)
def test_the_asked_cct_is_met_on_other_grids(family, cct, grid):
    other = observer(*grid)
    assert abs(cct_duv_of(family_emission(family, cct, other), other)[0] - cct) < CCT_K


@pytest.mark.parametrize("family", FAMILIES)
def test_a_cct_out_of_reach_is_refused_with_the_range(family):
    for cct in (FAMILIES[family].low_k - 1, FAMILIES[family].high_k + 1, float("nan")):
        with pytest.raises(UpliftError, match=f"{family}.*out of range.*expected"):
            family_emission(family, cct, OBSERVER)


def test_an_unknown_family_is_refused():
    with pytest.raises(UpliftError, match="'neon' is unknown"):
        family_emission("neon", 4000.0, OBSERVER)


@pytest.mark.parametrize(
    ("family", "name"), [("daylight", "D65"), ("daylight", "D75"), ("led", "LED-B3"), ("fluorescent", "FL2")]
)
def test_published_members_come_back_to_the_last_bit(family, name):
    published = illuminant(name, OBSERVER)
    cct, _ = cct_duv_of(published, OBSERVER)
    np.testing.assert_array_equal(family_emission(family, cct, OBSERVER), published)


def test_white_of_unknown_kind_is_exactly_d65():
    d65 = illuminant("D65", OBSERVER)
    np.testing.assert_array_equal(family_emission("smooth", cct_duv_of(d65, OBSERVER)[0], OBSERVER), d65)


@pytest.mark.parametrize("nominal", [4000.0, 5600.0, 6999.0, 7001.0, 12_000.0, 25_000.0])
def test_the_d_series_is_that_of_colour_science(nominal):
    import colour
    from colour.colorimetry import sd_CIE_illuminant_D_series
    from colour.temperature import CCT_to_xy_CIE_D

    theirs = sd_CIE_illuminant_D_series(CCT_to_xy_CIE_D(nominal), M1_M2_rounding=False)
    theirs = theirs.align(colour.SpectralShape(380, 780, 5)).values
    np.testing.assert_allclose(d_series(nominal, OBSERVER), theirs, rtol=1e-3)  # they round M1 and M2 in one place


@pytest.mark.slow
def test_families_change_smoothly_with_cct():
    for family, low, high in (("daylight", 5000, 25_000), ("smooth", 2000, 25_000), ("sunset", 2200, 5000)):
        steps = np.geomspace(low, high, 120)
        spectra = np.array([family_emission(family, float(cct), OBSERVER) for cct in steps])
        change = np.abs(np.diff(spectra, axis=0)).mean(axis=1) / spectra[1:].mean(axis=1)
        assert change.max() < 0.08, family  # a jump from one kind of spectrum to another is 0.2 and more


def test_smooth_is_planck_below_the_join_and_daylight_above():
    np.testing.assert_array_equal(
        family_emission("smooth", 3000.0, OBSERVER), family_emission("incandescent", 3000.0, OBSERVER)
    )
    np.testing.assert_array_equal(
        family_emission("smooth", 7000.0, OBSERVER), family_emission("daylight", 7000.0, OBSERVER)
    )


def test_the_low_sun_has_passed_more_air_the_redder_it_is():
    assert airmass(0.0) == pytest.approx(1.0, abs=2e-3)
    assert airmass(60.0) == pytest.approx(1.993, abs=5e-3)  # Kasten 1966
    assert airmass(90.0) == pytest.approx(36.5, rel=0.02)
    high, low = direct_beam(30.0, OBSERVER), direct_beam(85.0, OBSERVER)
    assert (low < high).all()
    assert low[0] / low[-1] < high[0] / high[-1]


def test_the_beam_is_that_of_the_standard_at_airmass_one_and_a_half():
    from colour.plotting.datasets.astm_g_173 import SD_ASTMG173_DIRECT_CIRCUMSOLAR

    theirs = SD_ASTMG173_DIRECT_CIRCUMSOLAR
    wavelengths = np.arange(400.0, 680.0, 20.0)
    ours = direct_beam(48.19, observer(390, 700, 10))[1:-1:2][: len(wavelengths)]
    expected = [theirs.values[np.abs(theirs.wavelengths - nm) <= 5].mean() for nm in wavelengths]
    np.testing.assert_allclose(ours, expected, rtol=0.06)  # another model of the same air


def test_led_nodes_say_which_of_them_are_models():
    names = [node.name for node in led_nodes(OBSERVER)]
    ccts = [node.cct for node in led_nodes(OBSERVER)]
    assert ccts == sorted(ccts)
    assert sum(name.endswith("(modelled)") for name in names) == 9
    for node in led_nodes(OBSERVER):
        assert abs(cct_duv_of(node.emission, OBSERVER)[1]) < 0.002
        assert node.emission.min() >= 0


def test_fluorescent_nodes_are_the_six_in_order_of_cct():
    assert [node.name for node in fluorescent_nodes(OBSERVER)] == ["FL4", "FL3", "FL6", "FL2", "FL5", "FL1"]


# ---- measured spectra ----


def test_a_spectrum_measured_on_the_grid_itself_is_only_scaled():
    emission = illuminant("FL11", OBSERVER)
    np.testing.assert_allclose(
        measured_emission(OBSERVER.wavelengths_nm, 7.0 * emission, OBSERVER), emission, rtol=1e-12
    )


def test_a_finer_spectrum_keeps_the_light_of_its_lines():
    wavelengths = np.arange(380.0, 780.5, 0.5)
    power = np.exp(-0.5 * ((wavelengths - 547.5) / 0.5) ** 2) + 1e-3  # a line between two wavelengths of the grid
    got = measured_emission(wavelengths, power, OBSERVER)
    inside = (OBSERVER.wavelengths_nm > 540) & (OBSERVER.wavelengths_nm < 555)
    share = got[inside].sum() / got.sum()
    near = (wavelengths > 537.5) & (wavelengths < 557.5)
    assert share == pytest.approx(power[near].sum() / power.sum(), rel=0.05)


def test_order_unit_and_small_noise_do_not_matter():
    wavelengths = np.arange(380.0, 781.0, 5.0)
    power = illuminant("LED-B2", OBSERVER) * 1e-9
    noisy = power.copy()
    noisy[0] = -0.001 * power.max()
    flipped = measured_emission(wavelengths[::-1], noisy[::-1], OBSERVER)
    assert flipped[0] == 0
    np.testing.assert_allclose(flipped[1:], illuminant("LED-B2", OBSERVER)[1:], rtol=1e-4)


def test_ends_of_a_short_measurement_are_held():
    got = measured_emission([400.0, *np.arange(410.0, 691.0, 10.0), 700.0], np.ones(31), OBSERVER)
    np.testing.assert_allclose(got, got[0])


@pytest.mark.parametrize(
    ("wavelengths", "power", "message"),
    [
        (np.arange(380.0, 781.0, 5.0), np.ones(80), "equal length"),
        ([500.0], [1.0], "at least two rows"),
        (np.arange(380.0, 781.0, 5.0), np.r_[np.nan, np.ones(80)], "row 0 is not a number"),
        (np.arange(380.0, 781.0, 5.0), np.r_[-0.5, np.ones(80)], "negative beyond noise"),
        (np.arange(380.0, 781.0, 5.0), np.zeros(81), "no value above zero"),
        (np.r_[np.arange(380.0, 781.0, 5.0), 500.0], np.ones(82), "500 nm occurs twice"),
        (np.arange(450.0, 781.0, 5.0), np.ones(67), "covers 450–780 nm"),
        (np.arange(0.38, 0.781, 0.005), np.ones(81), "in nanometres"),
        (np.r_[380.0, 400.0, 500.0, 600.0, 700.0, 780.0], np.ones(6), "a gap of 100 nm"),
    ],
)
def test_bad_measurements_are_refused(wavelengths, power, message):
    with pytest.raises(UpliftError, match=message):
        measured_emission(wavelengths, power, OBSERVER, name="lamp.csv")
