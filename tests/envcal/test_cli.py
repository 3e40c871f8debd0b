"""The doors: commands, exit statuses and messages that scripts and people rely on."""

import subprocess
import sys

import numpy as np
import pytest
from click.testing import CliRunner

from envcal import exr, provenance
from envcal.cli import SPACES, STAGE_NAMES, main
from envcal.config import MergeSettings, WorkingSpace, stage_settings
from envcal.stages import STAGES


def envcal(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


def test_the_doors_are_there():
    commands = {"run", "check", "merge", "correct", "balance", "panorama", "cluster", "uplift", "spectra", "report"}
    assert commands <= set(main.commands)
    # The name is kept free for the comparison of an estimate with the truth.
    assert "evaluate" not in main.commands


def test_help_imports_nothing_heavy():
    code = (
        "import sys\nfrom envcal.cli import main\n"
        "try: main(['--help'])\nexcept SystemExit: pass\n"
        "heavy = {'numpy', 'cv2', 'colour', 'numba', 'pydantic', 'scipy', 'matplotlib', 'rich', 'OpenEXR', 'rawpy'}\n"
        "found = heavy & set(sys.modules)\n"
        "sys.exit(f'imported: {found}' if found else 0)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Commands:" in done.stdout


def test_the_command_line_names_the_stages_and_spaces_of_the_code():
    from typing import get_args

    from uplift.spectrum import RGB_SPACES

    assert tuple(stage.name for stage in STAGES) == STAGE_NAMES
    assert set(SPACES) == set(RGB_SPACES) == set(get_args(WorkingSpace))


def test_every_stage_takes_only_what_an_earlier_one_leaves():
    left = {"{frames}", "{darkroom}", "{chart}", "{lamp}", "{pair}", "{spectra}"}
    for stage in STAGES:
        assert {name.replace("{map}", "{shot}") for name in stage.inputs} <= left, stage.name
        left |= set(stage.outputs)


def test_a_mistake_in_the_input_is_one_message_and_status_1(tmp_path):
    done = envcal("run", tmp_path / "none.yaml")
    assert done.exit_code == 1
    assert done.stderr.startswith("envcal: ")
    assert "Traceback" not in done.stderr


def test_wrong_usage_is_status_2():
    assert envcal("run").exit_code == 2
    assert envcal("nonsense").exit_code == 2
    assert envcal("uplift", "a.exr", "-o", "b.exr", "--method", "magic").exit_code == 2
    assert envcal("uplift", "a.exr", "-o", "b.exr", "--clusters", "c.exr", "--indoor", "led").exit_code == 2
    assert envcal("spectra", "a.exr", "-o", "b.exr", "--wavelengths", "violet").exit_code == 2
    assert envcal("correct", "a.exr", "-o", "b.exr", "--chart", "1,2,3").exit_code == 2
    assert envcal("balance", "a.exr", "-o", "b.exr", "--lamp", "1,2,3").exit_code == 2
    assert envcal("correct", "a.exr", "-o", "b.exr", "--profile", "p.json", "--space", "sRGB").exit_code == 2
    assert envcal("balance", "a.exr", "-o", "b.exr", "--profile", "p.json", "--lamp", "1,2,3,4").exit_code == 2


@pytest.mark.parametrize("command", ["merge", "correct", "balance", "panorama", "cluster", "uplift", "spectra"])
def test_a_missing_file_is_named(tmp_path, command):
    done = envcal(command, tmp_path / "none.exr", "-o", tmp_path / "out.exr")
    assert done.exit_code == 1
    assert "none.exr" in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("command", "attributes", "remedy"),
    [
        ("correct", {}, "envcal merge"),
        ("correct", {"envcalSpace": "sRGB"}, "envcal merge"),
        ("balance", {}, "envcal correct"),
        ("panorama", {}, "envcal correct"),
        ("panorama", provenance.colour_space(provenance.CAMERA_RGB), "envcal correct"),
        ("spectra", {}, "envcal uplift"),
    ],
)
def test_a_file_of_the_wrong_stage_is_refused_with_the_command_to_run(tmp_path, command, attributes, remedy):
    source = tmp_path / "in.exr"
    exr.write(source, exr.rgb_planes(np.ones((8, 16, 3), np.float32)), attributes=attributes)
    done = envcal(command, source, "-o", tmp_path / "out.exr")
    assert done.exit_code == 1
    assert remedy in done.stderr
    assert not (tmp_path / "out.exr").exists()


def test_only_an_exr_is_written_and_it_says_so(tmp_path):
    exr.write(tmp_path / "map.exr", exr.rgb_planes(np.ones((8, 16, 3), np.float32)), attributes={})
    done = envcal("uplift", tmp_path / "map.exr", "-o", tmp_path / "out.png")
    assert done.exit_code == 2
    assert "does not end in .exr" in done.stderr
    assert not (tmp_path / "out.png").exists()


def test_ctrl_c_is_a_stop_and_no_mistake(tmp_path, monkeypatch):
    def stop(*_arguments, **_settings):
        raise KeyboardInterrupt

    monkeypatch.setattr("envcal.config.load", stop)
    done = envcal("run", tmp_path / "pipeline.yaml")
    assert done.exit_code == 130
    assert "goes on where it stopped" in done.stderr


def test_compiled_code_goes_to_a_folder_of_this_process_where_nothing_else_can_be_written(monkeypatch):
    from pathlib import Path

    from envcal.cli import group

    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(group.os, "access", lambda *_: False)
    group._let_numba_cache()
    folder = Path(group.os.environ["NUMBA_CACHE_DIR"])
    assert folder.is_dir()
    assert list(folder.iterdir()) == []
    assert folder.stat().st_mode & 0o077 == 0 or group.os.name == "nt"
    folder.rmdir()
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.undo()
    group._let_numba_cache()


def test_a_report_without_a_run_is_refused(tmp_path):
    done = envcal("report", tmp_path)
    assert done.exit_code == 1
    assert "no finished run" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("merge", "a.dng", "--set", "aling=true"), "--set aling=true: aling: is not a setting; did you mean `align`?"),
        (("merge", "a.dng", "--set", "merge.align=1.5"), "--set merge.align=1.5: align: "),
        (("merge", "a.dng", "--set", "exposures={b.dng: 0.1}"), "merge.exposures.b.dng: no frame of any shot"),
        (("correct", "a.exr", "--set", "fit=cubic"), "--set fit=cubic: fit: is 'cubic'; it can be 'linear'"),
        (("correct", "a.exr", "--set", "chart=auto", "--chart", "1,1,2,1,2,2,1,2"), "is also given as an option"),
        (("balance", "a.exr", "--set", "transform"), "expected key.key=value"),
        (("uplift", "a.exr", "--method", "scaled", "--set", "method=lattice"), "--set method: is also given"),
    ],
)
def test_a_stage_refuses_a_setting_as_the_pipeline_does(tmp_path, arguments, message):
    done = envcal(*arguments, "-o", tmp_path / "out.exr")
    assert done.exit_code == 1
    assert message in done.stderr


