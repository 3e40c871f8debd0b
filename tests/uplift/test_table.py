"""Truth: the colour of each node, by a plain sum over the grid; the definition of a cone."""

import time

import numpy as np
import pytest

from tests.uplift.lights_for_tests import NAMES, light
from uplift import UpliftError
from uplift.gamut import DARKEST
from uplift.sigmoid import sigmoid
from uplift.spectrum import illuminant, observer, rgb_space, rgb_weights
from uplift.surface import USABLE
from uplift.table import BRIGHTNESS, build_table

EYES = observer()
RESIDUAL = 2e-12  # of the largest component; the solver stops at 1e-12, the rest is the order of summation
SECONDS = 3.0  # it takes 0.1 s; this leaves room for busy and slow machines


def node_colours(table):
    """Return what each node's reflectance looks like, and what it should, relative to its largest component."""
    n = table.solved.shape[1]
    polynomial = table.nodes[..., :3] @ np.stack([table.t**2, table.t, np.ones_like(table.t)])
    shown = sigmoid(polynomial) @ table.weights.T / table.nodes[..., 3:]
    ratio = np.arange(n) / (n - 1)
    asked = np.ones((3, n, n, 3))
    for m in range(3):
        asked[m, :, :, (m + 1) % 3] = ratio[:, None]
        asked[m, :, :, (m + 2) % 3] = ratio[None, :]
    return shown, asked


@pytest.mark.parametrize("space", ["ITU-R BT.2020", "sRGB"])
@pytest.mark.parametrize("name", NAMES)
def test_every_node_inside_the_gamut_is_solved(name, space):
    table = build_table(light(name), observer=EYES, space=rgb_space(space))
    shown, asked = node_colours(table)
    assert np.abs(shown - asked)[table.solved].max() < RESIDUAL
    # The pure primaries of BT.2020 are monochromatic, so their nodes and some beside them are at or over the border.
    assert table.solved.mean() > 0.999
    assert table.nodes[..., 3].max() == 1 / BRIGHTNESS and table.nodes[..., 3].min() > DARKEST


def test_the_light_itself_is_the_middle_of_its_axes():
    for name in NAMES:
        table = build_table(light(name), observer=EYES, space=rgb_space("ITU-R BT.2020"), factor=2)
        w = rgb_weights(table.emission, EYES, table.space).sum(axis=1)
        np.testing.assert_allclose(table.axes @ w, 1, atol=1e-12)
        np.testing.assert_allclose(table.weights.sum(axis=1), 1, atol=1e-12)
        np.testing.assert_array_equal(table.nodes[:, -1, -1], [[0, 0, 0, 0.5]] * 3)


@pytest.mark.parametrize(
    ("name", "space", "axes"),
    [
        ("D65", "sRGB", "sRGB"),
        ("1200 K", "sRGB", "ITU-R BT.2020"),
        ("1000 K", "ITU-R BT.2020", "ACES2065-1"),
        ("1000 K", "sRGB", "ACES2065-1"),
    ],
)
def test_lights_whose_blue_is_not_positive_take_wider_axes(name, space, axes):
    table = build_table(light(name), observer=EYES, space=rgb_space(space), nodes=16)
    assert table.axes_name == axes
    shown, asked = node_colours(table)
    assert np.abs(shown - asked)[table.solved].max() < RESIDUAL


def test_the_factor_sets_the_brightness_of_white():
    table = build_table(light("D65"), observer=EYES, space=rgb_space("sRGB"), nodes=16, factor=4.0)
    assert table.nodes[..., 3].max() == pytest.approx(0.25)
    shown, asked = node_colours(table)
    assert np.abs(shown - asked)[table.solved].max() < RESIDUAL


def test_where_light_is_left_the_level_is_the_factors_and_near_the_border_it_is_darker():
    wide = build_table(light("D65"), observer=EYES, space=rgb_space("ITU-R BT.2020"), nodes=32)
    levels = wide.nodes[..., 3]
    assert (levels <= 1 / BRIGHTNESS).all() and (levels[:, 16:, 16:] == 1 / BRIGHTNESS).all()
    # R = 1 where a component is positive shows more of it than any R < 1 that shows no more of the others.
    brightest = np.maximum(wide.weights, 0).sum(axis=1)
    assert (levels[:, 0, 0] < brightest).all() and (levels[:, 0, 0] < 0.25).all()


