"""How many lamps a map shows, which pixels they light, and that nothing but the map decides it."""

import numpy as np
import pytest

from tests.uplift.relit import OBSERVER, SPACE, emission_rgb, open_air, room
from uplift import UpliftError
from uplift.cct import cct_duv, xy_of_rgb
from uplift.cluster import cluster_angles
from uplift.illuminants import cct_duv_of
from uplift.sky import find_sky
from uplift.spectrum import illuminant

SAME_CCT = 0.005  # lamps in view are read off; the rest is float32 and what lies beside them in a pixel
WHITE_GUESS = 0.25  # surfaces of random colours are on average no white


def clusters_of(image, **settings):
    return cluster_angles(image, luminance_weights=SPACE.luminance_weights, xyz_from_rgb=SPACE.xyz_from_rgb, **settings)


def ccts(clusters):
    return np.sort(cct_duv(xy_of_rgb(clusters.lamps, SPACE.xyz_from_rgb))[0])


def true_ccts(lamps):
    return np.sort([cct_duv_of(illuminant(name, OBSERVER), OBSERVER)[0] for name in lamps])


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    "lamps",
    [
        ["LED-B3"],
        ["A"],
        ["FL11"],
        ["LED-B3", "A"],
        ["LED-B4", "A"],
        ["D65", "LED-B1"],
        ["D65", "FL2"],
        ["D65", "LED-B3", "HP1"],
    ],
)
def test_as_many_clusters_as_lamps_in_view_each_of_its_cct(lamps, seed):
    clusters = clusters_of(room(lamps, seed=seed))
    assert clusters.count == len(lamps)
    assert clusters.direct.all()
    np.testing.assert_allclose(ccts(clusters), true_ccts(lamps), rtol=SAME_CCT)


def test_lamps_too_alike_to_be_told_apart_are_one():
    assert clusters_of(room(["LED-B1", "A"])).count == 1  # 16 mired


def test_a_coloured_wall_beside_a_lamp_is_no_lamp():
    image = room(["LED-B3"])
    image[20:44, 40:90] = 3.0 * emission_rgb("LED-B3") * np.array([0.9, 0.4, 0.1])
    clusters = clusters_of(image)
    assert clusters.count == 1
    np.testing.assert_allclose(ccts(clusters), true_ccts(["LED-B3"]), rtol=SAME_CCT)


def test_without_a_lamp_in_view_the_brightest_surfaces_speak():
    one = clusters_of(room(["A"], in_view=False, height=128))
    assert one.count == 1
    assert not one.direct.any()
    np.testing.assert_allclose(ccts(one), true_ccts(["A"]), rtol=WHITE_GUESS)
    two = clusters_of(room(["D65", "A"], in_view=False, height=128))
    assert two.count == 2
    np.testing.assert_allclose(ccts(two), true_ccts(["D65", "A"]), rtol=WHITE_GUESS)


def test_a_lamp_lights_what_is_nearest_to_its_colour():
    image = room(["D65", "A"])
    clusters = clusters_of(image)
    cool = int(np.argmax(cct_duv(xy_of_rgb(clusters.lamps, SPACE.xyz_from_rgb))[0]))
    white = image.copy()
    white[32:] = emission_rgb("D65")
    white[48:] = emission_rgb("A")
    labels = clusters_of(white).labels
    assert (labels[32:48] == labels[33, 0]).all()
    assert (labels[48:] == labels[50, 0]).all()
    assert labels[33, 0] != labels[50, 0]
    assert clusters.labels[16, 17] == cool  # the lamp itself


def test_two_runs_are_alike_to_the_last_bit():
    image = room(["D65", "A"])
    first, second = clusters_of(image), clusters_of(image)
    np.testing.assert_array_equal(first.labels, second.labels)
    np.testing.assert_array_equal(first.lamps, second.lamps)


@pytest.mark.parametrize("evidence", ["lamps", "bright"])
@pytest.mark.parametrize("scale", [2.0**-20, 2.0**12])
def test_the_scale_of_the_map_changes_nothing(evidence, scale):
    image = room(["D65", "A"])
    first, second = clusters_of(image, evidence=evidence), clusters_of(np.float32(scale) * image, evidence=evidence)
    np.testing.assert_array_equal(first.labels, second.labels)
    np.testing.assert_allclose(second.lamps, scale * first.lamps, rtol=1e-9)
    np.testing.assert_allclose(first.share, second.share, rtol=1e-9)


