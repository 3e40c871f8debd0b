"""Cameras' sensitivities: every layout gives the same curves; what is no sensitivity is refused with a reason."""

import json

import numpy as np
import pytest

from envcal import cameras
from envcal.cameras import is_known, known_cameras, sensitivities
from envcal.errors import EnvcalError

NM = np.arange(400.0, 701.0, 10.0)
CURVES = np.stack([np.exp(-0.5 * ((NM - peak) / 35.0) ** 2) for peak in (600.0, 540.0, 460.0)], axis=-1)
GRID = np.arange(380.0, 781.0, 5.0)


def csv_text(curves=CURVES, *, header="", separator=",", nm=NM):
    rows = [separator.join(repr(float(v)) for v in (w, *row)) for w, row in zip(nm, curves, strict=True)]
    return "\n".join([header, *rows] if header else rows) + "\n"


def json_text(curves=CURVES, columns=("R", "G", "B")):
    main = {f"{w:g}": [float(v) for v in row] for w, row in zip(NM, curves, strict=True)}
    data = {"units": "relative", "index": {"main": list(columns)}, "data": {"main": main}}
    return json.dumps({"header": {"model": "made up"}, "spectral_data": data})


def read(tmp_path, name, text, at=GRID):
    (tmp_path / name).write_text(text, encoding="utf-8")
    return sensitivities(tmp_path / name, at)


def refused(tmp_path, name, text):
    with pytest.raises(EnvcalError) as caught:
        read(tmp_path, name, text)
    return str(caught.value)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("plain.csv", csv_text()),
        ("titled.csv", csv_text(header="wavelength,R,G,B")),
        ("spaces.txt", csv_text(separator="  ")),
        ("semicolons.csv", "# a remark\n\n" + csv_text(separator="; ", header="nm; red; green; blue")),
        ("backwards.csv", csv_text(CURVES[::-1], nm=NM[::-1])),
        ("another_order.csv", csv_text(CURVES[:, ::-1], header="wavelength,B,G,R")),
        ("camera.json", json_text()),
        ("another_order.json", json_text(CURVES[:, ::-1], columns=("B", "G", "R"))),
    ],
)
def test_every_layout_gives_the_same_curves(tmp_path, name, text):
    np.testing.assert_allclose(read(tmp_path, name, text, NM), CURVES / CURVES.max(), rtol=1e-12)


def test_between_samples_they_are_linear_and_outside_zero(tmp_path):
    found = read(tmp_path, "a.csv", csv_text(), np.array([380.0, 399.0, 405.0, 700.0, 701.0]))
    np.testing.assert_allclose(found[2], (CURVES[0] + CURVES[1]) / 2 / CURVES.max(), rtol=1e-12)
    np.testing.assert_allclose(found[3], CURVES[-1] / CURVES.max(), rtol=1e-12)
    assert not found[[0, 1, 4]].any()


def test_the_unit_of_the_file_is_divided_out_and_the_ratio_of_the_channels_kept(tmp_path):
    curves = CURVES * [0.5, 1.0, 0.8]
    np.testing.assert_allclose(
        read(tmp_path, "a.csv", csv_text(curves * 4095.0)), read(tmp_path, "b.csv", csv_text(curves)), rtol=1e-12
    )
    np.testing.assert_allclose(read(tmp_path, "b.csv", csv_text(curves)).max(axis=0), [0.5, 1.0, 0.8], rtol=1e-12)


def test_noise_below_zero_becomes_zero(tmp_path):
    assert read(tmp_path, "a.csv", csv_text(CURVES - 0.005)).min() == 0.0


@pytest.mark.parametrize("name", known_cameras())
def test_a_camera_by_name_is_what_colour_science_carries(name):
    import colour

    published = colour.MSDS_CAMERA_SENSITIVITIES[name]
    found = sensitivities(name, published.wavelengths)
    np.testing.assert_allclose(found, published.values / published.values.max(), rtol=1e-12, atol=1e-15)
    assert is_known(name) and not is_known(name + ".csv")


def test_a_name_that_is_neither_camera_nor_file_is_told_with_the_names_there_are():
    with pytest.raises(EnvcalError, match=r"Nikon 5200.*Nikon 5100 \(NPL\)"):
        sensitivities("Nikon 5200", GRID)


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("a.csv", "", "holds 0 samples"),
        ("a.csv", "nm,R,G,B\nfrom,the,second,line\n", "a.csv:2"),
        ("a.csv", csv_text() + "710,0,0\n", "a.csv:32: '710,0,0' is not"),
        ("a.csv", csv_text().replace("500.0,", "490.0,"), "490 nm stands there twice"),
        ("a.csv", csv_text(nm=NM / 1000), "micrometres"),
        ("a.csv", csv_text(CURVES[:20], nm=NM[:20]), "expected at least 450 to 650 nm"),
        ("a.csv", csv_text(CURVES[::5], nm=NM[::5]), "50 nm between two samples"),
        ("a.csv", csv_text(CURVES * [1, 0, 1]), "channel G sees nothing"),
        ("a.csv", csv_text(CURVES - 0.1), "not negative"),
        ("a.csv", csv_text(np.where(CURVES >= CURVES.max(), np.nan, CURVES)), "no finite numbers"),
        ("a.json", "{", "is not JSON"),
        ("a.json", "[" * 100_000, "is not JSON"),
        ("a.json", "[]", "where they should be"),
        ("a.json", '{"spectral_data": {"data": {"main": {}}}}', "holds 0 samples"),
        ("a.json", json_text().replace('"500": [', '"500": [1, '), "main['500']"),
        ("a.json", json_text().replace('"500": [', '"half": ['), "main['half']"),
    ],
)
def test_what_is_no_sensitivity_is_refused_with_a_reason(tmp_path, name, text, told):
    message = refused(tmp_path, name, text)
    assert told in message and name in message


def test_sizes_are_bounded(tmp_path, monkeypatch):
    assert "more than 5000 samples" in refused(
        tmp_path, "many.csv", "".join(f"{400 + k / 100},1,1,1\n" for k in range(5001))
    )
    monkeypatch.setattr(cameras, "MOST_BYTES", 100)
    assert "expected at most 100" in refused(tmp_path, "large.csv", csv_text())


def test_a_file_that_is_no_text_is_refused(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"\xff\xfe\x00\x81" * 9)
    with pytest.raises(EnvcalError, match="is not text"):
        sensitivities(tmp_path / "a.csv", GRID)
