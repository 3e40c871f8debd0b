"""Truth: the convex hull of the observer's wavelengths by scipy, fractions, and the colour of each start by a plain sum."""

from fractions import Fraction

import numpy as np
import pytest

from tests.uplift.lights_for_tests import light
from uplift.difference import delta_e_2000
from uplift.gamut import FIRST_ROW, ROW_STEP
from uplift.pixels import FALLBACK_LIGHTS, Status, fallback_emissions, rgb_of, uplift_pixels
from uplift.polynomial import TRIES, about, in_nm, stored
from uplift.sigmoid import normalisation, reflectance, sigmoid
from uplift.spectrum import RGB_SPACES, illuminant, observer, rgb_space, rgb_weights, xyz_of
from uplift.table import BRIGHTNESS, build_table

EYES = observer()
# ΔE2000 with every pixel as its own white, which a red of Y = 0.005 has as much as white; in ACES2065-1 there are many.
BORDER_ROUND_TRIP = 2e-8
AT_THE_BORDER = 2e-4  # of chromaticity: nearer to the locus than this a colour may count as beyond it
START = 1e-8  # residual of the fan's nodes, relative to luminance


def saturated(shape, seed):
    rng = np.random.default_rng(seed)
    return rng.random((*shape, 3)) ** rng.choice([1.0, 4.0, 8.0], (*shape, 1))


