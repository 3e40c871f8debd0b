"""The rendered relight benchmark: what it needs, and that its truth is the transport times the lamp."""

import numpy as np
import pytest

from benchmarks import __main__ as program
from benchmarks import relit_render
from uplift.spectrum import illuminant


def test_without_the_folder_of_rooms_it_says_so_and_stops(capsys, monkeypatch):
    monkeypatch.delenv("ENVCAL_DATA", raising=False)
    assert program.main(["relit_render"]) == 0
    assert "skipped: the environment variable ENVCAL_DATA names no folder" in capsys.readouterr().out


def test_a_lamp_is_found_by_its_cie_name_or_in_the_measured_table(tmp_path):
    grid = range(380, 781)
    rows = ["name," + ",".join(map(str, grid)), "CIE S025 PhLED_3," + ",".join(str(w - 370) for w in grid)]
    (tmp_path / "led19_measured.csv").write_text("\n".join(rows), encoding="utf-8")
    eyes = relit_render.EYES
    np.testing.assert_array_equal(relit_render.lamp("FL2", tmp_path, eyes), illuminant("FL2", eyes))
    found = relit_render.lamp("CIE S025 PhLED_3", tmp_path, eyes)
    np.testing.assert_allclose(found / found[0], (eyes.wavelengths_nm - 370) / 10)


def test_the_transport_is_that_of_all_lamps_interpolated_to_our_grid(tmp_path):
    (tmp_path / "truth").mkdir()
    transport = np.random.default_rng(1).random((3, 2, 4, 41)).astype(np.float16)
    np.savez(tmp_path / "truth" / "room0.npz", transport=transport, wavelengths=np.arange(380.0, 781.0, 10.0))
    found = relit_render.transport_of(tmp_path, "room0")
    total = transport.astype(float).sum(axis=0)
    np.testing.assert_allclose(found[..., ::2], total, rtol=1e-5)
    np.testing.assert_allclose(found[..., 1::2], (total[..., :-1] + total[..., 1:]) / 2, rtol=1e-5)


def test_noise_is_taken_off_in_squares():
    ways = dict.fromkeys(relit_render.WAYS, 0.5)
    row = relit_render.Row("room0", "FL2", "fluorescent", 1, ways, ways, ways | {"scaled": 0.3})
    assert row.without_noise("scaled") == pytest.approx(0.4) and row.without_noise("declared") == 0 and row.ratio == 1
