"""The shares of lights in a pixel: tables held against a slow loop, and properties."""

import numba
import numpy as np
import pytest

from tests.uplift.relit import SPACE, emission_rgb, room
from uplift.cluster.evidence import lamps_or_surfaces, view_of
from uplift.cluster.membership import COLOURS, members, membership, mixtures

LAMPS = ("D65", "A", "HP1")
FLOAT32 = 1e-4  # of a weight; sums of 15 float32 products


def tables_of(image, colours):
    view = view_of(image, SPACE.luminance_weights, None)
    found = lamps_or_surfaces(view)
    each = colours / np.linalg.norm(colours, axis=1, keepdims=True)
    owner = np.argmax(found.rgb @ each.T, axis=1)
    return membership(view, colours, found, owner, luminance_weights=SPACE.luminance_weights, lamp_above=found.above)


@pytest.fixture(scope="module")
def scene():
    image = room(list(LAMPS))
    return image, tables_of(image, np.stack([emission_rgb(name) for name in LAMPS]))


@pytest.mark.parametrize("count", range(1, 7))
def test_mixtures_sum_to_one_are_all_different_and_begin_with_the_pure_lights(count):
    ways = mixtures(count)
    np.testing.assert_allclose(ways.sum(axis=1), 1.0)
    assert len(np.unique(ways, axis=0)) == len(ways)
    np.testing.assert_array_equal(ways[:count], np.eye(count))


def test_every_pixel_is_that_of_a_slow_loop(scene):
    image, tables = scene
    found = members(image, tables)
    height, width = image.shape[:2]
    rows, columns = tables.place.shape[:2]
    for y in range(0, height, 5):
        for x in range(0, width, 7):
            rgb = image[y, x].astype(np.float64)
            r, b = (min(int(rgb[i] / rgb.sum() * COLOURS), COLOURS - 1) for i in (0, 2))
            likely = tables.colour[r, b].astype(np.float64)
            if rgb @ SPACE.luminance_weights > tables.lamp_above:
                assert found.first[y, x] == found.second[y, x] == np.argmax(likely[:3])
                assert found.weight[y, x] == 1
                continue
            probable = likely * tables.place[y * rows // height, x * columns // width]
            share = probable @ tables.shares
            best, second = np.argsort(-share)[:2]
            assert (found.first[y, x], found.second[y, x]) == (best, second)
            assert found.weight[y, x] == pytest.approx(share[best] / (share[best] + share[second]), abs=FLOAT32)


def test_the_number_of_threads_changes_no_bit(scene):
    image, tables = scene
    threads = numba.get_num_threads()
    both = members(image, tables)
    numba.set_num_threads(1)
    try:
        one = members(image, tables)
    finally:
        numba.set_num_threads(threads)
    np.testing.assert_array_equal(one.first, both.first)
    np.testing.assert_array_equal(one.weight, both.weight)


def test_a_rank_renames_the_lights(scene):
    image, tables = scene
    rank = np.array([2, 0, 1])
    np.testing.assert_array_equal(members(image, tables, rank=rank).first, rank[members(image, tables).first])


def test_of_a_floor_of_a_mean_colour_the_nearer_lamp_has_more():
    """Two lamps of one strength on opposite walls of a room of their mean colour: each has more of its own side."""
    cool, warm = emission_rgb("D65"), emission_rgb("A")
    image = np.repeat(np.repeat((0.5 * (cool + warm))[np.newaxis, np.newaxis], 64, 0), 128, 1)
    image[30:33, 31:34], image[30:33, 95:98] = 400 * cool, 400 * warm
    found = members(image.astype(np.float32), tables_of(image.astype(np.float32), np.stack([cool, warm])))
    share = np.where(found.first == 0, found.weight, 1 - found.weight)
    own, others = share[48:54, 28:37].mean(), share[48:54, 92:101].mean()
    assert own > 0.505 and others < 0.495
    assert own + others == pytest.approx(1, abs=0.01)


def test_black_and_missing_pixels_have_the_first_light_alone(scene):
    image, tables = scene
    spoilt = image.copy()
    spoilt[3, :4] = [[0, 0, 0], [np.nan, 1, 1], [np.inf, 1, 1], [-1, -1, -1]]
    found = members(spoilt, tables)
    assert not found.first[3, :4].any() and not found.second[3, :4].any()
    assert (found.weight[3, :4] == 1).all()
