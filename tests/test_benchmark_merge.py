"""The merge benchmark runs, holds every library against the same truth, and names what it skips."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import merge


def test_the_bracket_covers_its_truth_and_the_ideal_estimator_is_unbiased(tmp_path: Path) -> None:
    radiance = merge.truth(240, 160)
    fault = merge.faults(7, faulty=True)
    best = merge.write(tmp_path, radiance, 7, fault)
    true = merge.mosaic_of(radiance)
    assert len(list(tmp_path.glob("*.dng"))) == 7
    assert np.isfinite(best).mean() > 0.99
    for rmse, bias in merge.by_decade(best, true, 1.0).values():
        assert abs(bias) < 0.2 * rmse


@pytest.mark.slow
def test_envcal_is_measured_beside_the_ideal_and_a_missing_library_is_named() -> None:
    ways = ("envcal", "HDRutils")
    rows, ideal = merge.measure((300, 200), 7, faulty=True, peers=Path(sys.executable), ways=ways)
    assert rows[0].skipped == ""
    for decade, best in ideal.items():
        assert rows[0].rmse[decade] < 1.05 * best
        assert abs(rows[0].bias[decade]) < 3e-3
    assert rows[0].fringe < 1.5 * rows[0].fringe_elsewhere
    shown = merge.table(rows, ideal)
    assert "ratio to the ideal" in shown
    if rows[1].skipped:
        assert "skipped HDRutils: " in shown


def test_the_fringe_is_that_of_the_pixels_beside_clipping() -> None:
    radiance = merge.truth(240, 160)
    fault = merge.faults(7, faulty=False)
    image = radiance.copy()
    green = np.log(radiance[..., 1])
    top = -np.log(float(merge.times(7)[4]))
    image[..., 0][np.abs(green - top) < 0.02] *= 1.5
    beside, elsewhere = merge.fringes(image, radiance, fault, 7)
    assert beside > 0.05
    assert elsewhere < 1e-3


def test_the_figures_are_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        merge, "measure", lambda *_, **__: ([merge.Row("envcal", rmse={0: 0.01}, bias={0: 0.0})], {0: 0.01})
    )
    assert merge.main(["--size", "300x200", "--json", str(tmp_path / "f.json")]) == 0
    found = json.loads((tmp_path / "f.json").read_text(encoding="utf-8"))
    assert len(found) == 2
    assert all(entry["rows"][0]["name"] == "envcal" for entry in found.values())


def test_the_ratios_are_those_of_the_others_and_of_one_core() -> None:
    def row(name: str, seconds: float, rmse: float) -> merge.Row:
        return merge.Row(name, seconds=seconds, cpu=2 * seconds, peak_per_pixel=10 * seconds, rmse={0: rmse})

    rows = [row("envcal", 2.0, 0.01), row("envcal, one core", 3.0, 0.01), row("envcal to EXR", 4.0, 0.01)]
    one_core, other = merge.ratios([*rows, row("HDRutils", 20.0, 0.02)])
    assert one_core.endswith("1.50 times as fast as on one")
    assert "HDRutils : envcal: time 10.0 (5.0 with the file written), CPU time 10.0, memory 10.0" in other
    assert "error 2.00 to 2.00" in other
    assert merge.ratios([row("HDRutils", 20.0, 0.02)]) == []
