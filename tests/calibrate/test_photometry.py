"""Luminance from the camera's settings and illuminance from a map, against furnaces, point lights and the standard's figures."""

import math

import numpy as np
import pytest

from calibrate import CalibrateError
from calibrate.photometry import (
    clipping_luminance,
    diffuser_luminance,
    exposure_gain,
    map_illuminance,
    plane_normal,
)

#: Sums of products in double precision.
ROUNDING = 1e-12
#: A pixel of the map below is 1.4° wide; its middle stands for all of it in the slow sum.
PIXEL = 2e-4


def test_the_standards_own_example_holds() -> None:
    # ISO 12232: H = 78/S; at ISO 100 that is 0.78 lx·s. L = H N² / (0.65 t).
    assert clipping_luminance(f_number=8, iso=100) == pytest.approx(0.78 * 64 / 0.65)
    # Sunny 16: a white diffuser under 100 000 lx is 31 831 cd/m²; at f/16, 1/100 s, ISO 100 it must not clip.
    assert clipping_luminance(f_number=16, iso=100) * 100 < 31_831 < 2 * clipping_luminance(f_number=16, iso=100) * 100


def test_a_stop_of_speed_or_aperture_is_a_factor_of_two() -> None:
    one = clipping_luminance(f_number=4, iso=200)
    assert clipping_luminance(f_number=4, iso=100) == pytest.approx(2 * one)
    assert clipping_luminance(f_number=4 * math.sqrt(2), iso=200) == pytest.approx(2 * one)


@pytest.mark.parametrize(
    ("f_number", "iso", "word"), [(0.0, 100.0, "f-number"), (8.0, -1.0, "ISO"), (math.nan, 1.0, "f-n")]
)
def test_settings_that_are_none_are_refused(f_number: float, iso: float, word: str) -> None:
    with pytest.raises(CalibrateError, match=word):
        clipping_luminance(f_number=f_number, iso=iso)


def test_the_gain_to_a_references_unit_is_the_ratio_of_the_clipping_luminances() -> None:
    gain = exposure_gain(iso=400, f_number=5.6, reference_iso=100, reference_f_number=8)
    expected = clipping_luminance(f_number=5.6, iso=400) / clipping_luminance(f_number=8, iso=100)
    assert gain == pytest.approx(expected, rel=ROUNDING)
    assert exposure_gain(iso=None, f_number=8, reference_iso=None, reference_f_number=4) == 4
    assert exposure_gain(iso=None, f_number=8, reference_iso=100, reference_f_number=8) is None
    assert exposure_gain(iso=100, f_number=None, reference_iso=100, reference_f_number=None) == 1


@pytest.mark.parametrize("toward", [None, 0.0, 0.13, 0.5, 0.77, 1.0])
def test_a_white_furnace_casts_pi_on_every_plane(toward: float | None) -> None:
    total, missing = map_illuminance(np.full((32, 64), 7.0), toward=toward)
    assert total == pytest.approx(7 * math.pi, rel=ROUNDING)
    assert missing == 0
    assert diffuser_luminance(total) == pytest.approx(7, rel=ROUNDING)


@pytest.mark.parametrize("toward", [None, 0.25, 0.6])
def test_any_map_agrees_with_a_slow_sum_over_its_directions(toward: float | None) -> None:
    height, width = 128, 256
    luminance = np.random.default_rng(3).uniform(0, 1, (height // 8, width // 8)).repeat(8, 0).repeat(8, 1)
    normal, total = plane_normal(toward), 0.0
    for y in range(height):
        theta = math.pi * (y + 0.5) / height
        for x in range(width):
            phi = 2 * math.pi * ((x + 0.5) / width - 0.5)
            direction = (math.sin(theta) * math.sin(phi), math.cos(theta), -math.sin(theta) * math.cos(phi))
            cosine = sum(a * b for a, b in zip(direction, normal, strict=True))
            total += luminance[y, x] * max(cosine, 0.0) * math.sin(theta) * 2 * math.pi**2 / (width * height)
    assert map_illuminance(luminance, toward=toward)[0] == pytest.approx(total, rel=PIXEL)


def test_light_behind_the_plane_does_not_count_and_missing_light_is_told() -> None:
    luminance = np.ones((32, 64))
    luminance[16:] = 1e6
    assert map_illuminance(luminance)[0] == pytest.approx(math.pi, rel=ROUNDING)
    luminance[:16] = np.nan
    luminance[0] = 1.0
    total, missing = map_illuminance(luminance)
    assert missing == pytest.approx(1 - total / math.pi, rel=ROUNDING)
    assert 0.9 < missing < 1


def test_a_plane_without_light_is_refused() -> None:
    dark = np.zeros((16, 32))
    dark[8:] = 1.0
    with pytest.raises(CalibrateError, match="horizontal plane"):
        map_illuminance(dark)
    behind = np.zeros((16, 32))
    behind[:, 14:18] = 1.0
    with pytest.raises(CalibrateError, match="vertical plane"):
        map_illuminance(behind, toward=0.0)
    assert map_illuminance(behind, toward=0.5)[0] > 0
