"""The shipped capture, and captures made for tests."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import rawpy

import samples
from samples import (
    THREE_LAMPS,
    Camera,
    Capture,
    CaptureSettings,
    Furnace,
    Module,
    Room,
    bracket,
    encode_frame,
    make_capture,
    write_capture,
    write_truth,
)  # fmt: skip

SHIPPED = Path(samples.__file__).parent / "capture"
SMALL = CaptureSettings(width=256, exposures_s=bracket(Fraction(2), 4))


@pytest.fixture(scope="module")
def capture() -> Capture:
    return make_capture(SMALL)


def test_a_bracket_has_equal_steps_and_ends_at_the_longest() -> None:
    assert bracket(Fraction(8), 3) == (Fraction(1, 2), Fraction(2), Fraction(8))


def test_the_frames_agree_with_the_truth_where_nothing_clips(capture: Capture) -> None:
    truth = capture.truth()
    camera = capture.settings.camera
    frame = capture.frames[-1]
    red = (frame.mosaic[::2, ::2].astype(float) - 512) / (camera.white_dn - 512) / float(frame.exposure_s)
    expected = truth.camera_rgb[::2, ::2, 0]
    good = (frame.mosaic[::2, ::2] < 16000) & (expected * float(frame.exposure_s) > 0.02)
    assert good.mean() > 0.3
    assert np.median(np.abs(red[good] / expected[good] - 1.0)) < 0.02  # shot noise of 1000 electrons: 3 %


def test_the_truth_names_the_lamps_and_their_temperatures(capture: Capture) -> None:
    truth = capture.truth()
    assert truth.emitters == ("ceiling panel", "standing globe", "D65 module")
    np.testing.assert_allclose(truth.cct_k, [5109.0, 2856.0, 6503.0], atol=2.0)
    for lamp in range(2):
        y, x = np.nonzero(truth.seen[..., lamp] == 1.0)
        assert len(y) and (truth.dominant[y, x] == lamp).all()
        np.testing.assert_allclose(truth.xyz[y, x, 1], capture.settings.place.lamps[lamp].luminance)  # type: ignore[union-attr]
    np.testing.assert_allclose(truth.shares[truth.seen[..., 2] == 0.0].sum(axis=-1), 1.0, rtol=1e-5)


def test_the_module_reads_d65_in_the_truth(capture: Capture) -> None:
    truth = capture.truth()
    xyz = truth.xyz[truth.module]
    assert len(xyz) >= 5
    np.testing.assert_allclose(xyz[:, :2] / xyz.sum(axis=1, keepdims=True), [[0.31272, 0.32903]] * len(xyz), atol=2e-5)
    assert truth.patch_xyz is not None
    assert xyz[0, 1] > 1.5 * truth.patch_xyz[18, 1]


def test_the_spectral_cube_is_the_camera_image(capture: Capture) -> None:
    truth = capture.truth(spectral=True)
    assert truth.spectral is not None and truth.spectral.dtype == np.float32
    rgb = truth.spectral @ capture.settings.camera.responses.T
    np.testing.assert_allclose(rgb, truth.camera_rgb, rtol=1e-4, atol=1e-9)


def test_the_truth_can_be_written(tmp_path: Path, capture: Capture) -> None:
    with np.load(write_truth(tmp_path / "deep", capture.truth())) as stored:
        np.testing.assert_array_equal(stored["camera_rgb"], capture.rgb)
        assert stored["module"].dtype == bool


def test_written_frames_are_what_libraw_reads(tmp_path: Path, capture: Capture) -> None:
    paths = write_capture(tmp_path, capture)
    assert [path.name for path in paths] == ["room_01.dng", "room_02.dng", "room_03.dng", "room_04.dng"]
    for path, frame in zip(paths, capture.frames, strict=True):
        with rawpy.imread(str(path)) as raw:
            np.testing.assert_array_equal(raw.raw_image_visible, frame.mosaic)
            assert raw.other.shutter_speed == float(frame.exposure_s)


def test_a_third_lamp_can_be_lit() -> None:
    settings = CaptureSettings(place=Room(lamps=THREE_LAMPS), width=128, exposures_s=(Fraction(1, 8),))
    truth = make_capture(settings).truth()
    assert truth.emitters[2] == "tube" and truth.cct_k[2] == pytest.approx(4225.0, abs=2.0)


def test_a_furnace_has_the_same_counts_everywhere() -> None:
    still = Camera(noise=False, hot_pixels=0)
    place = Furnace("D65", 20.0)
    frame = make_capture(CaptureSettings(place=place, width=64, camera=still, exposures_s=(Fraction(1),))).frames[0]
    for row in (0, 1):
        for column in (0, 1):
            assert np.ptp(frame.mosaic[row::2, column::2]) == 0
    assert frame.mosaic.min() > 600


def test_without_a_chart_there_is_no_module_either() -> None:
    view = make_capture(CaptureSettings(place=Room(chart=None, module=Module()), width=64, exposures_s=(Fraction(1),)))
    assert view.truth().chart_corners is None
    assert not view.truth().module.any()


def test_the_shipped_capture_is_a_bracket_in_which_only_long_exposures_clip() -> None:
    paths = sorted(SHIPPED.glob("*.dng"))
    assert len(paths) == 7
    assert sum(path.stat().st_size for path in paths) < 7e6
    clipped, times = [], []
    for path in paths:
        with rawpy.imread(str(path)) as raw:
            assert raw.raw_image_visible.shape == (640, 1280)
            counts = raw.raw_image_visible
            clipped.append(int((counts == 16383).sum()))
            times.append(raw.other.shutter_speed)
            dark = np.percentile(counts, 1.0)
    assert times == [float(t) for t in bracket(Fraction(8), 7)]
    assert clipped[0] == 0
    assert clipped[2] > 5000  # the panel
    assert dark > 4000  # of the longest: dark corners are well exposed


@pytest.mark.slow
def test_the_shipped_files_come_out_the_same_again() -> None:
    for frame in make_capture().frames:
        assert encode_frame(frame, compressed=True) == (SHIPPED / frame.name).read_bytes(), frame.name
