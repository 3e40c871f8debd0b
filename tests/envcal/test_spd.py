"""Measured spectra as files: TM-27, instruments' text, and a folder of one's own."""

import numpy as np
import pytest

from envcal.config import load_lights
from envcal.errors import EnvcalError
from envcal.spd import in_library, read_spd, resolved

TM27 = """<?xml version="1.0" encoding="utf-8"?>
<IESTM2714 version="1.0" xmlns="{space}"><Header><Description>a lamp</Description></Header>
<SpectralDistribution><SpectralQuantity>{quantity}</SpectralQuantity><BandwidthFWHM>2.0</BandwidthFWHM>
<SpectralData wavelength="400.0">0.5</SpectralData><SpectralData wavelength="410.0">0.75</SpectralData>
</SpectralDistribution></IESTM2714>"""


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("space", ["iestm2714", "http://www.ies.org/iestm2714"])
def test_a_tm27_document_is_read_whatever_its_namespace(tmp_path, space):
    path = write(tmp_path / "lamp.spdx", TM27.format(space=space, quantity="flux"))
    wavelengths, values = read_spd(path)
    np.testing.assert_array_equal(wavelengths, [400, 410])
    np.testing.assert_array_equal(values, [0.5, 0.75])


def test_what_colour_science_writes_is_read(tmp_path):
    import colour

    sd = colour.SDS_ILLUMINANTS["FL2"]
    path = tmp_path / "fl2.spdx"
    header = colour.io.tm2714.Header_IESTM2714(description="FL2")
    written = colour.SpectralDistribution_IESTM2714(
        str(path), header, "relative", data=dict(zip(sd.wavelengths, sd.values, strict=True))
    )
    assert written.write()
    wavelengths, values = read_spd(path)
    np.testing.assert_array_equal(wavelengths, sd.wavelengths)
    np.testing.assert_array_equal(values, sd.values)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<!DOCTYPE a [<!ENTITY x "y">]><IESTM2714>&x;</IESTM2714>', "declares a document type"),
        ('<!DOCTYPE a SYSTEM "file:///etc/passwd"><IESTM2714/>', "declares a document type"),
        ("<html><body/></html>", "its root is <html>"),
        ("<IESTM2714><SpectralData", "is not XML"),
        ("<IESTM2714/>", "holds 0 SpectralData"),
        (TM27.format(space="a", quantity="reflectance"), "holds a reflectance"),
        (TM27.format(space="a", quantity="flux").replace("0.75", "much"), "expected numbers"),
        (TM27.format(space="a", quantity="flux").replace('wavelength="400.0"', ""), "expected numbers"),
    ],
)
def test_other_documents_are_refused(tmp_path, text, message):
    with pytest.raises(EnvcalError, match=message):
        read_spd(write(tmp_path / "lamp.spdx", text))


def test_a_file_too_large_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "lamp.spdx"
    path.write_bytes(b" " * ((1 << 22) + 1))
    with pytest.raises(EnvcalError, match="is larger than 4 MiB"):
        read_spd(path)


def test_an_instruments_text_may_have_lines_above_its_data(tmp_path):
    text = "Instrument: X\nIntegration time 20 ms\nnm W/sr\n400 0.5\n410 0.75\n"
    np.testing.assert_array_equal(read_spd(write(tmp_path / "a.sd", text))[1], [0.5, 0.75])
    with pytest.raises(EnvcalError, match="is not `wavelength, value`"):
        read_spd(write(tmp_path / "a.csv", text))


def test_a_library_gives_spectra_by_name_with_or_without_the_ending(tmp_path):
    folder = tmp_path / "library"
    folder.mkdir()
    tube = write(folder / "tube.csv", "400 1\n410 1\n")
    write(folder / "readme.md", "no spectrum")
    assert in_library(folder) == [tube]
    assert resolved(tmp_path / "tube", folder) == tube
    assert resolved(tmp_path / "tube.csv", folder) == tube
    assert resolved(tmp_path / "other", folder) == tmp_path / "other"
    own = write(tmp_path / "tube.csv", "400 2\n410 2\n")
    assert resolved(own, folder) == own
    lights = write(tmp_path / "lights.yaml", "lights: [{at: [0, 0], spd: tube}]\n")
    assert load_lights(lights, folder)[0].spd == tube


def test_a_library_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(EnvcalError, match="is no folder of spectra"):
        in_library(tmp_path / "none")
