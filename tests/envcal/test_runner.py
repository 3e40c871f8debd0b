"""The runner: unchanged stages are skipped, changed ones and all that follows are done again, kills do no harm."""

import json

import pytest

from envcal import config
from envcal.errors import EnvcalError
from envcal.reporter import Reporter
from envcal.runner import RECORD, Outcome, Run, Stage, run_pipeline


class Counter:
    """Three stages that copy text on and count how often they were done."""

    def __init__(self):
        self.done = []

    def stages(self):
        def work(name, source, target):
            def copy(run: Run) -> Outcome:
                self.done.append(name)
                text = source(run)
                path = run.path(target)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(f"{text}>{name}")
                return Outcome(f"{name} done", {"length": len(text)}, [f"{name} warns"] if name == "correct" else [])

            return copy

        return (
            Stage("merge", "", ("merge",), ("{frames}",), ("merge/{shot}.exr",),
                  work("merge", lambda r: r.loaded.reference[0].read_text(), "merge/reference.exr")),
            Stage("correct", "", ("correct",), ("merge/{shot}.exr",), ("correct/x.exr",),
                  work("correct", lambda r: r.path("merge/reference.exr").read_text(), "correct/x.exr")),
            Stage("report", "", (), ("correct/x.exr",), ("report.html",),
                  work("report", lambda r: r.path("correct/x.exr").read_text(), "report.html")),
        )  # fmt: skip


@pytest.fixture
def capture(tmp_path):
    (tmp_path / "a.dng").write_text("light")
    (tmp_path / "pipeline.yaml").write_text("capture: {reference: a.dng}\n")
    return tmp_path


def go(folder, counter, overrides=(), **kwargs):
    counter.done.clear()
    loaded = config.load(folder / "pipeline.yaml", overrides=overrides)
    record = run_pipeline(loaded, counter.stages(), reporter=Reporter(quiet=True), **kwargs)
    return counter.done[:], record


def test_a_second_run_does_nothing_and_says_the_same(capture):
    counter = Counter()
    first = go(capture, counter)
    second = go(capture, counter)
    assert first[0] == ["merge", "correct", "report"]
    assert second[0] == []
    assert first[1] == second[1]
    assert json.loads((capture / "output" / RECORD).read_text()) == first[1]


def test_warnings_of_skipped_stages_are_told_again(capture, capsys):
    go(capture, Counter())
    capsys.readouterr()
    go(capture, Counter())
    assert "warning: correct: correct warns" in capsys.readouterr().err


def test_a_changed_frame_does_everything_again_and_a_changed_setting_what_depends_on_it(capture):
    counter = Counter()
    go(capture, counter)
    assert go(capture, counter, overrides=["correct.fit=white-preserving"])[0] == ["correct", "report"]
    (capture / "a.dng").write_text("other light")
    assert go(capture, counter)[0] == ["merge", "correct", "report"]


def test_an_output_that_was_changed_or_lost_is_made_again_and_what_follows_stays_if_it_is_the_same(capture):
    counter = Counter()
    go(capture, counter)
    (capture / "output" / "merge" / "reference.exr").write_text("flipped bits")
    assert go(capture, counter)[0] == ["merge"] or counter.done == ["merge", "report"]
    (capture / "output" / "correct" / "x.exr").unlink()
    assert "correct" in go(capture, counter)[0]
    assert "merge" not in counter.done


def test_from_force_and_until_do_what_they_say(capture):
    counter = Counter()
    assert go(capture, counter, until="correct")[0] == ["merge", "correct"]
    assert go(capture, counter)[0] == ["report"]
    assert go(capture, counter, first="correct")[0] == ["correct", "report"]
    assert go(capture, counter, force=True)[0] == ["merge", "correct", "report"]


def test_a_stage_that_fails_keeps_the_ones_before_it(capture):
    counter = Counter()
    stages = list(counter.stages())

    def fail(_run):
        raise EnvcalError("no chart")

    broken = [stages[0], Stage("correct", "", ("correct",), ("merge/{shot}.exr",), ("correct/x.exr",), fail)]
    loaded = config.load(capture / "pipeline.yaml")
    with pytest.raises(EnvcalError, match="no chart"):
        run_pipeline(loaded, broken, reporter=Reporter(quiet=True))
    assert go(capture, counter)[0] == ["correct", "report"]


@pytest.mark.parametrize("damage", ["", "{", "[]", '{"stages": {"merge": 3}}', '{"stages": {"merge": {"key": "x"}}}'])
def test_a_damaged_record_only_costs_time(capture, damage):
    counter = Counter()
    go(capture, counter)
    (capture / "output" / RECORD).write_text(damage)
    assert go(capture, counter)[0] == ["merge", "correct", "report"]


def test_two_runs_in_one_folder_are_refused(capture):
    from filelock import FileLock

    (capture / "output").mkdir()
    with (
        FileLock(capture / "output" / ".lock"),
        pytest.raises(EnvcalError, match="another envcal is running in this folder"),
    ):
        go(capture, Counter())


def test_an_output_that_is_a_file_is_refused(capture):
    (capture / "output").write_text("in the way")
    with pytest.raises(EnvcalError, match="cannot be used"):
        go(capture, Counter())


def test_half_written_files_of_a_killed_run_are_swept(capture):
    (capture / "output" / "merge").mkdir(parents=True)
    left = capture / "output" / "merge" / ".reference.exr.4711.part"
    left.write_text("half")
    go(capture, Counter())
    assert not left.exists()
