"""RAW files: what is read is what was written, and what cannot be read is refused by name."""

import os
import struct
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from envcal.errors import EnvcalError
from envcal.raw import RawFrame, rawpy_version, read_frame, read_info, read_mosaic

HEIGHT, WIDTH = 40, 60
BLACKS = (500, 510, 520, 530)

BYTE, ASCII, SHORT, LONG, RATIONAL, SIGNED_RATIONAL = 1, 2, 3, 4, 5, 10
ITEM = {BYTE: "B", SHORT: "H", LONG: "I", RATIONAL: "I", SIGNED_RATIONAL: "i"}
Tags = dict[int, tuple[int, Any]]


def mosaic_of(seed: int = 0) -> npt.NDArray[np.uint16]:
    return np.random.default_rng(seed).integers(480, 16383, (HEIGHT, WIDTH), dtype=np.uint16)


def directory(tags: Tags, at: int) -> bytes:
    """A TIFF directory that starts at byte `at`, its long values behind it."""
    entries, behind = struct.pack("<H", len(tags)), b""
    start = at + 2 + 12 * len(tags) + 4
    for tag in sorted(tags):
        kind, values = tags[tag]
        body = values if kind == ASCII else struct.pack(f"<{len(values)}{ITEM[kind]}", *values)
        count = len(body) if kind == ASCII else len(values) // (2 if kind in (RATIONAL, SIGNED_RATIONAL) else 1)
        entries += struct.pack("<HHI", tag, kind, count)
        if len(body) <= 4:
            entries += body.ljust(4, b"\0")
        else:
            entries += struct.pack("<I", start + len(behind))
            behind += body + b"\0" * (len(body) % 2)
    return entries + struct.pack("<I", 0) + behind


def write_dng(
    path: Path,
    mosaic: npt.NDArray[Any],
    *,
    cfa: str = "RGGB",
    black: tuple[float, ...] = BLACKS,
    active: tuple[int, int, int, int] | None = None,
    exif: Tags | None = None,
    changed: dict[int, tuple[int, Any] | None] | None = None,
) -> Path:
    """Write the smallest DNG that LibRaw takes; `changed` replaces tags, or drops them (None)."""
    height, width = mosaic.shape[:2]
    samples = mosaic.size // (height * width)
    exif = {33434: (RATIONAL, (1, 30)), 33437: (RATIONAL, (56, 10)), 34855: (SHORT, (200,))} if exif is None else exif
    tags: dict[int, tuple[int, Any] | None] = {
        254: (LONG, (0,)),
        256: (LONG, (width,)),
        257: (LONG, (height,)),
        258: (SHORT, (8 * mosaic.itemsize,) * samples),
        259: (SHORT, (1,)),
        262: (SHORT, (32803,)),
        271: (ASCII, b"Maker\0"),
        272: (ASCII, b"Maker One\0"),
        273: (LONG, (0,)),
        277: (SHORT, (samples,)),
        278: (LONG, (height,)),
        279: (LONG, (mosaic.nbytes,)),
        284: (SHORT, (1,)),
        33421: (SHORT, (2, 2)),
        33422: (BYTE, ["RGB".index(c) for c in cfa]),
        34665: (LONG, (0,)),
        50706: (BYTE, (1, 4, 0, 0)),
        50708: (ASCII, b"Maker One\0"),
        50713: (SHORT, (2, 2)),
        50714: (RATIONAL, [n for b in black for n in (int(b * 100), 100)]),
        50717: (LONG, (16383,)),
        50721: (SIGNED_RATIONAL, [1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1]),
        50728: (RATIONAL, (1, 1, 1, 1, 1, 1)),
        50778: (SHORT, (21,)),
        50829: (LONG, active or (0, 0, height, width)),
    }
    kept: Tags = {k: v for k, v in (tags | (changed or {})).items() if v is not None}
    exif_at = 8 + len(directory(kept, 8))
    data_at = exif_at + len(directory(exif, exif_at))
    kept |= {34665: (LONG, (exif_at,)), 273: (LONG, (data_at,))}
    head = b"II*\0" + struct.pack("<I", 8) + directory(kept, 8) + directory(exif, exif_at)
    path.write_bytes(head + np.ascontiguousarray(mosaic).tobytes())
    return path