def test_turning_the_map_turns_the_labels():
    image = room(["D65", "A"])
    turned = clusters_of(np.roll(image, 40, axis=1))
    first = clusters_of(image)
    # cells of the tables stand elsewhere among the pixels after a turn
    assert (turned.labels != np.roll(first.labels, 40, axis=1)).mean() < 0.002
    np.testing.assert_allclose(turned.lamps, first.lamps, rtol=1e-4)  # as what they throw back is told by the cells


def test_half_of_the_light_of_a_white_wall_between_two_lamps_is_each_ones():
    image = room(["D65", "A"])
    image[40:44] = 0.5 * emission_rgb("D65") + 0.5 * emission_rgb("A")
    image[50:54] = emission_rgb("A")
    clusters = clusters_of(image)
    warm = int(np.argmin(cct_duv(xy_of_rgb(clusters.lamps, SPACE.xyz_from_rgb))[0]))
    share = np.where(clusters.labels == warm, clusters.weight, 1 - clusters.weight)
    assert (clusters.labels != clusters.second)[40:44].all()
    assert ((clusters.weight >= 0.5) & (clusters.weight <= 1)).all()
    assert abs(share[41:43].mean() - 0.5) < 0.2  # a mean over mixtures in steps of a quarter, drawn to what is around
    assert share[51:53].mean() > share[41:43].mean() + 0.15


