"""The lamp as the difference of two pictures: what the scene adds is gone, and what else changed is refused."""

import dataclasses
import functools

import cv2
import numpy as np
import pytest

from calibrate import CalibrateError
from calibrate.lamp import find_lit_lamp, lamp_alone, measure_lamp

XYZ_FROM_RGB = np.array(
    [[0.6369580, 0.1446169, 0.1688810], [0.2627002, 0.6779981, 0.0593017], [0.0, 0.0280727, 1.0609851]]
)
SCENE = np.array([1.6, 1.0, 0.35])  # white in the scene's warm light
LAMP = np.array([0.7, 1.0, 0.9])
BOX = (slice(60, 90), slice(200, 216))
# Noise of 0.5 % of white a pixel, some 300 pixels inside: three standard errors of the mean.
READING = 0.005
SIGMA = np.float32(0.005)


@functools.cache
def room(brightness=1.0, dx=0.0, dy=0.0):
    """A view of 240×320 in the scene's light: blocks of many greys and hues, moved by (dx, dy) pixels."""
    rng = np.random.default_rng(3)
    blocks = rng.uniform(0.1, 0.9, (30, 40, 1)) * rng.uniform(0.7, 1.0, (30, 40, 3))
    image = cv2.resize(blocks.astype(np.float32), (320, 240), interpolation=cv2.INTER_NEAREST)
    image[BOX] = 0.7  # the lamp's own surface reflects as much as paper
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    moved = cv2.warpAffine(
        image, np.array([[1, 0, dx], [0, 1, dy]]), (320, 240), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )
    return (moved * SCENE * brightness).astype(np.float32)


def noisy(image, seed):
    return (image + SIGMA * np.random.default_rng(seed).standard_normal(image.shape)).astype(np.float32)


def lit(image, power=1.5, spill=0.02):
    """The view with the lamp on: its own light in its box, and some of it on everything, falling off."""
    y, x = np.mgrid[:240, :320]
    away = np.hypot(y - 75, x - 208)
    glow = image / SCENE * LAMP * (power * spill / (1 + (away / 60) ** 2))[..., None]
    out = image + glow.astype(np.float32)
    box = np.zeros((240, 320), np.float32)
    box[BOX] = power
    return (out + cv2.GaussianBlur(box, (0, 0), 0.6)[..., None] * LAMP).astype(np.float32)


def alone(on, off, **changes):
    sigma = np.full(on.shape, SIGMA)
    return lamp_alone(on, off, **{"sigma_on": sigma, "sigma_off": sigma, "white_rgb": SCENE, **changes})


@pytest.mark.parametrize("power", [0.3, 1.5, 30.0], ids=["dimmer than paper", "like paper", "bright"])
def test_the_lamps_own_light_is_read_whatever_its_surface_reflects(power):
    found = alone(noisy(lit(room(), power), 1), noisy(room(), 2))
    lamp = find_lit_lamp(found, found.light, xyz_from_rgb=XYZ_FROM_RGB)
    np.testing.assert_allclose(lamp.rgb, power * LAMP, rtol=max(READING, 0.002 / power) + 0.02 * 0.7)
    np.testing.assert_allclose(lamp.rgb / lamp.rgb[1], LAMP, rtol=READING)
    np.testing.assert_allclose(lamp.polygon.mean(axis=0), [207.5, 74.5], atol=1.0)
    assert found.warnings == ()


def test_one_picture_alone_reads_a_mixture_and_says_so():
    named = measure_lamp(noisy(lit(room()), 1), rectangle=(203, 64, 10, 22), xyz_from_rgb=XYZ_FROM_RGB)
    assert abs(named.rgb[2] / named.rgb[1] / LAMP[2] - 1) > 0.1
    assert any("may be light of the scene that it reflects" in text for text in named.warnings)
    found = alone(noisy(lit(room()), 1), noisy(room(), 2))
    apart = measure_lamp(found.light, rectangle=(203, 64, 10, 22), xyz_from_rgb=XYZ_FROM_RGB, alone=True)
    np.testing.assert_allclose(apart.rgb / apart.rgb[1], LAMP, rtol=READING)
    assert apart.warnings == ()


def test_the_lamps_light_on_the_room_is_no_change_of_the_room():
    found = alone(noisy(lit(room(), 5.0, spill=0.2), 1), noisy(room(), 2))
    assert abs(found.change) < 0.005
    assert found.darkened == 0.0
    assert np.hypot(*found.shift_px) < 0.05


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_a_change_of_the_scenes_light_is_measured_and_refused(factor):
    with pytest.raises(CalibrateError, match=r"own light differs by [+-](9\.9|10\.[01])%.*steady light"):
        alone(noisy(lit(room(factor)), 1), noisy(room(), 2))


