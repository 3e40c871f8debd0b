"""The white furnace: a scene whose answer is known exactly goes through every stage in a row.

Every direction of the map has the same radiance with the spectrum of D65. Chart and lamp stand in another shot, under
D65 too. Whatever the camera's sensitivities and whatever the chart's matrix makes of them, the lamp and the scene
have one colour to the camera, so the map must come out white and its spectrum as D65's.
"""

from fractions import Fraction

import numpy as np
import pytest

from envcal import config, exr
from envcal.reporter import Reporter
from envcal.runner import run_pipeline
from envcal.stages import STAGES

# 16-bit counts of half the white level or more: half a count is this much of them. Three channels and the sums
# of a merge can each be off by as much.
QUANTISATION = 0.5 / 32_000 * 3


def write_furnace(folder, name, furnace, width, exposures):
    from samples import Camera, CaptureSettings, make_capture, write_capture

    camera = Camera(noise=False, hot_pixels=0, bits=16, white_dn=65535, gain_e_per_dn=0.8)
    settings = CaptureSettings(place=furnace, width=width, exposures_s=exposures, camera=camera, name=name)
    write_capture(folder, make_capture(settings))


@pytest.fixture(scope="module")
def furnace(tmp_path_factory):
    from samples import Chart, Furnace, Module

    folder = tmp_path_factory.mktemp("furnace")
    exposures = tuple(Fraction(8) / 4**k for k in range(4))
    reference = Furnace("D65", 80.0, chart=Chart(), module=Module(spectrum="D65"))
    write_furnace(folder, "reference", reference, 1024, exposures)
    write_furnace(folder, "environment", Furnace("D65", 80.0), 64, exposures)
    (folder / "pipeline.yaml").write_text(
        "capture: {reference: reference_*.dng, environment: environment_*.dng}\n"
        "balance: {luminance: keep}\ncluster: {chart_spectrum: off}\nspectra: {wavelengths: 380:780:5, half: false}\n"
    )
    loaded = config.load(folder / "pipeline.yaml")
    run_pipeline(loaded, STAGES[:-1], reporter=Reporter(quiet=True))
    return folder / "output"


def test_the_map_is_white(furnace):
    _, image = exr.read_rgb(furnace / "panorama" / "environment.exr")
    assert image.std() / image.mean() < QUANTISATION
    assert image / image.mean() == pytest.approx(1, abs=4 * QUANTISATION)


def test_the_spectrum_is_that_of_d65(furnace):
    from uplift.spectrum import illuminant, observer

    path = furnace / "spectra" / "environment.exr"
    names = sorted(name for name in exr.header(path).channels if name.startswith("S0."))
    _, planes = exr.read(path, names)
    spectrum = np.stack([planes[name] for name in names], axis=-1).astype(np.float64)
    d65 = illuminant("D65", observer())
    shape = spectrum / (spectrum @ np.ones(len(names)))[..., np.newaxis] * d65.sum()
    # The colour is white to within quantisation; the CCT found from it moves E by no more than that either.
    assert np.abs(shape / d65 - 1).max() < 20 * QUANTISATION


def test_exactly_white_pixels_have_exactly_the_spectrum_of_d65(tmp_path):
    """From the map on nothing is measured any more, so nothing but float32 is left between the answer and the truth."""
    from click.testing import CliRunner

    from envcal import provenance
    from envcal.cli import main
    from uplift.spectrum import illuminant, observer

    exr.write(
        tmp_path / "map.exr",
        exr.rgb_planes(np.full((32, 64, 3), 0.7, np.float32)),
        attributes=provenance.colour_space("ITU-R BT.2020"),
    )
    for command in (["uplift", "map.exr", "-o", "up.exr"], ["spectra", "up.exr", "-o", "spectral.exr"]):
        arguments = [str(tmp_path / a) if a.endswith(".exr") else a for a in command]
        done = CliRunner().invoke(main, arguments)
        assert done.exit_code == 0, done.output
    names = sorted(name for name in exr.header(tmp_path / "spectral.exr").channels if name.startswith("S0."))
    _, planes = exr.read(tmp_path / "spectral.exr", names)
    spectrum = np.stack([planes[name] for name in names], axis=-1)
    expected = 0.7 * illuminant("D65", observer())
    # float32 coefficients: c0 λ², c1 λ and c2 are about 0, so a few units in the last place remain.
    assert spectrum == pytest.approx(np.broadcast_to(expected, spectrum.shape), rel=3e-6)


def test_the_chart_measures_the_light_as_d65_within_its_own_doubt(furnace):
    from envcal import profile
    from uplift.spectrum import illuminant, observer

    light = profile.read(furnace / "balance" / "profile.json").light
    assert light is not None and not light.refused and light.family == "daylight"
    off = (np.asarray(light.emission) - illuminant("D65", observer())) / np.asarray(light.sigma)
    # Without noise, but with a camera it does not know: three standard deviations at any wavelength.
    assert np.abs(off).max() < 3
