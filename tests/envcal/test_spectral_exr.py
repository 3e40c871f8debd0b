"""The spectral image keeps to the layout of Fichet et al. 2021, holds the radiance it says, and stays within memory."""

import re
import subprocess
import sys

import numpy as np
import pytest
from click.testing import CliRunner

from envcal import exr, provenance, spectral_exr
from envcal.cli import main
from envcal.config import SpectraSettings, parse_bands
from envcal.errors import EnvcalError
from envcal.export.opened import bands, open_uplift
from envcal.steps.spectra import spectra
from tests.envcal.small_uplift import EYES, small_uplift

#: The name of an unpolarised emissive band: Stokes component 0, the wavelength with a decimal comma, its unit (the
#: paper, section 3: a point would part layers).
LAYOUT = re.compile(r"S0\.(\d+),(\d+)nm")
#: Radiance is rounded to the type it is stored in.
ROUNDED = {"f4": 1e-6, "f2": 1e-3}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return small_uplift(tmp_path_factory.mktemp("uplift"))[0]


def radiance_by_the_formula(path, wavelengths):
    opened = open_uplift(path)
    (band,) = bands(opened)
    c = band.coefficients.astype(np.float64)
    emission = np.stack(
        [np.interp(wavelengths, opened.wavelengths_nm, k.emission) for k in opened.about.clusters], axis=0
    )
    x = (c[..., :1] * wavelengths + c[..., 1:2]) * wavelengths + c[..., 2:]
    return band.scale[..., None] * emission[band.cluster] * (0.5 + x / (2 * np.sqrt(1 + x * x)))


@pytest.mark.parametrize("half", [False, True])
def test_the_header_and_the_names_are_those_of_the_layout(made, tmp_path, half):
    spectra(made, tmp_path / "s.exr", SpectraSettings(wavelengths="380:780:5", half=half))
    header = exr.header(tmp_path / "s.exr")
    assert header.attributes["spectralLayoutVersion"] == "1.0"
    assert header.attributes["emissiveUnits"] == "W.m^-2.sr^-1"
    assert "polarisationHandedness" not in header.attributes  # asked for only where S1 to S3 are stored
    named = [LAYOUT.fullmatch(name) for name in header.channels if name not in "RGB"]
    assert all(named) and len(named) == 81
    assert sorted(float(f"{m[1]}.{m[2]}") for m in named) == [float(w) for w in range(380, 785, 5)]
    assert set(header.channels.values()) == {"f2" if half else "f4"}
    assert {"R", "G", "B"} <= set(header.channels) and header.latlong


@pytest.mark.parametrize(("half", "kind"), [(False, "f4"), (True, "f2")])
@pytest.mark.parametrize("asked", ["380:780:20", "450,532.5,650.125", "555"])
def test_every_band_holds_the_radiance_of_its_wavelength(made, tmp_path, asked, half, kind):
    spectra(made, tmp_path / "s.exr", SpectraSettings(wavelengths=asked, half=half))
    wavelengths = np.array(parse_bands(asked))
    _, planes = exr.read(tmp_path / "s.exr", [spectral_exr.channel(w) for w in wavelengths])
    expected = radiance_by_the_formula(made, wavelengths)
    for k, w in enumerate(wavelengths):
        found = planes[spectral_exr.channel(w)].astype(np.float64)
        np.testing.assert_allclose(found, expected[..., k], rtol=ROUNDED[kind], atol=1e-7)


def test_colour_science_reads_it_and_gets_the_colours_back(made, tmp_path):
    pytest.importorskip("OpenImageIO")
    import colour

    spectra(made, tmp_path / "s.exr", SpectraSettings(wavelengths="380:780:5", half=False))
    components = colour.read_spectral_image_Fichet2021(str(tmp_path / "s.exr"))
    assert set(components) == {"S0"}
    wavelengths, radiance = components["S0"]
    np.testing.assert_allclose(wavelengths, EYES.wavelengths_nm)
    rgb = radiance @ EYES.cmfs * EYES.step_nm @ open_uplift(made).space.rgb_from_xyz.T
    _, image = exr.read_rgb(made)
    np.testing.assert_allclose(rgb, image, rtol=2e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("wavelength", "name"), [(550, "S0.550,000000nm"), (532.5, "S0.532,500000nm"), (380.125, "S0.380,125000nm")]
)
def test_the_decimal_sign_is_a_comma(wavelength, name):
    assert spectral_exr.channel(wavelength) == name and LAYOUT.fullmatch(name)


@pytest.mark.parametrize("asked", ["370:780:10", "550,781", "360"])
def test_wavelengths_outside_of_the_emissions_are_refused_and_leave_no_file(made, tmp_path, asked):
    with pytest.raises(EnvcalError, match="its emissions are known from 380 to 780 nm"):
        spectra(made, tmp_path / "s.exr", SpectraSettings(wavelengths=asked))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ("450;550", "neither start:stop:step nor a list"),
        ("550,450", "should rise within 360 to 830 nm"),
        ("550,550.0000001", "at least 0.001 apart"),
        ("300,550", "within 360 to 830 nm"),
        ("380:781:5", "the steps do not end"),
    ],
)
def test_wavelengths_that_make_no_sense_are_refused(made, tmp_path, asked, message):
    done = CliRunner().invoke(main, ["spectra", str(made), "-o", str(tmp_path / "s.exr"), "--wavelengths", asked])
    assert done.exit_code == 2 and message in done.output


def test_what_a_half_float_cannot_hold_is_refused(tmp_path):
    source, _ = small_uplift(tmp_path, peak=1e8)
    with pytest.raises(EnvcalError, match="more than a half float can"):
        spectra(source, tmp_path / "s.exr", SpectraSettings(half=True))
    assert not (tmp_path / "s.exr").exists()
    spectra(source, tmp_path / "s.exr", SpectraSettings(half=False))


@pytest.mark.slow
def test_an_8k_map_of_81_bands_is_written_within_4_gb(tmp_path):
    """A strip of it: rows are streamed, so the memory is that of any height; the process measures its own peak."""
    pytest.importorskip("resource")
    width, height = 8192, 64
    rng = np.random.default_rng(0)
    about = open_uplift(small_uplift(tmp_path)[0]).about.model_dump(mode="json")
    planes = {name: rng.normal(0, 1e-5, (height, width)).astype(np.float32) for name in ("c0", "c1", "c2")}
    planes |= {"scale": np.ones((height, width), np.float32)}
    planes |= dict.fromkeys("RGB", np.ones((height, width), np.float32))
    planes |= dict.fromkeys(("cluster", "status"), np.zeros((height, width), np.uint32))
    attributes = {**provenance.colour_space("sRGB"), "envcalUplift": about, "envmap": True}
    exr.write(tmp_path / "large.exr", planes, attributes=attributes)
    program = (
        "import resource, sys\n"
        "from envcal.cli import main\n"
        "try:\n"
        "    main(['spectra', sys.argv[1], '-o', sys.argv[2], '--wavelengths', '380:780:5'])\n"
        "finally:\n"
        "    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "large.exr"), str(tmp_path / "s.exr")],
        capture_output=True,
        text=True,
        check=True,
    )
    used = int(done.stdout.split()[-1]) * (1 if sys.platform == "darwin" else 1024)
    assert used < 4e9, f"{used / 1e9:.2f} GB"
    assert exr.header(tmp_path / "s.exr").size == (height, width)
