"""EXR files: what is written comes back, and nothing half-written or damaged passes."""

import numpy as np
import pytest

from envcal import exr
from envcal.errors import EnvcalError

BT2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)


def planes(height=70, width=64, seed=1):
    rng = np.random.default_rng(seed)
    return {
        "R": rng.random((height, width), np.float32) * 1e5,
        "cluster": rng.integers(0, 1 << 32, (height, width), np.uint32),
        "S0.550,000000nm": rng.random((height, width)).astype(np.float16),
    }


@pytest.mark.parametrize("compression", ["zip", "rle", "none"])
def test_planes_and_attributes_come_back_as_they_were_written(tmp_path, compression):
    # More rows than are converted at a time, and a plane of which every third sample is the channel's.
    wanted = planes(height=150)
    wanted["R"] = np.repeat(wanted["R"][..., None], 3, axis=2)[..., 1]
    attributes = {"envmap": True, "chromaticities": BT2020, "unit": "relative", "n": 3, "f": 0.5, "x": {"λ": [1, 2]}}
    exr.write(tmp_path / "a.exr", wanted, attributes=attributes, compression=compression)
    header, found = exr.read(tmp_path / "a.exr", list(wanted))
    assert all(np.array_equal(found[name], wanted[name]) and found[name].dtype == wanted[name].dtype for name in wanted)
    assert header.latlong
    assert header.chromaticities == pytest.approx(BT2020, abs=1e-6)
    assert header.json("x") == {"λ": [1, 2]}
    assert (header.attributes["n"], header.attributes["f"], header.attributes["unit"]) == (3, 0.5, "relative")
    assert header.size == (150, 64)


def test_the_librarys_own_reader_sees_the_mended_header(tmp_path):
    import OpenEXR

    exr.write(tmp_path / "a.exr", planes(), attributes={"envmap": True, "chromaticities": BT2020})
    with OpenEXR.File(str(tmp_path / "a.exr"), header_only=True) as file:
        raw = file.header()
        assert raw["envmap"] == OpenEXR.ENVMAP_LATLONG
        assert raw["chromaticities"] == pytest.approx(BT2020, abs=1e-6)


def test_arrays_in_any_memory_layout_are_written_right(tmp_path):
    image = np.random.default_rng(2).random((32, 48, 3), np.float32)
    flipped = image[::-1, :, ::-1]
    exr.write(tmp_path / "a.exr", exr.rgb_planes(flipped), attributes={})
    _, found = exr.read_rgb(tmp_path / "a.exr")
    assert np.array_equal(found, flipped)


def test_bands_put_together_are_the_whole_whatever_their_height(tmp_path):
    wanted = planes()
    exr.write(tmp_path / "a.exr", wanted, attributes={})
    for rows in (1, 7, 16, 70, 1000):
        tops, parts = zip(*exr.bands(tmp_path / "a.exr", ["R"], rows=rows), strict=True)
        assert np.array_equal(np.concatenate([p["R"] for p in parts]), wanted["R"])
        assert list(tops) == list(range(0, 70, rows))


def test_writing_twice_gives_the_same_bytes(tmp_path):
    for name in ("a.exr", "b.exr"):
        exr.write(tmp_path / name, planes(), attributes={"unit": "relative"})
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


@pytest.mark.parametrize("kept", [0.98, 0.6, 0.2, 0.01])
def test_a_truncated_file_is_refused(tmp_path, kept, capfd):
    path = tmp_path / "a.exr"
    exr.write(path, planes(), attributes={})
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * kept)])
    with pytest.raises(EnvcalError, match=r"truncated|cannot be read|not an OpenEXR"):
        exr.read(path, ["R", "cluster"])


@pytest.mark.parametrize("kept", [4, 10, 60, 200])
def test_a_file_cut_off_in_its_header_is_called_truncated_and_not_unopenable(tmp_path, kept, capfd):
    path = tmp_path / "a.exr"
    exr.write(path, planes(), attributes={})
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(EnvcalError, match="is truncated or damaged") as caught:
        exr.read_rgb(path)
    assert "Unable to open" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"), [(b"", "not an OpenEXR"), (b"\x89PNG....", "not an OpenEXR"), (None, "no such file")]
)
def test_what_is_no_exr_is_refused_by_name(tmp_path, content, message):
    path = tmp_path / "a.exr"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(EnvcalError, match=message) as caught:
        exr.header(path)
    assert str(path) in str(caught.value)


def test_a_missing_channel_is_named_together_with_those_there_are(tmp_path):
    exr.write(tmp_path / "a.exr", planes(), attributes={})
    with pytest.raises(EnvcalError, match=r"no channel G, B; it holds .*cluster"):
        exr.read_rgb(tmp_path / "a.exr")


def test_too_much_light_for_half_floats_is_refused_and_leaves_what_stood_there(tmp_path):
    path = tmp_path / "a.exr"
    path.write_bytes(b"earlier")
    plane = np.full((4, 4), 7e4, np.float32)
    with (
        pytest.raises(EnvcalError, match=r"7e\+04.*half float"),
        exr.Writer(path, (4, 4), channels={"R": "f2"}, attributes={}) as writer,
    ):
        writer.rows({"R": plane})
    assert path.read_bytes() == b"earlier"
    assert [p.name for p in tmp_path.iterdir()] == ["a.exr"]


def test_a_writer_that_fails_in_the_middle_leaves_no_file(tmp_path):
    with (
        pytest.raises(RuntimeError, match="power cut"),
        exr.Writer(tmp_path / "a.exr", (8, 4), channels={"R": "f4"}, attributes={}) as writer,
    ):
        writer.rows({"R": np.zeros((4, 4), np.float32)})
        raise RuntimeError("power cut")
    assert list(tmp_path.iterdir()) == []


def test_a_hostile_size_in_the_header_is_refused_before_any_pixel_is_read(tmp_path):
    path = tmp_path / "a.exr"
    exr.write(path, planes(), attributes={})
    data = bytearray(path.read_bytes())
    where = data.find(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    data[where : where + 16] = np.array([0, 0, 99_999, 99_999], "<i4").tobytes()
    path.write_bytes(data)
    with pytest.raises(EnvcalError, match=r"100000×100000|cannot be read"):
        exr.header(path)
