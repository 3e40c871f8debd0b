"""The sky of synthetic lat-long maps, and maps that have none."""

import os
from pathlib import Path

import numpy as np
import pytest

from tests.uplift.relit import SPACE, WEIGHTS, open_air, room
from uplift import UpliftError
from uplift.sky import find_sky

LUMINANCE = SPACE.luminance_weights
ROWS_640 = 320  # of the map on which the border is found: its rows are the unit of the border's accuracy


@pytest.mark.parametrize("sun", [False, True])
@pytest.mark.parametrize("height", [64, 160, 512])
def test_a_sky_ends_where_it_was_made_to_end(height, sun):
    sky = find_sky(open_air(height=height, sun=sun), LUMINANCE)
    assert sky.present
    tolerance = max(1.0, 3.0 * height / ROWS_640)  # the Sobel operator is three rows wide
    assert np.abs(sky.border - height / 2).max() <= tolerance + 1
    assert sky.mask[: int(height / 2 - tolerance - 1)].all()
    assert not sky.mask[int(height / 2 + tolerance + 1) :].any()


def test_the_sun_belongs_to_the_sky():
    image = open_air(height=128)
    assert find_sky(image, LUMINANCE).mask[image[..., 0] > 100].all()


def test_a_house_against_the_sky_is_not_sky():
    image = open_air(height=128)
    image[40:64, 100:150] = 0.05
    sky = find_sky(image, LUMINANCE)
    assert sky.present
    assert not sky.mask[44:, 103:147].any()
    assert sky.mask[:38].all()


def test_turning_the_map_turns_the_sky():
    image = open_air(height=160)
    image[60:80, 100:150] = 0.05
    turned = find_sky(np.roll(image, 90, axis=1), LUMINANCE)
    differs = turned.mask != np.roll(find_sky(image, LUMINANCE).mask, 90, axis=1)
    assert differs.mean() < 1e-3  # enlarging a small map does not wrap around at its seam


def test_the_scale_of_the_map_changes_nothing():
    image = open_air(height=64)
    np.testing.assert_array_equal(find_sky(image * 1024.0, LUMINANCE).mask, find_sky(image, LUMINANCE).mask)


def test_rooms_have_no_sky():
    for lamps in (["D65"], ["A"], ["LED-B3", "A"]):
        assert not find_sky(room(lamps, tile=8), LUMINANCE).present


def test_a_smooth_ceiling_that_ends_far_above_the_horizon_is_no_sky():
    image = room(["D65"], in_view=False, height=128)
    image[:44] = 0.9
    sky = find_sky(image, LUMINANCE)
    assert not sky.present
    assert not sky.mask.any()


@pytest.mark.parametrize("value", [0.0, 1.0, np.nan, np.inf, -1.0])
def test_a_map_without_any_gradient_has_no_sky(value):
    sky = find_sky(np.full((32, 64, 3), value, np.float32), LUMINANCE)
    assert not sky.present
    assert sky.mask.shape == (32, 64)
    assert (sky.border == 0).all()


def test_a_gradient_without_a_ground_has_no_sky():
    ramp = np.linspace(0.5, 1.5, 64, dtype=np.float32)[:, np.newaxis, np.newaxis]
    assert not find_sky(np.broadcast_to(ramp, (64, 128, 3)), LUMINANCE).present


def test_missing_pixels_do_not_hide_the_sky():
    image = open_air(height=160)
    image[100:104, 30:40] = np.nan
    image[150, 5] = np.inf
    assert find_sky(image, LUMINANCE).present


def test_tiny_maps_are_answered():
    for shape in ((1, 1, 3), (2, 4, 3), (3, 1, 3)):
        assert find_sky(np.random.default_rng(0).random(shape).astype(np.float32), LUMINANCE).mask.shape == shape[:2]


def test_another_shape_is_refused():
    with pytest.raises(UpliftError, match=r"expected a lat-long map \[H, W, 3\]"):
        find_sky(np.zeros((4, 4), np.float32), LUMINANCE)


def _data() -> Path:
    if "ENVCAL_DATA" not in os.environ:
        pytest.skip("ENVCAL_DATA is not set to a folder with truth/*.npz")
    return Path(os.environ["ENVCAL_DATA"])


def test_rendered_skies_have_a_sky_and_rendered_rooms_none():
    truth = _data() / "truth"
    for path in sorted(truth.glob("outdoor_*.npz")):
        with np.load(path) as file:
            grid = np.arange(380.0, 781.0, 5.0)
            weights = np.array([np.interp(file["wavelengths"], grid, row) for row in WEIGHTS])
            image = (file["radiance"].astype(np.float32) @ weights.T).astype(np.float32)
        assert find_sky(image, LUMINANCE).present, path.name
    for path in sorted(truth.glob("room*.npz")):
        with np.load(path) as file:
            transport = file["transport"].astype(np.float32).sum(axis=0)
        weights = WEIGHTS[:, ::2]
        assert not find_sky((transport @ weights.T).astype(np.float32), LUMINANCE).present, path.name