def test_a_stage_takes_any_of_its_settings():
    settings = stage_settings(MergeSettings, "merge", ["align=true", "merge.lost=[1, 2, 3]"], dark_frame=None)
    assert settings.align is True
    assert settings.lost == (1.0, 2.0, 3.0)
    assert settings.dark_frame is None


def test_lights_and_profiles_of_a_stage_are_files_of_their_own(tmp_path):
    source = tmp_path / "map.exr"
    exr.write(source, exr.rgb_planes(np.ones((16, 32, 3), np.float32)), attributes={})
    done = envcal("cluster", source, "-o", tmp_path / "out.exr", "--set", "lights=[{at: [0, 0], type: led}]")
    assert done.exit_code == 2
    assert "--lights" in done.stderr


def test_check_finds_an_output_that_cannot_be_a_folder(tmp_path):
    (tmp_path / "taken").write_text("a file")
    (tmp_path / "f1.dng").write_bytes(b"no photograph")
    pipeline = tmp_path / "pipeline.yaml"
    pipeline.write_text("capture: {reference: f1.dng}\noutput: taken/here\n")
    done = envcal("check", pipeline)
    assert done.exit_code == 1
    assert f"output: {tmp_path / 'taken'} is a file; give the name of a folder" in done.stderr
    assert "f1.dng" in done.stderr