def inside_the_locus(rgb, eyes, space):
    """Return the distance [...] of chromaticities to the polygon of the grid's wavelengths, negative outside."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(eyes.cmfs[:, :2] / eyes.cmfs.sum(axis=1, keepdims=True))
    xyz = rgb @ space.xyz_from_rgb.T
    total = xyz.sum(axis=-1)
    xy = xyz[..., :2] / np.where(total > 0, total, np.nan)[..., None]
    distance = -(xy @ hull.equations[:, :2].T + hull.equations[:, 2]).max(axis=-1)
    return np.where(total > 0, distance, -1.0)


def uplifted(rgb, name, eyes=EYES, space=None):
    space = space or rgb_space("ITU-R BT.2020", observer=eyes)
    table = build_table(light(name) if eyes is EYES else illuminant(name, eyes), observer=eyes, space=space)
    result = uplift_pixels(rgb, np.zeros(rgb.shape[:2], int), [table])
    shown = rgb_of(result.coefficients, result.scale, result.emission, result.emissions, observer=eyes, space=space)
    return result, delta_e_2000(rgb, shown, space, white=None)


@pytest.mark.parametrize("name", ["D65", "FL11", "LED-RGB1", "1000 K"])
@pytest.mark.parametrize("space", RGB_SPACES)
def test_every_colour_inside_the_spectral_locus_is_exact(space, name):
    space = rgb_space(space)
    rgb = saturated((40, 100), seed=31)
    result, difference = uplifted(rgb, name, space=space)
    distance = inside_the_locus(rgb, EYES, space)
    kept = (result.status == Status.EXACT) | (result.status == Status.FALLBACK)
    assert kept[distance > AT_THE_BORDER].all()
    assert not kept[distance < -1e-6].any()
    assert difference[kept].max() < BORDER_ROUND_TRIP
    R = reflectance(result.coefficients[kept], EYES.wavelengths_nm)
    assert R.min() > 0 and R.max() < 1


@pytest.mark.parametrize(
    ("start", "stop", "step", "cmfs"),
    [
        (360, 830, 1, "CIE 1931 2 Degree Standard Observer"),
        (400, 700, 10, "CIE 1964 10 Degree Standard Observer"),
        (390, 730, 20, "CIE 2015 2 Degree Standard Observer"),
    ],
)
def test_any_grid_of_any_observer_is_exact_inside_its_own_locus(start, stop, step, cmfs):
    eyes = observer(start, stop, step, cmfs)
    rgb = saturated((20, 50), seed=32)
    for name in ("D65", "FL2"):
        result, difference = uplifted(rgb, name, eyes)
        distance = inside_the_locus(rgb, eyes, rgb_space("ITU-R BT.2020", observer=eyes))
        kept = (result.status == Status.EXACT) | (result.status == Status.FALLBACK)
        assert kept[distance > AT_THE_BORDER].all() and not kept[distance < -1e-6].any()
        assert difference[kept].max() < BORDER_ROUND_TRIP


def test_another_clusters_light_comes_before_D65_the_nearest_colour_first():
    lines = np.isin(EYES.wavelengths_nm, (450, 540, 620)).astype(float)
    space = rgb_space("ITU-R BT.2020")
    tables = [build_table(e, observer=EYES, space=space) for e in (lines, light("1200 K"), light("FL2"))]
    green = np.array([[[0.02, 0.9, 0.3]]])  # to which three lines do not reach
    result = uplift_pixels(green, np.array([[0]]), tables)
    xy = [xyz_of(table.emission, EYES)[:2] / xyz_of(table.emission, EYES).sum() for table in tables]
    assert np.hypot(*(xy[0] - xy[2])) < np.hypot(*(xy[0] - xy[1]))
    assert result.status[0, 0] == Status.FALLBACK and result.emission[0, 0] == 2
    alone = uplift_pixels(green, np.array([[0]]), tables[:1])
    assert alone.status[0, 0] == Status.FALLBACK and alone.emission[0, 0] == 1  # D65, after the only table's


def test_the_fallbacks_are_D65_and_two_lights_of_the_ends():
    emissions = fallback_emissions(EYES)
    assert len(emissions) == len(FALLBACK_LIGHTS) == 3
    np.testing.assert_array_equal(emissions[0], illuminant("D65", EYES))
    np.testing.assert_allclose(emissions @ EYES.cmfs[:, 1] * EYES.step_nm, 1, rtol=1e-12)
    green = EYES.wavelengths_nm == 540
    assert (emissions[1:, green] < 1e-2 * emissions[1:].max(axis=1, keepdims=True)).all()


@pytest.mark.parametrize("name", ["D65", "FL11", "1000 K"])
def test_the_starts_along_each_ray_have_the_colours_they_stand_for(name):
    table = build_table(light(name), observer=EYES, space=rgb_space("ITU-R BT.2020"))
    fan = table.fan
    odds = np.exp(FIRST_ROW + ROW_STEP * np.arange(fan.nodes.shape[1]))
    luminance = np.linalg.inv(table.axes @ table.space.rgb_from_xyz)[1]
    for ray in range(0, len(fan.reach), 7):
        ends = np.linalg.inv(fan.sectors[ray])  # columns: white, this ray's end, the next ray's
        for row in range(0, fan.reach[ray], 3):
            c0, c1, c2, middle, bright = fan.nodes[ray, row]
            d = table.t - middle
            shown = table.weights @ sigmoid((c0 * d + c1) * d + c2) / np.exp(bright)
            asked = (ends[:, 0] + odds[row] * ends[:, 1]) / (1 + odds[row])
            assert np.abs(shown - asked).max() < START * min(luminance @ asked, asked.max())


def test_the_sectors_of_a_fan_cover_every_direction_once():
    table = build_table(light("FL2"), observer=EYES, space=rgb_space("sRGB"))
    colours = np.random.default_rng(33).normal(0.4, 0.5, (500, 3))
    shares = table.fan.sectors @ colours.T  # [M, 3, 500]
    held = ((shares[:, 1] >= 0) & (shares[:, 2] >= 0)).sum(axis=0)
    assert (held == 1).all()
    # The corner of a sector is the border: α is positive exactly inside of the cone.
    alpha = np.where((shares[:, 1] >= 0) & (shares[:, 2] >= 0), shares[:, 0], 0).sum(axis=0)
    margin = (colours @ table.cone.T).min(axis=1)
    clear = np.abs(margin) > 1e-4
    np.testing.assert_array_equal(alpha[clear] > 0, margin[clear] > 0)


@pytest.mark.parametrize("narrow", [3.0, 300.0, 3e4])
def test_stored_coefficients_are_the_polynomial_about_its_summit(narrow):
    a, b = normalisation(EYES)
    rng = np.random.default_rng(34)
    errors = []
    for _ in range(60):
        given = (-narrow * rng.uniform(0.5, 1), 0.0, rng.normal(), rng.uniform(-0.9, 0.9))
        *c, middle = in_nm(*given, a, b)
        found = [Fraction(float(v)) for v in stored(*c, middle, TRIES)]
        nm = Fraction(float(middle))
        errors.append(abs(float((found[0] * nm + found[1]) * nm + found[2] - Fraction(float(c[2])))))
        # Rounded one by one the three would leave three times as much.
        assert errors[-1] <= 0.51 * np.spacing(abs(float(found[2])))
    # Near 512 nm, a power of two, and a few other places nothing is left to choose.
    assert np.quantile(errors, 0.8) < 1e-12


def test_about_the_summit_the_polynomial_is_the_same():
    t = np.linspace(-1, 1, 9)
    for c in [(-30.0, 4.0, 1.0), (0.5, 1.0, -1.0), (50.0, 400.0, 1.0)]:
        c0, c1, c2, middle = about(*c, 0.0)
        d = t - middle
        np.testing.assert_allclose((c0 * d + c1) * d + c2, (c[0] * t + c[1]) * t + c[2], rtol=1e-13, atol=1e-12)
        assert -1 <= middle <= 1 and (abs(c[0]) >= 2 or middle == 0)


@pytest.mark.parametrize("k", [2.0**-60, 2.0**77])
def test_colours_near_the_border_scale_exactly_by_powers_of_two(k):
    rgb = saturated((10, 40), seed=35)
    once, scaled = uplifted(rgb, "FL2")[0], uplifted(k * rgb, "FL2")[0]
    np.testing.assert_array_equal(once.coefficients, scaled.coefficients)
    np.testing.assert_array_equal(once.scale * k, scaled.scale)
    np.testing.assert_array_equal(once.status, scaled.status)


def test_white_in_a_space_with_another_white_is_exact_too():
    space = rgb_space("ACEScg")
    w = rgb_weights(light("A"), EYES, space).sum(axis=1)
    result, difference = uplifted(w.reshape(1, 1, 3), "A", space=space)
    level = 1 / BRIGHTNESS
    grey = (level - 0.5) / np.sqrt(level * (1 - level))
    np.testing.assert_allclose(result.coefficients, [[[0, 0, grey]]], atol=1e-12)
    assert difference.max() < 1e-10
