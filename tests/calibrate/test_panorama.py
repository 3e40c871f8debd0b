import numpy as np
import pytest

from calibrate import CalibrateError
from calibrate.panorama import latlong_from_shots


def test_a_single_latlong_shot_passes_through_untouched():
    shot = np.random.default_rng(0).random((8, 16, 3)).astype(np.float32)
    assert latlong_from_shots([shot]) is shot


@pytest.mark.parametrize("count", [0, 2, 3])
def test_any_other_number_of_shots_is_refused(count):
    with pytest.raises(CalibrateError, match=rf"capture\.environment: {count} shots; expected exactly one"):
        latlong_from_shots([np.zeros((8, 16, 3), np.float32)] * count)


def test_a_shot_that_is_not_two_to_one_is_refused_with_its_size():
    with pytest.raises(CalibrateError, match=r"15×8 pixels.*twice as wide"):
        latlong_from_shots([np.zeros((8, 15, 3), np.float32)])


def test_a_shot_without_colour_is_refused():
    with pytest.raises(CalibrateError, match=r"shape \(8, 16\)"):
        latlong_from_shots([np.zeros((8, 16), np.float32)])
