"""Files are whole or absent."""

import errno
import hashlib

import pytest

from envcal import atomic
from envcal.errors import EnvcalError


def test_a_text_takes_its_name_only_when_it_is_whole(tmp_path):
    atomic.write_text(tmp_path / "deep" / "a.txt", "λ\n")
    assert (tmp_path / "deep" / "a.txt").read_bytes() == "λ\n".encode()
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["a.txt"]


def test_a_failure_keeps_what_stood_there(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("before")
    with pytest.raises(ZeroDivisionError), atomic.replacing(path) as part:
        part.write_text("half")
        raise ZeroDivisionError
    assert path.read_text() == "before"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_a_full_disk_says_so_and_what_to_do(tmp_path):
    with pytest.raises(EnvcalError, match=r"disk is full.*Free some space"), atomic.replacing(tmp_path / "a.txt"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_in_the_way_is_named(tmp_path):
    (tmp_path / "a.txt").mkdir()
    with pytest.raises(EnvcalError, match="is a folder"):
        atomic.write_text(tmp_path / "a.txt", "x")


def test_not_a_number_never_reaches_json(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        atomic.write_json(tmp_path / "a.json", {"x": float("nan")})
    assert list(tmp_path.iterdir()) == []


def test_the_digest_is_that_of_the_bytes(tmp_path):
    (tmp_path / "a").write_bytes(b"abc" * 1000)
    assert atomic.digest(tmp_path / "a") == hashlib.sha256(b"abc" * 1000).hexdigest()
    with pytest.raises(EnvcalError, match="cannot be read"):
        atomic.digest(tmp_path / "b")


def test_the_sweep_removes_half_written_files_and_nothing_else(tmp_path):
    (tmp_path / "merge").mkdir()
    (tmp_path / "merge" / ".a.exr.123.part").write_text("half")
    (tmp_path / "merge" / "a.exr").write_text("whole")
    (tmp_path / "note.part").write_text("somebody's own")
    atomic.sweep(tmp_path)
    assert sorted(p.name for p in tmp_path.rglob("*") if p.is_file()) == ["a.exr", "note.part"]
