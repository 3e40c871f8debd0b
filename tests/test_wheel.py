"""The wheel holds all that is needed, and works where the source does not stand."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from envcal import exr

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", folder, ROOT]
    subprocess.run(command, check=True, capture_output=True, cwd=folder)
    (path,) = folder.glob("*.whl")
    return path


@pytest.mark.slow
def test_the_wheel_holds_the_three_rooms_and_nothing_else(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == {"envcal", "calibrate", "uplift"}
    assert {"envcal/report/page.html.j2", "envcal/py.typed", "calibrate/py.typed", "uplift/py.typed"} <= set(names)
    assert any(name.endswith("LICENSE") for name in names)
    sources = {
        p.relative_to(ROOT).as_posix()
        for room in ("envcal", "calibrate", "uplift")
        for p in (ROOT / room).rglob("*.py")
    }
    assert sources <= set(names)


@pytest.mark.slow
def test_the_installed_wheel_uplifts_a_map(wheel, tmp_path):
    target = tmp_path / "site"
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", target, wheel]
    subprocess.run(install, check=True, capture_output=True)
    image = np.random.default_rng(1).random((16, 32, 3), np.float32)
    exr.write(tmp_path / "map.exr", exr.rgb_planes(image), attributes={})
    code = (
        "import sys, envcal, uplift, calibrate\n"
        f"assert envcal.__file__.startswith({str(target)!r}), envcal.__file__\n"
        f"assert uplift.__file__.startswith({str(target)!r})\n"
        "from envcal.cli import main\nmain(sys.argv[1:])\n"
    )
    command = [sys.executable, "-P", "-c", code, "uplift", "map.exr", "-o", "up.exr"]
    environment = {**os.environ, "PYTHONPATH": str(target)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "up.exr").is_file()
