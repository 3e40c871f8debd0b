"""A run that is killed goes on where it stopped, and ends with the same bytes as one that was not."""

import hashlib
import os
import random
import shutil
import subprocess
import sys
import time
from fractions import Fraction
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
KILLS = 10


def write_pipeline(folder):
    """A smaller bracket than the shipped one: the same room at 1024 pixels, three frames."""
    from samples import CaptureSettings, make_capture, write_capture

    exposures = (Fraction(1, 128), Fraction(1, 16), Fraction(1, 2))
    write_capture(folder / "frames", make_capture(CaptureSettings(width=1024, exposures_s=exposures, seed=7)))
    (folder / "pipeline.yaml").write_text("capture: {reference: frames/*.dng}\n")


def start(folder, output):
    command = [sys.executable, "-m", "envcal", "run", str(folder / "pipeline.yaml"), "--set", f"output={output}"]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def digests(output):
    return {p.relative_to(output): hashlib.sha256(p.read_bytes()).hexdigest() for p in output.rglob("*.exr")}


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="kill -9 is of other systems")
def test_kills_at_random_moments_leave_the_same_bytes(tmp_path):
    write_pipeline(tmp_path)
    begun = time.perf_counter()
    run = start(tmp_path, tmp_path / "whole")
    _, errors = run.communicate(timeout=600)
    assert run.returncode == 0, errors.decode()
    whole = time.perf_counter() - begun
    expected = digests(tmp_path / "whole")
    assert len(expected) == 7

    chance = random.Random(20261122)
    output, finished = tmp_path / "killed", 0
    for _ in range(KILLS):
        run = start(tmp_path, output)
        try:
            run.communicate(timeout=chance.uniform(0.2, 0.8) * whole)
            finished += 1
            shutil.rmtree(output)
        except subprocess.TimeoutExpired:
            run.kill()
            run.communicate()
            # Whatever has its final name is whole: it is byte for byte what an undisturbed run leaves.
            for path, digest in digests(output).items():
                assert expected[path] == digest, path
    run = start(tmp_path, output)
    _, errors = run.communicate(timeout=600)
    assert run.returncode == 0, errors.decode()
    assert digests(output) == expected
    assert not list(output.rglob("*.part"))
    assert finished < KILLS, "no run was killed; the test proves nothing"
