"""Maps of other programs, and measured spectra: read as they were meant, or refused with a reason."""

import cv2
import numpy as np
import pytest

from envcal import exr, provenance
from envcal.errors import EnvcalError
from envcal.maps import read_map
from envcal.spd import read_spd


def hdr_bytes(image):
    ok, data = cv2.imencode(".hdr", image[..., ::-1])
    assert ok
    return data.tobytes()


@pytest.fixture
def image():
    return np.random.default_rng(3).random((16, 32, 3), np.float32) + 0.5


def test_an_hdr_map_is_linear_srgb_with_its_colours_in_order(tmp_path, image):
    (tmp_path / "a.hdr").write_bytes(hdr_bytes(image))
    found = read_map(tmp_path / "a.hdr")
    # RGBE keeps 8 bits of the largest component.
    assert np.abs(found.image - image).max() <= image.max() / 128
    assert (found.space, found.said_by) == ("sRGB", "default")
    assert read_map(tmp_path / "a.hdr", space="ACEScg").space == "ACEScg"


def test_primaries_in_an_hdr_header_are_believed(tmp_path, image):
    data = hdr_bytes(image).replace(b"\n\n", b"\nPRIMARIES=0.708 0.292 0.170 0.797 0.131 0.046 0.3127 0.3290\n\n", 1)
    (tmp_path / "a.hdr").write_bytes(data)
    assert read_map(tmp_path / "a.hdr").space == "ITU-R BT.2020"


def test_primaries_of_nothing_but_zeros_count_as_none(tmp_path, image):
    data = hdr_bytes(image).replace(b"\n\n", b"\nPRIMARIES=0 0 0 0 0 0 0 0\n\n", 1)
    (tmp_path / "a.hdr").write_bytes(data)
    found = read_map(tmp_path / "a.hdr")
    assert (found.space, found.said_by) == ("sRGB", "default")


@pytest.mark.parametrize("space", ["ITU-R BT.2020", "sRGB", "P3-D65", "ACEScg", "ACES2065-1", "Adobe Wide Gamut RGB"])
def test_the_chromaticities_of_an_exr_name_its_space(tmp_path, image, space):
    exr.write(tmp_path / "a.exr", exr.rgb_planes(image), attributes=provenance.colour_space(space))
    assert read_map(tmp_path / "a.exr").space == space


def test_unknown_chromaticities_are_refused_with_the_remedy(tmp_path, image):
    attributes = {"chromaticities": (0.7, 0.2, 0.2, 0.7, 0.1, 0.1, 0.33, 0.33)}
    exr.write(tmp_path / "a.exr", exr.rgb_planes(image), attributes=attributes)
    with pytest.raises(EnvcalError, match="--space"):
        read_map(tmp_path / "a.exr")
    assert read_map(tmp_path / "a.exr", space="sRGB").space == "sRGB"


def test_camera_rgb_is_no_map(tmp_path, image):
    attributes = provenance.colour_space(provenance.CAMERA_RGB)
    exr.write(tmp_path / "a.exr", exr.rgb_planes(image), attributes=attributes)
    with pytest.raises(EnvcalError, match="envcal correct"):
        read_map(tmp_path / "a.exr")


def test_a_map_that_is_not_twice_as_wide_as_high_is_refused(tmp_path, image):
    exr.write(tmp_path / "a.exr", exr.rgb_planes(image[:, :20]), attributes={})
    with pytest.raises(EnvcalError, match="20×16 pixels"):
        read_map(tmp_path / "a.exr")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d[:60], "truncated|no `-Y"),
        (lambda d: d[: len(d) // 2], "truncated"),
        (lambda d: b"JPEG" + d, "not a Radiance picture"),
        (lambda d: d.replace(b"32-bit_rle_rgbe", b"32-bit_rle_xyze"), "holds XYZ"),
        (lambda d: d.replace(b"-Y 16 +X 32", b"-Y 999999 +X 1999998"), "at most"),
        (lambda d: d.replace(b"-Y 16 +X 32", b"+X 32 -Y 16"), "no `-Y height"),
    ],
)
def test_a_damaged_or_strange_hdr_is_refused(tmp_path, image, change, message):
    (tmp_path / "a.hdr").write_bytes(change(hdr_bytes(image)))
    with pytest.raises(EnvcalError, match=message):
        read_map(tmp_path / "a.hdr")


def test_a_map_of_another_kind_or_none_is_refused(tmp_path):
    for name in ("a.png", "none.hdr", "none.exr"):
        with pytest.raises(EnvcalError, match=r"neither|no such file"):
            read_map(tmp_path / name)


@pytest.mark.parametrize(
    "text",
    [
        "400,1.5\n500,2\n",
        "wavelength;value\n400;1.5\n500;2\n",
        "# lamp\n400\t1.5\n\n500\t2 # end\n",
        "\ufeff400 1.5\n500 2",
    ],
)
def test_spectra_are_read_in_the_usual_layouts(tmp_path, text):
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    wavelengths, values = read_spd(tmp_path / "a.csv")
    assert wavelengths.tolist() == [400, 500]
    assert values.tolist() == [1.5, 2]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds 0 samples"),
        ("400,1\n", "holds 1 samples"),
        ("400,1\n500,x\n", ":2: '500,x'"),
        ("nm,a,b\n400,1,2\n", ":2: '400,1,2'"),
        (b"\xff\xfe\x00", "not text"),
    ],
)
def test_a_spectrum_that_cannot_be_read_names_the_line(tmp_path, text, message):
    (tmp_path / "a.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(EnvcalError, match=message):
        read_spd(tmp_path / "a.csv")
