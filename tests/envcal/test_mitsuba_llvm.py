"""Which LLVM is taken and which is refused, before anything is compiled with it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mitsuba", reason="Mitsuba is not installed: pip install 'envcal[mitsuba]'")

from envcal.errors import EnvcalError

em = pytest.importorskip("envcal.mitsuba")
from envcal.mitsuba import llvm  # noqa: E402


@pytest.fixture
def x86(monkeypatch):
    monkeypatch.setattr("platform.machine", lambda: "x86_64")


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("/usr/lib/x86_64-linux-gnu/libLLVM-14.so.1", 14),
        ("/usr/lib/x86_64-linux-gnu/libLLVM-14.0.6.so.1", 14),
        ("/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1", 19),
        ("/usr/lib/x86_64-linux-gnu/libLLVM-19.so", 19),
        ("/usr/lib/llvm-16/lib/libLLVM.so.1", 16),
        ("/opt/homebrew/opt/llvm@18/lib/libLLVM.dylib", 18),
        ("/somewhere/libLLVM.so", None),
    ],
)
def test_the_version_is_read_from_the_name(name, version):
    assert llvm.version_of(Path(name)) == version


def test_a_link_is_followed_to_its_version(tmp_path):
    (tmp_path / "libLLVM.so.20.1").touch()
    (tmp_path / "libLLVM.so").symlink_to("libLLVM.so.20.1")
    assert llvm.version_of(tmp_path / "libLLVM.so") == 20


def test_the_proven_version_is_preferred_and_bad_ones_are_passed_over(x86):
    names = ["libLLVM-14.so.1", "libLLVM-15.so.1", "libLLVM.so.18.1", "libLLVM.so.19.1", "libLLVM.so.21.1"]
    assert llvm.best(map(Path, names)) == Path("libLLVM.so.19.1")
    assert llvm.best(map(Path, ["libLLVM.so.18.1", "libLLVM.so.21.1"])) == Path("libLLVM.so.21.1")
    assert llvm.best(map(Path, ["libLLVM-14.so.1", "libLLVM-15.so.1", "libLLVM-16.so.1"])) is None


def test_what_the_environment_names_is_left_alone(monkeypatch):
    monkeypatch.setenv(llvm.VARIABLE, "/mine/libLLVM.so.18.1")
    assert llvm.provide() == Path("/mine/libLLVM.so.18.1")
    assert os.environ[llvm.VARIABLE] == "/mine/libLLVM.so.18.1"


def test_a_good_library_is_named_for_the_renderer(monkeypatch, x86):
    monkeypatch.setenv(llvm.VARIABLE, "")
    monkeypatch.setattr(llvm, "libraries", lambda: map(Path, ["/a/libLLVM-15.so.1", "/a/libLLVM.so.19.1"]))
    assert llvm.provide() == Path("/a/libLLVM.so.19.1")
    assert os.environ[llvm.VARIABLE] == str(Path("/a/libLLVM.so.19.1"))


@pytest.mark.parametrize("version", [(15, 0, 7), (16, 0, 6)])
def test_a_loaded_llvm_that_would_abort_is_refused_with_the_package_to_install(x86, version):
    with pytest.raises(EnvcalError, match=r"fmaximum.*libllvm19"):
        llvm.check_loaded(version)


def test_a_loaded_llvm_that_works_is_taken(x86):
    llvm.check_loaded((19, 1, 7))
    llvm.check_loaded(None)


@pytest.mark.parametrize("version", [14, 15, 16])
def test_a_library_named_by_hand_that_cannot_work_is_refused(monkeypatch, tmp_path, x86, version):
    library = tmp_path / f"libLLVM-{version}.so.1"
    library.touch()
    monkeypatch.setenv(llvm.VARIABLE, str(library))
    with pytest.raises(EnvcalError, match=f"is LLVM {version}.*libllvm19"):
        em.set_variant("llvm_ad_spectral")


def test_a_library_named_by_hand_that_is_not_there_is_refused(monkeypatch, tmp_path):
    monkeypatch.setenv(llvm.VARIABLE, str(tmp_path / "libLLVM.so.19.1"))
    with pytest.raises(EnvcalError, match="there is no such file"):
        em.set_variant("llvm_ad_spectral")


def test_an_unknown_variant_is_refused_with_the_known_ones():
    with pytest.raises(EnvcalError, match="scalar_rgb"):
        em.set_variant("scalar_octarine")


def run(code, **environment):
    """Run `code` in a Python of its own; return its last line."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    return (done.stdout + done.stderr).strip().splitlines()[-1]


def test_without_mitsuba_the_package_to_install_is_named():
    last = run("import sys; sys.modules['mitsuba'] = None; import envcal.mitsuba")
    assert "MitsubaMissingError" in last
    assert "pip install 'envcal[mitsuba]'" in last


def test_the_plugin_is_there_whichever_comes_first_variant_or_import():
    made = "print(type(mi.load_dict({'type': 'envcal'})))"
    for first, then in (
        ("import envcal.mitsuba; import mitsuba as mi", "mi.set_variant('scalar_rgb')"),
        ("import mitsuba as mi; mi.set_variant('scalar_rgb')", "import envcal.mitsuba"),
    ):
        assert 'needs "filename"' in run(f"{first}; {then}; {made}")
