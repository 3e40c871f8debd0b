"""Mixtures of two lights: their emissions, and which pixels have them."""

import numpy as np
import pytest

from tests.uplift.relit import OBSERVER
from uplift import UpliftError
from uplift.lights.mixtures import MOST_PAIRS, STEPS, mixtures_of
from uplift.spectrum import illuminant, xyz_of

NAMES = ("FL11", "LED-B3", "A")
LIGHTS = [illuminant(name, OBSERVER) for name in NAMES]


def mixtures(known=(True, True, True), shares=(0.5, 0.3, 0.2), room=50):
    return mixtures_of(LIGHTS, shares, known, room=room)


def test_every_pair_has_three_mixtures_of_luminance_one():
    found = mixtures()
    assert found.emissions.shape == (3 * (STEPS - 1), OBSERVER.wavelengths_nm.size)
    for emission in found.emissions:
        assert xyz_of(emission, OBSERVER)[1] == pytest.approx(1.0)


def test_labels_are_those_of_a_slow_loop_over_the_nearest_quarter():
    found = mixtures()
    rng = np.random.default_rng(0)
    first, second = (rng.integers(0, 3, 500).astype(np.uint32) for _ in range(2))
    weight = rng.uniform(0.5, 1.0, 500).astype(np.float32)
    every = [*LIGHTS, *found.emissions]
    for one, other, share, label in zip(first, second, weight, found.labels(first, second, weight), strict=True):
        part = round(float(share) * STEPS) / STEPS if one != other else 1.0
        np.testing.assert_allclose(every[label], part * LIGHTS[one] + (1 - part) * LIGHTS[other], atol=1e-15)


def test_a_light_of_unknown_spectrum_is_in_no_mixture():
    found = mixtures(known=(True, False, True))
    assert {part[:2] for part in found.parts} == {(0, 2)}
    one = np.array([0, 0], np.uint32)
    half = np.full(2, 0.5, np.float32)
    assert found.labels(one, np.array([1, 2], np.uint32), half).tolist() == [0, 4]


def test_the_pairs_with_most_light_come_first_where_room_is_scarce():
    found = mixtures(shares=(0.1, 0.5, 0.4), room=5)
    assert {part[:2] for part in found.parts} == {(1, 2)}
    assert not mixtures(room=2).parts
    many = mixtures_of([LIGHTS[0]] * 6, [1 / 6] * 6, [True] * 6, room=1000)
    assert len(many.parts) == MOST_PAIRS * (STEPS - 1)


def test_lists_of_different_lengths_are_refused():
    with pytest.raises(UpliftError, match="3 emissions, 2 shares and 3 known; expected one of each a light"):
        mixtures_of(LIGHTS, [0.5, 0.5], [True] * 3, room=9)