def test_the_mosaic_is_the_counts_that_were_written(tmp_path: Path) -> None:
    written = mosaic_of()
    read = read_mosaic(write_dng(tmp_path / "a.dng", written))
    assert read.dtype == np.uint16
    np.testing.assert_array_equal(read, written)


def test_info_is_what_the_file_says(tmp_path: Path) -> None:
    path = write_dng(tmp_path / "a.dng", mosaic_of())
    info = read_info(path)
    assert info.name == str(path)
    assert info.exposure_s == Fraction(1, 30)
    assert (info.iso, info.f_number) == (200.0, 5.6)
    assert info.camera == "Maker One"
    assert (info.width, info.height, info.bits) == (WIDTH, HEIGHT, 14)
    assert info.white_dn == (16383.0,) * 4


@pytest.mark.parametrize("cfa", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_black_levels_stand_in_the_order_of_positions_whatever_the_pattern(tmp_path: Path, cfa: str) -> None:
    info = read_info(write_dng(tmp_path / "a.dng", mosaic_of(), cfa=cfa))
    assert info.cfa == cfa
    assert info.black_dn == BLACKS


@pytest.mark.parametrize(
    ("top", "left", "cfa", "blacks"),
    [
        (2, 2, "RGGB", (500, 510, 520, 530)),
        (1, 1, "BGGR", (530, 520, 510, 500)),
        (1, 0, "GBRG", (520, 530, 500, 510)),
        (0, 3, "GRBG", (510, 500, 530, 520)),
    ],
)
def test_an_odd_active_area_shifts_pattern_and_black_levels_together(
    tmp_path: Path, top: int, left: int, cfa: str, blacks: tuple[int, ...]
) -> None:
    # Both patterns start at the corner of the active area; LibRaw starts the mosaic at the next even row and column.
    written = mosaic_of()
    path = write_dng(tmp_path / "a.dng", written, active=(top, left, HEIGHT - 1, WIDTH - 2))
    info = read_info(path)
    visible = written[top + top % 2 : HEIGHT - 1, left + left % 2 : WIDTH - 2]
    np.testing.assert_array_equal(read_mosaic(path), visible)
    assert (info.height, info.width) == visible.shape
    assert info.cfa == cfa
    assert info.black_dn == blacks


def test_fractions_of_a_black_level_are_kept(tmp_path: Path) -> None:
    blacks = (500.25, 510.5, 520.0, 530.75)
    assert read_info(write_dng(tmp_path / "a.dng", mosaic_of(), black=blacks)).black_dn == blacks


def test_missing_and_zero_exposure_data_are_none(tmp_path: Path) -> None:
    none = read_info(write_dng(tmp_path / "a.dng", mosaic_of(), exif={}))
    assert (none.exposure_s, none.iso, none.f_number) == (None, None, None)
    zero: Tags = {33434: (RATIONAL, (0, 1)), 33437: (RATIONAL, (0, 0)), 34855: (SHORT, (0,))}
    zeros = read_info(write_dng(tmp_path / "b.dng", mosaic_of(), exif=zero))
    assert (zeros.exposure_s, zeros.iso, zeros.f_number) == (None, None, None)


def test_shutter_times_stay_exact_rationals(tmp_path: Path) -> None:
    exif: Tags = {33434: (RATIONAL, (10, 32000)), 34855: (SHORT, (100,))}
    assert read_info(write_dng(tmp_path / "a.dng", mosaic_of(), exif=exif)).exposure_s == Fraction(1, 3200)


def test_without_exifread_the_shutter_time_comes_from_libraw(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def confused(*_: Any, **__: Any) -> None:
        raise IndexError("unknown container")

    monkeypatch.setattr("exifread.process_file", confused)
    info = read_info(write_dng(tmp_path / "a.dng", mosaic_of()))
    assert info.exposure_s == Fraction(1, 30)
    assert (info.iso, info.f_number) == (200.0, pytest.approx(5.6))


def test_a_frame_reads_its_info_once_and_its_mosaic_anew(tmp_path: Path) -> None:
    path = write_dng(tmp_path / "a.dng", mosaic_of())
    frame = RawFrame(path)
    assert frame.info is frame.info
    first, second = frame.mosaic(), frame.mosaic()
    assert first is not second
    np.testing.assert_array_equal(first, second)
    assert str(path) in repr(frame)


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="lists open files through /proc")
def test_no_file_stays_open(tmp_path: Path) -> None:
    path = write_dng(tmp_path / "a.dng", mosaic_of())
    frame = RawFrame(path)
    assert frame.info.width == WIDTH
    frame.mosaic()
    opened = [f.readlink() for f in Path("/proc/self/fd").iterdir() if f.is_symlink()]
    assert path not in opened


def test_a_fully_clipped_frame_is_a_frame(tmp_path: Path) -> None:
    assert read_mosaic(write_dng(tmp_path / "a.dng", np.full((HEIGHT, WIDTH), 16383, np.uint16))).min() == 16383


def test_the_versions_name_rawpy_and_libraw() -> None:
    assert "rawpy" in rawpy_version()
    assert "LibRaw" in rawpy_version()


X_TRANS = [1, 1, 0, 1, 1, 2, 1, 1, 2, 1, 1, 0, 2, 0, 1, 0, 2, 1, 1, 1, 2, 1, 1, 0, 1, 1, 0, 1, 1, 2, 0, 2, 1, 2, 0, 1]
NO_CFA: dict[int, tuple[int, Any] | None] = {262: (SHORT, (34892,)), 33421: None, 33422: None}


@pytest.mark.parametrize(
    ("mosaic", "changed", "said"),
    [
        (mosaic_of(), {33422: (BYTE, (0, 1, 2, 1))}, "a Bayer mosaic"),
        (mosaic_of().astype(np.float32) / 16383, {339: (SHORT, (3,))}, "floating-point"),
        ((mosaic_of() / 16383).astype(np.float16), {339: (SHORT, (3,))}, "floating-point"),
        (mosaic_of(), {259: (SHORT, (52546,))}, "JPEG XL"),
        (mosaic_of(), {259: (SHORT, (8,))}, "cannot be decoded"),
        (np.zeros((HEIGHT, WIDTH), np.uint16), {}, "no sample above the black level"),
        (np.full((HEIGHT, WIDTH), 490, np.uint16), {}, "no sample above the black level"),
        (np.full((HEIGHT, WIDTH), 4000, np.uint16), {}, "every sample is 4000"),
        (mosaic_of() * 4, {}, "above 16383"),
    ],
)
@pytest.mark.parametrize("read", [read_info, read_mosaic])
def test_what_is_no_bayer_mosaic_of_integers_is_refused(
    tmp_path: Path, mosaic: npt.NDArray[Any], changed: dict[int, tuple[int, Any] | None], said: str, read: Any
) -> None:
    path = write_dng(tmp_path / "odd.dng", mosaic, changed=changed)
    with pytest.raises(EnvcalError, match=said) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize("share", [0.05, 0.3, 0.6, 0.99])
def test_a_truncated_file_is_refused(tmp_path: Path, share: float) -> None:
    path = write_dng(tmp_path / "cut.dng", mosaic_of())
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(EnvcalError, match="Copy it from the card again"):
        read_info(path)


def test_what_is_no_raw_file_is_refused_by_name(tmp_path: Path) -> None:
    for name in ("photograph.jpg", "photograph.tif"):
        cv2.imwrite(str(tmp_path / name), np.zeros((20, 20, 3), np.uint8))
        with pytest.raises(EnvcalError, match="not a RAW file"):
            read_info(tmp_path / name)
    (tmp_path / "note.dng").write_text("not an image")
    with pytest.raises(EnvcalError, match="cannot be decoded"):
        read_info(tmp_path / "note.dng")
    (tmp_path / "none.dng").write_bytes(b"")
    with pytest.raises(EnvcalError, match="0 bytes"):
        read_info(tmp_path / "none.dng")
    with pytest.raises(EnvcalError, match="no such file"):
        read_mosaic(tmp_path / "missing.dng")
    with pytest.raises(EnvcalError, match="no such file"):
        read_info(tmp_path)


DATA = os.environ.get("ENVCAL_DATA", "")


@pytest.mark.skipif(not DATA, reason="ENVCAL_DATA names no folder of real frames")
def test_a_real_frame_is_read() -> None:
    path = Path(DATA) / "real" / "chart_light_booth_12bit_bggr.dng"
    info = read_info(path)
    assert (info.cfa, info.bits, info.exposure_s) == ("BGGR", 12, Fraction(1, 30))
    assert read_mosaic(path).shape == (info.height, info.width)


# Other arrangements of the photosites


def test_x_trans_monochrome_and_linear_frames_are_read_as_they_are(tmp_path: Path) -> None:
    mosaic = mosaic_of()
    six = read_frame(write_dng(tmp_path / "x.dng", mosaic, changed={33421: (SHORT, (6, 6)), 33422: (BYTE, X_TRANS)}))
    assert six[0].cfa == "".join("RGB"[c] for c in X_TRANS)
    assert six[0].period == (6, 6)
    grey = read_frame(write_dng(tmp_path / "m.dng", mosaic, changed=NO_CFA))
    assert (grey[0].cfa, grey[0].columns) == ("W", WIDTH)
    np.testing.assert_array_equal(grey[1], mosaic)
    colours = np.dstack([mosaic_of(1), mosaic_of(2), mosaic_of(3)])
    linear = read_frame(write_dng(tmp_path / "l.dng", colours, changed=NO_CFA))
    assert (linear[0].cfa, linear[0].columns, len(linear[0].white_dn)) == ("RGB", 3 * WIDTH, 3)
    np.testing.assert_array_equal(linear[1], colours.reshape(HEIGHT, 3 * WIDTH))


def test_the_masked_border_is_measured(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    height, width = 200, 120
    written = rng.integers(600, 9000, (height, width), dtype=np.uint16)
    dark = np.empty((height, width))
    for k, black in enumerate(BLACKS):
        dark[k // 2 :: 2, k % 2 :: 2] = black + 1.4
    written[:, :24] = np.rint(dark + 2 * rng.standard_normal(dark.shape))[:, :24]
    info = read_info(write_dng(tmp_path / "a.dng", written, active=(0, 24, height, width)))
    assert info.masked is not None
    # Two counts of noise over some 900 photosites a position.
    np.testing.assert_allclose(info.masked.black_dn, np.array(BLACKS) + 1.4, atol=0.3)
    assert info.masked.noise_dn == pytest.approx(2.0, rel=0.1)
    assert read_info(write_dng(tmp_path / "b.dng", written)).masked is None


@pytest.mark.parametrize(
    ("written", "metres"),
    [((3, 2), 1.5), ((2**32 - 1, 1), float("inf")), ((0, 1), None), ((0, 0), None), (None, None)],
)
def test_the_lens_is_set_as_the_file_says_and_infinity_is_not_a_number_of_metres(
    tmp_path: Path, written: tuple[int, int] | None, metres: float | None
) -> None:
    exif: Tags = {33434: (RATIONAL, (1, 30)), 37386: (RATIONAL, (350, 10))}
    if written is not None:
        exif[37382] = (RATIONAL, written)
    info = read_info(write_dng(tmp_path / "a.dng", mosaic_of(), exif=exif))
    assert info.focal_length_mm == 35
    assert info.focus_distance_m == metres