def test_grades_and_surface_belong_to_the_nodes():
    table = build_table(light("FL2"), observer=EYES, space=rgb_space("sRGB"), nodes=32)
    np.testing.assert_array_equal(table.surface[..., 0, :3], table.nodes[..., :3])
    np.testing.assert_allclose(table.surface[..., 0, 3] * table.nodes[..., 3], 1, rtol=1e-15)
    usable = table.grades & USABLE > 0
    np.testing.assert_array_equal(usable, np.isfinite(table.curvature))
    assert usable.mean() > 0.99 and usable[table.grades > 0].all()


def test_the_cone_holds_exactly_the_mixtures_of_the_lights_wavelengths():
    table = build_table(light("FL11"), observer=EYES, space=rgb_space("ITU-R BT.2020"), nodes=4)
    rng = np.random.default_rng(3)
    mixtures = (table.weights * rng.random((200, 1, 81)) ** 20).sum(axis=2)
    assert (mixtures @ table.cone.T).min() > 0
    assert ((-mixtures) @ table.cone.T).min(axis=1).max() < 0
    # A single wavelength is a corner or an edge: never outside by more than rounding, never well inside.
    columns = table.weights / np.abs(table.weights).max(axis=0)
    nearest = (columns.T @ table.cone.T).min(axis=1)
    assert nearest.max() < 1e-3


def test_a_table_is_the_same_on_any_number_of_threads_and_in_any_unit():
    import numba

    threads = numba.get_num_threads()
    whole = build_table(light("FL2"), observer=EYES, space=rgb_space("sRGB"))
    numba.set_num_threads(1)
    try:
        alone = build_table(light("FL2"), observer=EYES, space=rgb_space("sRGB"))
    finally:
        numba.set_num_threads(threads)
    np.testing.assert_array_equal(whole.nodes, alone.nodes)
    scaled = build_table(light("FL2") * 1024, observer=EYES, space=rgb_space("sRGB"))
    np.testing.assert_array_equal(whole.nodes, scaled.nodes)


def test_a_table_takes_a_moment():
    build_table(light("D65"), observer=EYES, space=rgb_space("sRGB"))
    start = time.perf_counter()
    build_table(light("A"), observer=EYES, space=rgb_space("ITU-R BT.2020"))
    assert time.perf_counter() - start < SECONDS


def line(*wavelengths_nm):
    return np.isin(EYES.wavelengths_nm, wavelengths_nm).astype(float)


@pytest.mark.parametrize(
    ("emission", "settings", "message"),
    [
        (line(590), {}, "fewer than three"),
        (line(450, 650), {}, "fewer than three"),
        (line(700), {}, "one wavelength|fewer than three"),
        (np.zeros(81), {}, "Y = 0"),
        (np.ones(81), {"nodes": 1}, "expected 2 to 1024"),
        (np.ones(81), {"factor": 1.0}, "more than 1"),
    ],
)
def test_what_makes_no_table_is_refused(emission, settings, message):
    with pytest.raises(UpliftError, match=message):
        build_table(emission, observer=EYES, space=rgb_space("ITU-R BT.2020"), **settings)


def test_three_lines_are_enough():
    table = build_table(line(450, 540, 620), observer=EYES, space=rgb_space("sRGB"), nodes=8)
    assert len(table.cone) == 3 and table.solved[:, -1, -1].all()


def test_other_grids_and_observers_work():
    eyes = observer(400, 700, 10, "CIE 1964 10 Degree Standard Observer")
    table = build_table(illuminant("FL2", eyes), observer=eyes, space=rgb_space("sRGB", observer=eyes), nodes=8)
    shown, asked = node_colours(table)
    assert table.solved.all() and np.abs(shown - asked).max() < RESIDUAL