def test_the_patterns_of_a_carpet_have_one_light():
    """Under a cool lamp right above, the warm tiles of a floor stay with it, though a warm lamp stands far off."""
    image = room(["D65", "A"], height=128)
    cool, warm = emission_rgb("D65"), emission_rgb("A")
    image[:] = 0.6 * cool
    image[30:34, 60:66] = 2000.0 * cool
    image[60:63, 200:203] = 400.0 * warm
    image[96:] = 0.5 * cool
    tiles = np.add.outer(np.arange(32) // 4, np.arange(256) // 4) % 2 > 0
    image[96:][tiles] = 0.25 * cool * np.array([1.25, 0.95, 0.6])
    clusters = clusters_of(image.astype(np.float32))
    nearest = np.argmax(image @ (clusters.lamps / np.linalg.norm(clusters.lamps, axis=1, keepdims=True)).T, axis=2)
    first = clusters.labels[32, 63]
    under = np.s_[100:124, 40:90]
    assert clusters.count == 2
    assert (clusters.labels[under] == first).mean() > 0.98
    assert (nearest[under] == first).mean() <= (clusters.labels[under] == first).mean()


def test_the_sky_is_the_outdoor_lights_alone():
    image = open_air(height=128, sun=False)
    image[76:84, 100:108] = 300.0 * emission_rgb("HP1")
    sky = find_sky(image, SPACE.luminance_weights)
    clusters = clusters_of(image, sky=sky)
    outdoor = int(np.argmax(clusters.outdoor))
    assert (clusters.labels[sky.mask] == outdoor).all()
    assert (clusters.weight[sky.mask] == 1).all()


def test_a_panels_own_colour_is_found_behind_what_it_throws_back():
    """A panel only ten times as bright as the walls, which another lamp lights: its reflected part is taken off."""
    own, other = emission_rgb("FL7"), emission_rgb("HP1")
    image = np.repeat(np.repeat((0.7 * other)[np.newaxis, np.newaxis], 64, 0), 128, 1)
    image[20:28, 10:24] = 12.0 * own + 1.0 * other
    image[20:23, 80:83] = 60.0 * other
    clusters = clusters_of(image.astype(np.float32))
    seen = ccts(clusters)
    mixed = cct_duv(xy_of_rgb(12.0 * own + 1.0 * other, SPACE.xyz_from_rgb))[0]
    true = true_ccts(["FL7"])[0]
    assert clusters.count == 2
    assert abs(seen.max() / true - 1) < 0.5 * abs(mixed / true - 1)


def test_two_lamps_that_a_third_ones_light_makes_look_alike_are_two():
    """D55 and D65 are 28 mired apart; a window of D65 that throws back tungsten light from the walls looks 15 away."""
    day, window, bulb = emission_rgb("D55"), emission_rgb("D65"), emission_rgb("A")
    image = np.repeat(np.repeat((0.7 * bulb)[np.newaxis, np.newaxis], 64, 0), 128, 1)
    image[20:28, 10:24] = 8.0 * window + 0.7 * bulb
    image[20:23, 80:83] = 60.0 * bulb
    image[30:34, 60:64] = 60.0 * day
    seen = 1e6 / cct_duv(xy_of_rgb(np.stack([day, image[22, 12]]), SPACE.xyz_from_rgb))[0]
    assert abs(seen[0] - seen[1]) < 16
    clusters = clusters_of(image.astype(np.float32))
    assert clusters.count == 3
    np.testing.assert_allclose(
        ccts(clusters), true_ccts(["D65", "D55", "A"]), rtol=0.02
    )  # of what is taken off, a guess


def test_shares_are_ordered_and_add_up_and_places_hold_their_lamp():
    clusters = clusters_of(room(["D65", "A", "LED-B3"]))
    assert clusters.share.sum() == pytest.approx(1.0)
    assert (np.diff(clusters.share) <= 0).all()
    for one in range(clusters.count):
        u, v = clusters.at[one]
        assert clusters.labels[int(v * 64), int(u * 128)] == one


@pytest.mark.parametrize("left", [40, 120, 0])  # 120: across the seam
def test_the_place_of_an_evenly_lit_panel_is_its_middle(left):
    image = 0.2 * room(["A"], in_view=False)
    columns = np.arange(left, left + 17) % 128
    image[np.ix_(np.arange(20, 31), columns)] = 200.0 * emission_rgb("A")
    u, v = clusters_of(image).at[0]
    assert u == pytest.approx((left + 8.5) / 128 % 1.0, abs=1e-9)
    # Rows nearer to the pole are shorter, so the middle of the solid angle stands a little below that of the rows.
    assert v == pytest.approx(25.5 / 64, abs=1.01 / 64)


def test_of_two_panels_the_place_is_the_middle_of_one_and_on_a_ring_it_is_on_the_ring():
    image = 0.2 * room(["A"], in_view=False)
    for left in (30, 90):
        image[20:29, left : left + 9] = 200.0 * emission_rgb("A")
    u, v = clusters_of(image).at[0]
    assert min(abs(u * 128 - 34.5), abs(u * 128 - 94.5)) < 1e-6
    ring = 0.2 * room(["A"], in_view=False)
    ring[20:41, 50:71] = 200.0 * emission_rgb("A")
    ring[24:37, 54:67] = 0.2 * emission_rgb("A")
    u, v = clusters_of(ring).at[0]
    assert ring[int(v * 64), int(u * 128)].max() > 100


def test_light_from_everywhere_has_some_place_and_always_the_same():
    image = np.full((32, 64, 3), 0.7, np.float32)
    assert clusters_of(image).at.tolist() == clusters_of(image).at.tolist()


def test_a_large_map_has_the_clusters_of_its_small_copy():
    small = room(["D65", "A"], height=64)
    large = small.repeat(16, 0).repeat(16, 1)
    np.testing.assert_allclose(ccts(clusters_of(large)), ccts(clusters_of(small)), rtol=SAME_CCT)
    assert clusters_of(large).labels.shape == (1024, 2048)


def test_missing_black_and_negative_pixels_are_cluster_zero_and_change_no_lamp():
    image = room(["D65", "A"])
    spoilt = image.copy()
    spoilt[60, 3] = np.nan
    spoilt[60, 4] = [np.inf, 1.0, 1.0]
    spoilt[60, 5] = 0.0
    spoilt[60, 6] = -1.0
    spoilt[60, 7] = [-0.5, 0.2, 0.2]
    clusters = clusters_of(spoilt)
    assert (clusters.labels[60, 3:7] == 0).all()
    assert np.isfinite(clusters.means).all()
    np.testing.assert_allclose(ccts(clusters), true_ccts(["D65", "A"]), rtol=SAME_CCT)


@pytest.mark.parametrize("value", [0.0, np.nan, -1.0])
def test_a_map_without_light_is_one_cluster_with_a_warning(value):
    clusters = clusters_of(np.full((8, 16, 3), value, np.float32))
    assert clusters.count == 1
    assert not clusters.labels.any()
    assert "no light" in clusters.warnings[0]


@pytest.mark.parametrize("evidence", ["lamps", "bright"])
@pytest.mark.parametrize("shape", [(1, 1, 3), (2, 4, 3), (32, 64, 3)])
def test_a_constant_map_is_one_cluster(shape, evidence):
    clusters = clusters_of(np.full(shape, 0.3, np.float32), evidence=evidence)
    assert clusters.count == 1
    np.testing.assert_allclose(clusters.means, 0.3, rtol=1e-6)
    np.testing.assert_allclose(ccts(clusters), true_ccts(["D65"]), rtol=1e-6)


def test_one_outdoor_cluster_under_an_open_sky_whose_light_is_sky_and_sun():
    image = open_air(height=128)
    sky = find_sky(image, SPACE.luminance_weights)
    clusters = clusters_of(image, sky=sky)
    assert clusters.count == 1
    assert clusters.outdoor.tolist() == [True]
    cosine = np.cos(np.pi * (np.arange(64) + 0.5) / 128) * np.sin(np.pi * (np.arange(64) + 0.5) / 128)
    level = (image[:64] * cosine[:, np.newaxis, np.newaxis]).sum(axis=(0, 1))
    np.testing.assert_allclose(clusters.lamps[0] / clusters.lamps[0].sum(), level / level.sum(), rtol=0.01)


def test_a_street_lamp_at_dusk_is_a_second_cluster_and_not_outdoors():
    image = open_air(height=128, sun=False)
    image[76:84, 100:108] = 300.0 * emission_rgb("HP1")
    clusters = clusters_of(image, sky=find_sky(image, SPACE.luminance_weights))
    assert clusters.count == 2
    assert clusters.outdoor.sum() == 1
    np.testing.assert_allclose(ccts(clusters)[0], true_ccts(["HP1"])[0], rtol=SAME_CCT)


def test_the_papers_method_has_at_most_six_clusters_none_alike_and_one_outdoors():
    clusters = clusters_of(room(["D65", "A"], in_view=False), evidence="bright")
    assert 1 <= clusters.count <= 6
    image = open_air(height=128)
    assert clusters_of(image, sky=find_sky(image, SPACE.luminance_weights), evidence="bright").outdoor.sum() == 1


def test_k_max_bounds_the_count():
    assert clusters_of(room(["D65", "A", "LED-B3"]), k_max=2).count <= 2
    assert clusters_of(room(["D65", "A", "LED-B3"]), k_max=1).count == 1


def test_mistakes_are_refused():
    image = room(["A"])
    with pytest.raises(UpliftError, match=r"expected \[H, W, 3\]"):
        clusters_of(image[..., 0])
    with pytest.raises(UpliftError, match="k_max 0"):
        clusters_of(image, k_max=0)
    with pytest.raises(UpliftError, match="evidence 'dark'"):
        clusters_of(image, evidence="dark")
    with pytest.raises(UpliftError, match="sky mask of shape"):
        clusters_of(image, sky=find_sky(open_air(height=32), SPACE.luminance_weights))


def test_the_map_is_not_changed():
    image = room(["D65", "A"])
    before = image.copy()
    clusters_of(image)
    np.testing.assert_array_equal(image, before)


def test_a_light_is_placed_in_its_lamp_and_not_on_the_rim_of_a_brighter_one():
    """A rim mixes colours: single pixels there may have the other lamp's colour and be brighter than that lamp."""
    height, width = 256, 512
    image = np.full((height, width, 3), 0.05, np.float32)
    image[40:80, 60:140] = [1.0, 1.0, 1.25]
    image[120:140, 300:320] = [40.0, 24.0, 10.0]
    image[120:140:3, 320] = [16.0, 16.0, 20.0]
    found = cluster_angles(image, luminance_weights=SPACE.luminance_weights, xyz_from_rgb=SPACE.xyz_from_rgb)
    places = {(40 <= v * height < 80 and 60 <= u * width < 140, 120 <= v * height < 140) for u, v in found.at}
    assert found.count == 2
    assert places == {(True, False), (False, True)}
