"""Test writing of files: atomic, durable, with the user's permissions, and without replacing files unless requested."""

import os
import stat
from pathlib import Path

import pytest

from probedesign.core import files
from probedesign.core.errors import InputError
from probedesign.core.files import backup, check_writable, write_atomically


@pytest.mark.skipif(os.name == "nt", reason="POSIX permissions")
@pytest.mark.parametrize("umask", [0o022, 0o002, 0o077])
def test_a_written_file_has_the_permissions_that_the_umask_leaves(tmp_path, umask):
    before = os.umask(umask)
    try:
        write_atomically(tmp_path / "new" / "a.json", b"{}")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "new" / "a.json").stat().st_mode) == 0o666 & ~umask


def test_the_content_is_on_the_disk_before_the_file_has_its_name(tmp_path, monkeypatch):
    target, order = tmp_path / "a", []
    fsync, replace = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda handle: (order.append("fsync"), fsync(handle))[1])
    monkeypatch.setattr(os, "replace", lambda *paths: (order.append("replace"), replace(*paths))[1])
    write_atomically(target, b"content")
    assert order[:2] == ["fsync", "replace"]
    assert target.read_bytes() == b"content"


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failed_write_leaves_the_former_file_and_no_other(tmp_path, monkeypatch, error):
    target = tmp_path / "a"
    write_atomically(target, b"former")

    def fail(*paths):
        raise error

    monkeypatch.setattr(files.os, "replace", fail)
    with pytest.raises((InputError, KeyboardInterrupt)):
        write_atomically(target, b"new")
    assert target.read_bytes() == b"former"
    assert list(tmp_path.iterdir()) == [target]


def test_an_existing_file_is_replaced_only_if_asked(tmp_path):
    target = tmp_path / "a"
    write_atomically(target, b"first", replace=False)
    with pytest.raises(InputError, match="exists already"):
        write_atomically(target, b"second", replace=False)
    assert target.read_bytes() == b"first"
    assert list(tmp_path.iterdir()) == [target]


def test_a_failed_check_leaves_nothing(tmp_path):
    def refuse(temporary):
        assert temporary.read_bytes() == b"content"
        raise InputError("refused")

    with pytest.raises(InputError, match="refused"):
        write_atomically(tmp_path / "a", b"content", check=refuse)
    assert list(tmp_path.iterdir()) == []


def test_backups_are_numbered(tmp_path):
    target = tmp_path / "a"
    assert backup(target) is None
    for content in (b"1", b"2"):
        target.write_bytes(content)
        backup(target)
    assert (tmp_path / "a.old").read_bytes() == b"1"
    assert (tmp_path / "a.old2").read_bytes() == b"2"


def test_a_folder_or_a_file_below_a_file_is_not_writable(tmp_path):
    (tmp_path / "a").touch()
    check_writable(tmp_path / "b" / "c")
    for refused in (check_writable, lambda path: write_atomically(path, b"")):
        with pytest.raises(InputError, match="cannot be written"):
            refused(tmp_path / "a" / "b")
    for folder in (Path("/"), tmp_path):
        with pytest.raises(InputError, match="cannot be written"):
            write_atomically(folder, b"")
