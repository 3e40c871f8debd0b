"""What was clipped is counted as it covers the sphere, and filled only as asked."""

import numpy as np
import pytest

from calibrate import CalibrateError
from calibrate.lost import fill_lost, lost_share

CEILING = (100.0, 80.0, 120.0)


def lamp() -> np.ndarray:
    """A lamp of colour (4, 2, 1) whose middle is lost; its rim reaches half the ceiling."""
    image = np.full((40, 60, 3), 0.1, np.float32)
    image[10:30, 20:40] = np.array([40.0, 20.0, 10.0])
    image[14:26, 24:36] = np.nan
    return image


def test_the_share_of_a_map_is_that_of_the_sphere_and_of_a_picture_that_of_its_pixels() -> None:
    lost = np.zeros((90, 180), np.bool_)
    lost[:30] = True  # the cap down to 60° from the zenith
    assert lost_share(lost) == pytest.approx((1 - np.cos(np.pi / 3)) / 2, abs=1e-4)
    assert lost_share(lost[:, :100]) == pytest.approx(1 / 3)


def test_neighbours_lend_their_colour_at_the_least_radiance_that_explains_the_clipping() -> None:
    image = lamp()
    done = fill_lost(image, "neighbour", ceiling=CEILING)
    # Blue needs the most: 120 × (4, 2, 1).
    np.testing.assert_allclose(done.image[20, 30], [480, 240, 120], rtol=1e-6)
    assert (done.filled, done.left) == (144, 0)
    assert np.isnan(image).any()
    np.testing.assert_array_equal(done.image[~np.isnan(image)], image[~np.isnan(image)])


def test_a_channel_that_was_not_lost_sets_the_radiance() -> None:
    image = lamp()
    image[20, 30, 0] = 4000.0
    done = fill_lost(image, "neighbour", ceiling=CEILING)
    np.testing.assert_allclose(done.image[20, 30], [4000, 2000, 1000], rtol=1e-6)


def test_each_region_has_its_own_neighbours() -> None:
    image = np.concatenate([lamp(), lamp()[..., ::-1]], axis=1)
    done = fill_lost(image, "neighbour", ceiling=CEILING).image
    np.testing.assert_allclose(done[20, 30] / done[20, 30].max(), [1, 0.5, 0.25], rtol=1e-6)
    np.testing.assert_allclose(done[20, 90] / done[20, 90].max(), [0.25, 0.5, 1], rtol=1e-6)


def test_what_has_no_known_neighbour_stays_lost_and_is_counted() -> None:
    done = fill_lost(np.full((8, 8, 3), np.nan, np.float32), "neighbour", ceiling=CEILING)
    assert (done.filled, done.left) == (0, 64)
    assert np.isnan(done.image).all()


def test_a_declared_colour_stands_in_every_lost_pixel() -> None:
    done = fill_lost(lamp(), (1e6, 2e6, 3e6), ceiling=CEILING)
    np.testing.assert_array_equal(done.image[20, 30], np.float32([1e6, 2e6, 3e6]))
    assert done.filled == 144
    assert not np.isnan(done.image).any()


def test_a_picture_without_holes_is_returned_as_it_is() -> None:
    image = np.ones((6, 7, 3), np.float32)
    done = fill_lost(image, "neighbour", ceiling=CEILING)
    np.testing.assert_array_equal(done.image, image)
    assert done.filled == 0


@pytest.mark.parametrize("colour", [(-1.0, 0.0, 0.0), (float("nan"), 1.0, 1.0)])
def test_a_declared_colour_that_is_none_is_refused(colour: tuple[float, float, float]) -> None:
    with pytest.raises(CalibrateError, match=r"merge\.lost"):
        fill_lost(lamp(), colour, ceiling=CEILING)
