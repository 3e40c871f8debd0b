"""The Prague sky model's data file, in a small one of the same layout that is written here."""

import struct

import numpy as np
import pytest

from uplift import UpliftError
from uplift.illuminants import cct_duv_of, with_sky_model
from uplift.illuminants.prague import prague_nodes, prague_sunset, read_prague
from uplift.spectrum import observer

OBSERVER = observer()
VISIBILITIES, ALBEDOS, ALTITUDES = (20.0, 131.8), (0.0, 1.0), (0.0,)
ELEVATIONS, CHANNELS, START, WIDTH, RANK = (-4.2, 0.0, 8.0, 30.0), 11, 320.0, 40.0, 2
SUN, ZENITH, LAST = np.linspace(0, np.pi, 5), np.linspace(0, np.pi, 4), np.linspace(0, np.pi, 3)
HALF = 1e-3  # coefficients are 16-bit floats


def coefficients(visibility, albedo, elevation, channel):
    """Low suns are red, high ones blue; brighter near the sun and, by little, near the horizon."""
    warm = np.exp(-max(elevation, 0.0) / 6.0)
    colour = (1 - warm) + warm * 1.6 * channel / CHANNELS
    factor = colour * (1 + albedo) * (1 + 0.1 * (visibility < 100))
    sun = [factor * np.linspace(2, 1, 5), factor * np.linspace(0.3, 0.1, 5)]
    return sun, [np.linspace(1, 1.2, 4), np.linspace(0.5, 0.2, 4)], np.array([1.0, 1.5, 1.0])


def data_file(*, channels=CHANNELS, rank=RANK):
    out = b""
    for axis in (VISIBILITIES, ALBEDOS, ALTITUDES, ELEVATIONS):
        out += struct.pack("<i", len(axis)) + np.array(axis, "<f8").tobytes()
    out += struct.pack("<idd", channels, START, WIDTH) + struct.pack("<i", rank)
    for breaks in (SUN, ZENITH, LAST):
        out += struct.pack("<i", len(breaks)) + breaks.astype("<f8").tobytes()
    for visibility in VISIBILITIES:
        for albedo in ALBEDOS:
            for _ in ALTITUDES:
                for elevation in ELEVATIONS:
                    for channel in range(channels):
                        sun, zenith, last = coefficients(visibility, albedo, elevation, channel)
                        for term in range(rank):
                            out += sun[term].astype("<f2").tobytes() + struct.pack("<d", 7.0)
                            out += (7.0 * zenith[term]).astype("<f2").tobytes()
                        out += last.astype("<f2").tobytes()
    return np.frombuffer(out + b"\1" * 100, np.uint8)  # transmittance follows


def test_radiance_is_that_of_a_slow_evaluation_of_the_clearest_sky_over_black_ground():
    sky = read_prague(data_file())
    theta, azimuth, elevation = 1.1, 0.7, 8.0
    height = np.radians(elevation)
    gamma = np.arccos(np.cos(theta) * np.sin(height) + np.sin(theta) * np.cos(height) * np.cos(azimuth))
    lift = np.sqrt((6378050.0**2) - 6378000.0**2) / 6378050.0
    zero = np.arctan2(np.sin(theta), np.cos(theta) + lift)
    found = sky.radiance(elevation, np.array([theta]), np.array([azimuth]))[0]
    for channel in range(CHANNELS):
        sun, zenith, last = coefficients(131.8, 0.0, elevation, channel)
        value = sum(np.interp(gamma, SUN, s) * np.interp(zero, ZENITH, z) for s, z in zip(sun, zenith, strict=True))
        assert found[channel] == pytest.approx(value * np.interp(zero, LAST, last), rel=3 * HALF)


def test_between_elevations_radiance_is_linear():
    sky = read_prague(data_file())
    at = (np.array([0.8]), np.array([0.0]))
    assert len(sky.channels_nm) == CHANNELS and sky.channels_nm[0] == 340.0
    middle = sky.radiance(4.0, *at)
    low, high = (sky._at(i, 4.0, *at) for i in (1, 2))
    np.testing.assert_allclose(middle, (low + high) / 2, rtol=1e-12)


def test_the_nodes_rise_and_a_sunset_has_the_asked_temperature():
    nodes = prague_nodes(read_prague(data_file()), OBSERVER)
    ccts = [node.cct for node in nodes]
    assert ccts == sorted(ccts) and len(nodes) > 5
    wanted = (ccts[0] + ccts[-1]) / 2
    assert cct_duv_of(prague_sunset(nodes, wanted, OBSERVER), OBSERVER)[0] == pytest.approx(wanted, abs=0.05)
    with pytest.raises(UpliftError, match="out of range"):
        prague_sunset(nodes, ccts[0] - 100, OBSERVER)


def test_the_families_take_the_skies_for_sunsets_and_keep_the_others():
    families = with_sky_model(data_file())
    family = families["sunset"]
    assert family.low_k < family.high_k <= 5000
    assert "Prague" in family.source
    middle = (family.low_k + family.high_k) / 2
    assert cct_duv_of(family.emission(middle, OBSERVER), OBSERVER)[0] == pytest.approx(middle, abs=0.05)
    assert set(families) > {"daylight", "led"}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (data_file()[:10], "ends within its visibilities"),
        (data_file()[:-400], "Download the file again"),
        (np.frombuffer(b"#?RADIANCE" * 40, np.uint8), "Is it a data file"),
        (data_file(channels=3), "expected them to cover 400 to 700 nm"),
        (np.concatenate([data_file()[:4], data_file()[12:20], data_file()[4:12], data_file()[20:]]), "do not rise"),
    ],
)
def test_what_is_no_data_file_is_refused(data, message):
    with pytest.raises(UpliftError, match=message):
        read_prague(data)


def test_a_divisor_of_zero_is_refused_where_it_is_read():
    divisor, count = struct.pack("<d", 7.0), len(ELEVATIONS) * CHANNELS * RANK
    places, at = [], -1
    while (at := bytes(data_file()).find(divisor, at + 1)) >= 0:
        places.append(at)
    assert len(places) == count * len(VISIBILITIES) * len(ALBEDOS)
    for number, read in ((0, False), (2 * count, True), (3 * count - 1, True), (3 * count, False)):
        data = data_file().copy()
        data[places[number] : places[number] + 8] = 0
        if read:
            with pytest.raises(UpliftError, match="divisor"):
                read_prague(data)
        else:
            read_prague(data)
