"""The benchmark of charts can be cut, goes on where it was, and counts what its scenes say."""

import json

from benchmarks import chart

NOTHING = ["--with", "0", "--without", "0", "--maps", "0", "--sg", "0", "--passports", "0", "--two", "0"]


def a_scene(looked, *, missed=()):
    def row(seed):
        looked.append(seed)
        good = seed not in missed
        return {
            "good": good,
            "error": 0.001 * seed if good else None,
            "seconds": 1.0,
            "what": "scene",
            "said": "refused",
        }

    return row


def run(*arguments):
    assert chart.main([*NOTHING, *map(str, arguments)]) == 0


def test_a_run_that_was_cut_goes_on_and_seeds_can_be_shared_out(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("ENVCAL_DATA", raising=False)
    looked = []
    monkeypatch.setitem(chart.KINDS, "pictures", a_scene(looked, missed=[12]))
    log = tmp_path / "chart.jsonl"
    run("--first", 10, "--with", 3, "--log", log)
    with log.open("a", encoding="utf-8") as file:
        file.write('{"kind": "pictures", "seed": 13, "go')  # killed while it wrote
    run("--first", 10, "--with", 5, "--log", log, "--json", tmp_path / "figures.json")
    run("--first", 10, "--with", 5, "--log", log)
    assert looked == [10, 11, 12, 13, 14]
    figures = json.loads((tmp_path / "figures.json").read_text())["pictures"]
    assert (figures["scenes"], figures["good"], figures["missed"]) == (5, 4, [12])
    shown = capsys.readouterr().out
    assert "pictures 12 (scene): refused" in shown and "pictures: 4 of 5 (80.0%)" in shown


def test_one_scene_of_a_real_search_is_counted(monkeypatch, capsys):
    monkeypatch.delenv("ENVCAL_DATA", raising=False)
    run("--first", 30001, "--passports", 1)
    assert "passports: 1 of 1 (100.0%) found within 2% of the width; error median" in capsys.readouterr().out
