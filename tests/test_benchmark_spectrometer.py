"""The spectrometer's benchmark measures with priors that do not know the lamp, and simulates what it says."""

import numpy as np

from benchmarks import __main__ as program
from benchmarks import spectrometer as bench
from uplift.spectrometer import anchored
from uplift.spectrum import illuminant, observer

EYES = observer()


def test_without_the_folder_it_says_so_and_measures_nothing(capsys, monkeypatch):
    monkeypatch.delenv("ENVCAL_DATA", raising=False)
    assert program.main(["spectrometer"]) == 0
    assert "nothing is measured" in capsys.readouterr().out


def test_a_lamp_is_left_out_with_those_that_are_the_same():
    names = bench.alike(illuminant("A", EYES))
    # The NIST's incandescent lamps are A by other names.
    assert {"A", "Incandescent"} <= names and "FL11" not in names
    assert all(lamp.name in lamp.left_out for lamp in bench.left_out_lamps())


def test_a_reading_without_noise_is_the_sum_over_wavelengths(monkeypatch):
    monkeypatch.setattr(bench, "NOISE", 0.0)
    curves = anchored(np.exp(-0.5 * ((EYES.wavelengths_nm[:, None] - [600, 540, 460]) / 40.0) ** 2), EYES)
    reading = bench.read(illuminant("D65", EYES), curves, seed=1)
    # D65 lights the chart as the lamp itself shines, so a white of reflectance r reads r in every channel.
    white = bench.chart_reflectances(EYES)[18]
    assert (reading.values[18] <= white.max()).all() and (reading.values[18] >= white[8:].min()).all()


def test_the_report_counts_what_was_refused():
    row = {"family": "led", "name": "a", "camera": 1, "scaled": [2.0], "true": [1.0], "known": [1.0], "unknown": [2.0]}
    row |= {"known_refused": False, "unknown_refused": True, "known_sure": 1.0, "unknown_sure": 1.5}
    shown = bench.report({"relight": [row]})
    assert "known    geometric mean 0.500, gain of the true spectrum 100%" in shown
    assert "unknown: 100.0% refused" in shown and "1.50 times as large" in shown
