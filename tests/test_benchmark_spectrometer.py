"""The spectrometer's benchmark measures with priors that do not know the lamp, and simulates what it says."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import __main__ as program
from benchmarks.spectrometer import held_out as held
from benchmarks.spectrometer import lamps as tested
from benchmarks.spectrometer import readings, refusals
from benchmarks.spectrometer.kinds import judged_kinds
from benchmarks.spectrometer.report import report
from uplift.spectrometer import anchored, chart_reflectances
from uplift.spectrometer.prior import Prior
from uplift.spectrum import illuminant, observer

EYES = observer()


def test_without_the_folder_it_says_so_and_measures_nothing(capsys, monkeypatch):
    monkeypatch.delenv("ENVCAL_DATA", raising=False)
    assert program.main(["spectrometer"]) == 0
    assert "nothing is measured" in capsys.readouterr().out


def test_a_lamp_is_left_out_with_those_that_are_the_same():
    names = tested.alike(illuminant("A", EYES))
    # The NIST's incandescent lamps are A by other names.
    assert {"A", "Incandescent"} <= names and "FL11" not in names
    assert all(lamp.name in lamp.left_out for lamp in tested.left_out_lamps())


def test_a_reading_without_noise_is_the_sum_over_wavelengths(monkeypatch):
    monkeypatch.setattr(readings, "NOISE", 0.0)
    curves = anchored(np.exp(-0.5 * ((EYES.wavelengths_nm[:, None] - [600, 540, 460]) / 40.0) ** 2), EYES)
    reading = readings.read(illuminant("D65", EYES), curves, seed=1)
    # D65 lights the chart as the lamp itself shines, so a white of reflectance r reads r in every channel.
    white = chart_reflectances(EYES)[18]
    assert (reading.values[18] <= white.max()).all() and (reading.values[18] >= white[8:].min()).all()


def test_the_report_counts_what_was_refused():
    row = {"family": "led", "name": "a", "camera": 1, "scaled": [2.0], "true": [1.0], "known": [1.0], "unknown": [2.0]}
    row |= {"known_refused": False, "unknown_refused": True, "known_sure": 1.0, "unknown_sure": 1.5}
    shown = report({"relight": [row]})
    assert "known    geometric mean 0.500, gain of the true spectrum 100%" in shown
    assert "unknown: 100.0% refused" in shown and "1.50 times as large" in shown


def test_kinds_are_judged_by_the_most_probable_family_and_by_how_probable_it_was_said_to_be():
    truth = np.array([0, 0, 0, 1])
    found = np.full((4, 5), 0.05)
    found[np.arange(4), [0, 0, 1, 1]] = 0.8
    judged = judged_kinds(truth, found)
    assert judged["right"] == {"led": [pytest.approx(2 / 3), 3], "fluorescent": [1.0, 1]}
    assert judged["ece"] == pytest.approx(0.8 - 0.75)
    assert judged["log_loss"] == pytest.approx(-(3 * np.log(0.8) + np.log(0.05)) / 4)


def some_readings(favoured):
    """Readings of ten lamps of each family by a prior of one Gaussian a family; `favoured` by so much misfit is the LED."""
    prior = Prior(np.zeros((5, 1)), np.zeros((5, 1, 1)), np.zeros((5, 1, 1)), np.log(np.full(5, 0.2)), np.arange(5))
    chance = np.random.default_rng(3)
    out = []
    for lamp in range(50):
        misfit = 6.0 + chance.normal(0.0, 1.0, 5)
        misfit[lamp % 5] -= 6.0
        misfit[0] -= favoured
        out.append(held.Measured(lamp, lamp % 5, misfit, prior))
    return out


def test_every_reading_is_judged_once_by_a_choice_made_on_the_other_half():
    found = held.held_out(some_readings(0.0))
    assert found["held_out"]["readings"] == sum(half["readings"] for half in found["halves"]) == 50
    assert found["held_out"]["log_loss"] < np.log(5)
    assert "chosen on either half" in report({"held_out": found})


def test_where_leds_are_misread_as_likely_the_choice_makes_them_no_likelier():
    assert all(likelier == min(held.LIKELIER) for _, likelier in held.held_out(some_readings(5.0))["chosen"])


def test_a_refusal_counts_only_if_it_names_what_was_put_in(monkeypatch):
    curves = anchored(np.exp(-0.5 * ((EYES.wavelengths_nm[:, None] - [600, 540, 460]) / 40.0) ** 2), EYES)

    def always_a_veil(reading, **_):
        return SimpleNamespace(refused="most likely a veil of light lies over all patches")

    monkeypatch.setattr(refusals, "measure_light", always_a_veil)
    found = refusals.named(np.array([curves]), [0])
    assert found.pop("veil") == [8, 8]
    assert set(found) == set(refusals.TOLD) - {"veil"} and all(count == [0, 8] for count in found.values())
