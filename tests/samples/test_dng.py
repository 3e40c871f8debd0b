"""DNG files of synthetic frames, read back by LibRaw and by ExifRead."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import rawpy

from samples import Camera
from samples.dng import encode_dng
from samples.sensor import colour_matrix

NEUTRAL = np.array([0.5, 1.0, 0.7])


def _counts(height: int = 34, width: int = 50) -> npt.NDArray[np.uint16]:
    return np.random.default_rng(1).integers(0, 16384, (height, width), dtype=np.uint16)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("cfa", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_libraw_reads_back_every_count_and_the_pattern(tmp_path: Path, cfa: str, compressed: bool) -> None:
    counts = _counts()
    path = tmp_path / "frame.dng"
    camera = Camera(cfa=cfa)
    path.write_bytes(encode_dng(counts, Fraction(1, 8), camera=camera, neutral=NEUTRAL, compressed=compressed))
    with rawpy.imread(str(path)) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, counts)
        assert "".join("RGBG"[i] for i in raw.raw_colors_visible[:2, :2].ravel()) == cfa


def test_libraw_reads_back_what_the_file_says_of_the_exposure(tmp_path: Path) -> None:
    path = tmp_path / "frame.dng"
    camera = Camera(black_dn=(500, 510, 520, 530))
    path.write_bytes(encode_dng(_counts(), Fraction(3, 400), camera=camera, neutral=NEUTRAL))
    with rawpy.imread(str(path)) as raw:
        assert raw.other.shutter_speed == np.float32(3 / 400)
        assert raw.other.iso_speed == 100.0
        assert raw.other.aperture == np.float32(5.6)
        assert raw.black_level_per_channel == [500, 510, 530, 520]  # R, G1, B, G2
        assert raw.white_level == 16383
        np.testing.assert_allclose(
            np.array(raw.camera_whitebalance[:3]) * NEUTRAL, raw.camera_whitebalance[1], rtol=1e-3
        )


def test_exifread_reads_the_exposure_as_a_fraction(tmp_path: Path) -> None:
    import exifread

    path = tmp_path / "frame.dng"
    path.write_bytes(encode_dng(_counts(), Fraction(3, 400), camera=Camera(), neutral=NEUTRAL))
    with path.open("rb") as file:
        tags = exifread.process_file(file, details=False)
    ratio = tags["EXIF ExposureTime"].values[0]
    assert Fraction(ratio.num, ratio.den) == Fraction(3, 400)
    assert str(tags["Image Model"]) == "Synthetic 360"


def test_missing_and_wrong_settings_can_be_written_on_purpose(tmp_path: Path) -> None:
    path = tmp_path / "frame.dng"
    settings: dict[str, object] = {"exposure_s": None, "iso": 400, "model": "Other"}
    path.write_bytes(encode_dng(_counts(), Fraction(1), camera=Camera(), neutral=NEUTRAL, settings=settings))
    with rawpy.imread(str(path)) as raw:
        assert raw.other.shutter_speed == 0.0
        assert raw.other.iso_speed == 400.0


def test_a_compressed_frame_of_odd_height_is_refused() -> None:
    with pytest.raises(ValueError, match=r"height 35.*uncompressed"):
        encode_dng(_counts(35), Fraction(1), camera=Camera(), neutral=NEUTRAL, compressed=True)


def test_the_matrix_in_the_file_is_the_cameras(tmp_path: Path) -> None:
    import exifread

    path = tmp_path / "frame.dng"
    camera = replace(Camera(), sensitivities="Sigma SDMerill (NPL)")
    path.write_bytes(encode_dng(_counts(), Fraction(1), camera=camera, neutral=NEUTRAL))
    with path.open("rb") as file:
        tags = exifread.process_file(file, details=True)
    stored = [float(Fraction(r.num, r.den)) for r in tags["Image Tag 0xC621"].values]
    np.testing.assert_allclose(stored, colour_matrix(camera.sensitivities).ravel(), atol=1e-9)