def test_a_small_change_is_warned_about_with_its_size():
    found = alone(noisy(lit(room(1.02)), 1), noisy(room(), 2))
    assert found.change == pytest.approx(0.02, abs=0.003)
    assert any("changed by +2.0%" in text or "changed by +1.9%" in text or "+2.1%" in text for text in found.warnings)


@pytest.mark.parametrize("shift", [(0.8, 0.0), (0.4, -0.6), (7.0, 3.0)])
def test_a_camera_that_moved_is_refused_with_the_shift(shift):
    moved = room(1.0, *shift)
    with pytest.raises(CalibrateError, match=r"camera moved by \d+\.\d pixels.*tripod") as refused:
        alone(noisy(lit(moved), 1), noisy(room(), 2))
    said = float(str(refused.value).split("moved by ")[1].split(" ")[0])
    assert said == pytest.approx(np.hypot(*shift), rel=0.25)


def test_a_third_of_a_pixel_is_warned_about():
    found = alone(noisy(lit(room(1.0, 0.25, 0.2)), 1), noisy(room(), 2))
    # Slopes of edges a pixel wide come out a little too low, and shifts too high.
    assert np.hypot(*found.shift_px) == pytest.approx(0.32, rel=0.25)
    assert any("camera moved by 0." in text for text in found.warnings)


def test_somebody_in_one_of_the_pictures_is_refused():
    on = lit(room())
    on[100:230, 20:110] *= np.float32(0.3)
    with pytest.raises(CalibrateError, match=r"2\d% of the picture is darker.*nobody in view"):
        alone(noisy(on, 1), noisy(room(), 2))


def test_a_lamp_that_is_not_on_is_refused():
    found = alone(noisy(room(), 1), noisy(room(), 2))
    with pytest.raises(CalibrateError, match="nothing lights up between the brackets"):
        find_lit_lamp(found, found.light, xyz_from_rgb=XYZ_FROM_RGB)


def test_brackets_given_the_wrong_way_round_are_refused():
    with pytest.raises(CalibrateError, match=r"nothing lights up|darker"):
        found = alone(noisy(room(), 2), noisy(lit(room()), 1))
        find_lit_lamp(found, found.light, xyz_from_rgb=XYZ_FROM_RGB)


def test_a_clipped_lamp_is_refused_and_a_window_clipped_in_both_is_not_taken_for_it():
    on, off = noisy(lit(room()), 1), noisy(room(), 2)
    on[:40, :60] = off[:40, :60] = np.nan
    found = alone(on, off)
    lamp = find_lit_lamp(found, found.light, xyz_from_rgb=XYZ_FROM_RGB)
    np.testing.assert_allclose(lamp.rgb / lamp.rgb[1], LAMP, rtol=READING)
    on = on.copy()
    on[BOX] = np.nan
    found = alone(on, off)
    with pytest.raises(CalibrateError, match=r"clipped in \d+ of \d+ pixels.*shorter"):
        find_lit_lamp(found, found.light, xyz_from_rgb=XYZ_FROM_RGB)


def test_a_lamp_of_a_few_pixels_is_refused_and_two_lamps_are_told_of():
    off = room()
    on = off.copy()
    on[70:73, 200:204] += (3 * LAMP).astype(np.float32)
    found = alone(noisy(on, 1), noisy(off, 2))
    with pytest.raises(CalibrateError, match=r"covers \d pixels without its rim.*larger"):
        find_lit_lamp(found, found.light, xyz_from_rgb=XYZ_FROM_RGB)
    both = lit(off)
    both[180:205, 40:60] += (1.5 * LAMP).astype(np.float32)
    found = alone(noisy(both, 1), noisy(off, 2))
    lamp = find_lit_lamp(found, found.light, xyz_from_rgb=XYZ_FROM_RGB)
    assert any("another region of" in text for text in lamp.warnings)


def test_the_seam_of_a_map_does_not_hide_the_lamp():
    found = alone(noisy(lit(room()), 1), noisy(room(), 2))
    rolled = dataclasses.replace(
        found,
        light=np.roll(found.light, 112, axis=1),
        sigma=np.roll(found.sigma, 112, axis=1),
        clipped=np.roll(found.clipped, 112, axis=1),
    )
    lamp = find_lit_lamp(rolled, rolled.light, xyz_from_rgb=XYZ_FROM_RGB, latlong=True)
    np.testing.assert_allclose(lamp.rgb / lamp.rgb[1], LAMP, rtol=READING)
    assert lamp.polygon[:, 0].mean() % 320 == pytest.approx((207.5 + 112) % 320, abs=1.0)


def test_pictures_that_do_not_belong_together_or_show_too_little_are_refused():
    with pytest.raises(CalibrateError, match="300×240 pixels; the reference has 320×240"):
        alone(room(), room()[:, :300])
    dark = np.zeros((240, 320, 3), np.float32)
    with pytest.raises(CalibrateError, match="parts of the picture are seen well enough"):
        alone(noisy(dark, 1), noisy(dark, 2))
