"""A folder that is written whole: what a kill, a Ctrl-C or a full disk leaves, and what the next export finds."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from probedesign.cad.folder import staged
from probedesign.core.errors import InputError

posix = pytest.mark.skipif(os.name == "nt", reason="signals and locks of POSIX")


def write(staging: Path, name: str, text: str = "new") -> None:
    (staging / name).write_text(text)


def manifest(*files: str) -> str:
    return json.dumps({"files": {name: {} for name in files}})


def run(folder: Path, inside: str) -> subprocess.CompletedProcess[str]:
    code = (
        "import os, signal, sys; from pathlib import Path; from probedesign.cad.folder import staged\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # ignored in a shell's background
        "with staged(Path(sys.argv[1])) as staging:\n"
        "    (staging / 'probe.stl').write_text('half'); " + inside
    )
    return subprocess.run([sys.executable, "-c", code, str(folder)], capture_output=True, text=True)


@posix
@pytest.mark.parametrize("older", [{}, {"probe.stl": "old", "manifest.json": manifest("probe.stl")}])
def test_a_killed_process_leaves_the_older_export_and_a_hidden_folder(tmp_path: Path, older: dict[str, str]) -> None:
    folder = tmp_path / "large"
    if older:
        folder.mkdir()
    for name, text in older.items():
        write(folder, name, text)
    killed = run(folder, "os.kill(os.getpid(), signal.SIGKILL)")
    assert killed.returncode == -signal.SIGKILL
    (left,) = [path for path in tmp_path.iterdir() if path != folder]
    assert left.name.startswith(".large.") and left.name.endswith(".partial")
    assert {path.name: path.read_text() for path in folder.glob("*")} == older


@posix
def test_an_interrupted_process_leaves_the_older_export_alone(tmp_path: Path) -> None:
    folder = tmp_path / "large"
    folder.mkdir()
    write(folder, "manifest.json", "old")
    interrupted = run(folder, "signal.raise_signal(signal.SIGINT)")
    assert "KeyboardInterrupt" in interrupted.stderr
    assert list(tmp_path.rglob("*")) == [folder, folder / "manifest.json"]
    assert (folder / "manifest.json").read_text() == "old"


@posix
def test_a_running_export_is_not_removed(tmp_path: Path) -> None:
    folder = tmp_path / "large"
    with staged(folder) as first:
        write(first, "manifest.json", "first")
        second = run(folder, "(staging / 'manifest.json').write_text('second')")
        assert second.returncode == 0, second.stderr
        assert first.is_dir()
        assert {p.name for p in folder.iterdir()} == {"manifest.json", "probe.stl"}
    assert (folder / "manifest.json").read_text() == "first"  # the last to finish


@posix
def test_ctrl_c_is_deferred_until_the_last_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "large"
    folder.mkdir()
    write(folder, "a", "old")
    move = Path.replace

    def interrupted(path: Path, target: Path) -> Path:
        signal.raise_signal(signal.SIGINT)
        return move(path, target)

    monkeypatch.setattr(Path, "replace", interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in a shell's background
    try:
        with pytest.raises(KeyboardInterrupt), staged(folder) as staging:
            for name in ("a", "b", "manifest.json"):
                write(staging, name)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert {p.name: p.read_text() for p in folder.iterdir()} == dict.fromkeys(("a", "b", "manifest.json"), "new")


def test_outdated_files_are_removed_and_others_kept(tmp_path: Path) -> None:
    folder = tmp_path / "large"
    folder.mkdir()
    write(tmp_path, "mine", "keep")
    for name in ("old.stl", "large.probe.json"):
        write(folder, name, "old")
    write(folder, "manifest.json", manifest("old.stl", "../mine"))
    with staged(folder) as staging:
        write(staging, "manifest.json", manifest())
    assert {p.name for p in folder.iterdir()} == {"large.probe.json", "manifest.json"}
    assert (tmp_path / "mine").read_text() == "keep"  # a manifest names files of its own folder only


@pytest.mark.parametrize("nonsense", ["", "[]", '{"files": 3}', "\x00"])
def test_an_unreadable_manifest_is_ignored(tmp_path: Path, nonsense: str) -> None:
    folder = tmp_path / "large"
    folder.mkdir()
    write(folder, "manifest.json", nonsense)
    with staged(folder) as staging:
        write(staging, "manifest.json", manifest())
    assert (folder / "manifest.json").read_text() == manifest()


def test_a_full_disk_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot be written: No space left on device$"), staged(tmp_path / "large"):
        raise OSError(28, "No space left on device")
    assert list(tmp_path.iterdir()) == []
