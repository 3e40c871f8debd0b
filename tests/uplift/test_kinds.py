"""What a light's colour says of its kind, and that it says no more than it knows."""

import numpy as np
import pytest

from uplift.illuminants.kinds import KINDS, kind_probabilities, known_lamps, left_out
from uplift.spectrum import observer

OBSERVER = observer()


@pytest.mark.parametrize(("cct", "duv"), [(2000.0, 0.0), (4000.0, 0.01), (6500.0, 0.003), (30_000.0, -0.02)])
def test_probabilities_sum_to_one(cct, duv):
    found = kind_probabilities(cct, duv, OBSERVER)
    assert set(found) == set(KINDS)
    assert sum(found.values()) == pytest.approx(1.0)
    assert min(found.values()) > 0


def test_a_light_far_above_the_locus_is_no_filament():
    assert kind_probabilities(2856.0, 0.0, OBSERVER)["incandescent"] > 0.35
    assert kind_probabilities(2856.0, 0.010, OBSERVER)["incandescent"] < 0.05
    assert kind_probabilities(6500.0, 0.003, OBSERVER)["incandescent"] < 0.02


def test_an_unsure_colour_says_less():
    sure = kind_probabilities(1960.0, 0.0, OBSERVER)
    unsure = kind_probabilities(1960.0, 0.0, OBSERVER, sigma_mired=200.0, sigma_duv=0.02)
    assert max(unsure.values()) < max(sure.values())


def test_without_a_colour_all_kinds_are_alike():
    assert set(kind_probabilities(float("nan"), 0.0, OBSERVER).values()) == {0.2}


def test_left_out_lamps_are_named_better_than_by_chance_and_no_more_surely_than_rightly():
    kinds, found = left_out(OBSERVER)
    weight = 1 / np.bincount(kinds)[kinds] / len(KINDS)
    right = (weight * (found.argmax(axis=1) == kinds)).sum()
    assert len(kinds) == len(known_lamps(OBSERVER)[0]) > 100
    assert right > 0.4
    assert (
        weight * found.max(axis=1)
    ).sum() <= right + 0.03  # a third of a standard deviation of `right` over 120 lamps
