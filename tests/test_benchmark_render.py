"""The renderer's benchmark runs, prints its ratios, and finds the emitter right; times are not judged here."""

import json

import pytest

from benchmarks import __main__ as program
from benchmarks import render
from envcal.errors import EnvcalError


@pytest.mark.slow
def test_the_render_benchmark_prints_every_ratio(capsys, tmp_path):
    em = pytest.importorskip("envcal.mitsuba", reason="Mitsuba is not installed: pip install 'envcal[mitsuba]'")
    try:
        em.set_variant(render.VARIANT)
    except EnvcalError as error:
        pytest.skip(str(error))
    arguments = ["render", "--size", "64x32", "--spp", "4", "--repeat", "1", "--json", f"{tmp_path}/f"]
    assert program.main(arguments) == 0
    shown = capsys.readouterr().out
    figures = json.loads((tmp_path / "f").read_text())
    assert shown.count("ratio") == 4
    assert figures["furnace"] < 1e-6
    assert figures["sun_and_sky"]["envcal"]["highest"] == pytest.approx(1, abs=1e-4)
    assert figures["sun_and_sky"]["envmap"]["highest"] > 1.2


def test_without_a_renderer_the_benchmark_says_why(capsys, monkeypatch):
    def unavailable(*_names):
        raise EnvcalError("no LLVM. Install the Debian package `libllvm19`.")

    em = pytest.importorskip("envcal.mitsuba", reason="Mitsuba is not installed: pip install 'envcal[mitsuba]'")
    monkeypatch.setattr(em, "set_variant", unavailable)
    assert program.main(["render"]) == 0
    assert "skipped: no LLVM" in capsys.readouterr().out
