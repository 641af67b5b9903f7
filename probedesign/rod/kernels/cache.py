"""The cache of compiled kernels: one file for each compiled function, found by the content that it was compiled from.

numba's own cache checks the file of a function, not what the function calls, and writes an index that can refer to
older code when the disk is full. Here the name of a file contains a digest of the kernel's source file and of all files
of the package that it imports, one through the other; nothing else refers to the file. An edited kernel or constant,
another numba, Python or processor therefore has another name: a compiled function is either found whole and current or
compiled anew.

Places, in the order in which they are searched:

1. the folder `NUMBA_CACHE_DIR`, if it is set;
2. `_compiled` in the installed package, which comes with a wheel;
3. a folder of the user for this installation.

What is compiled is saved in the first of them that can be written. The first process that compiles starts two
others, which compile the kernels of the estimator meanwhile.
"""

import atexit
import hashlib
import multiprocessing
import os
import pickle
import re
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
from numba.core import config
from numba.core.serialize import dumps

from probedesign.core.errors import InputError
from probedesign.core.files import write_atomically
from probedesign.rod.kernels.linked import rebuild

PACKAGE = Path(__file__).parents[2]
BUILT = PACKAGE / "_compiled"  #: Kernels that were compiled when the wheel was built.
#: Processor that a wheel is compiled for: instructions of the x86-64 processors since about 2013. Source: x86-64 psABI,
#: micro-architecture levels.
BASELINE = "x86-64-v3"
_BASELINE_FEATURES = ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")
SUFFIX = ".kernel"
_DIGEST = hashlib.sha256
_DIGEST_SIZE = 32


class KernelCache:
    """The cache of one kernel, as numba's dispatcher calls it."""

    def __init__(self, dispatcher: Any) -> None:
        function = dispatcher.py_func
        self.name = f"{function.__module__.partition('.')[2]}.{function.__name__}"
        self._dispatcher = dispatcher
        self._content = ""
        self._lock: Any = None

    @property
    def cache_path(self) -> str:
        """Return the first folder that is searched."""
        return str(folders()[0])

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return the compiled function, None if it must be compiled; wait while another process compiles it."""
        self._unlock()  # of an attempt that failed
        target.refresh()
        loaded = self._load(signature, target)
        if loaded is None:
            self._lock = _lock(self._file(signature, compiled_for()))
            if self._lock is not None:
                loaded = self._load(signature, target)
        if loaded is None:
            _progress.start(self.name)
            _compile_beside()
        else:
            self._unlock()
        return loaded

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Save a compiled function. A folder that cannot be written costs one line, and later processes their time."""
        _progress.finish()
        for environment in compiled._find_referenced_environments():
            compiled.library.codegen.set_env(environment.env_name, environment)  # of what was linked into it
        try:
            if not (compiled.lifted or compiled.library.has_dynamic_globals):
                self._save(self._file(signature, compiled_for()), dumps(compiled._reduce()))
        finally:
            if self._lock is not None:  # who waits for it finds the kernel
                Path(self._lock.name).unlink(missing_ok=True)
            self._unlock()

    def flush(self) -> None:
        """Forget nothing: a file's name states its content."""

    enable = disable = flush

    def _file(self, signature: Any, processor: str) -> Path:
        self._content = self._content or content_digest(self._dispatcher)
        types = _DIGEST(str(signature).encode()).hexdigest()
        return Path(version(processor)) / f"{self.name}-{self._content[:16]}-{types[:16]}{SUFFIX}"

    def _load(self, signature: Any, target: Any) -> Any:
        for processor in runs():
            file = self._file(signature, processor)
            for folder in folders():
                content = _read(folder / file)
                if content is not None:
                    return rebuild(target, pickle.loads(content))
        return None

    def _save(self, file: Path, content: bytes) -> None:
        folder = writable_folder()
        if folder is None:
            _warn("no folder for them can be written")
            return
        path = folder / file
        try:
            write_atomically(path, _DIGEST(content).digest() + content, durable=False)  # `_read` checks it
            for other in path.parent.glob(f"{self.name}-*{SUFFIX}"):
                if other.name.split("-")[1] != self._content[:16]:
                    other.unlink(missing_ok=True)  # of a former version of this kernel
        except (OSError, InputError) as error:
            _warn(str(error))

    def _unlock(self) -> None:
        if self._lock is not None:
            self._lock.close()
            self._lock = None


def _read(path: Path) -> bytes | None:
    """Return a file's content behind its digest, None if there is no such file or it is damaged."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    digest, content = content[:_DIGEST_SIZE], content[_DIGEST_SIZE:]
    return content if _DIGEST(content).digest() == digest else None


def _lock(file: Path) -> Any:
    """Return a locked file, which processes that compile the same function wait for; None where there are no locks.

    Callees are compiled while the lock of their caller is held. Kernels do not call each other in circles, so no two
    processes wait for each other. The system releases the lock of a process that ends.
    """
    folder = writable_folder()
    if folder is None:
        return None
    try:
        import fcntl

        path = folder / file.parent / "locks" / file.stem
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = path.open("w")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            _progress.show(f"waiting for the process that compiles {file.name.split('-')[0]}")
            fcntl.flock(lock, fcntl.LOCK_EX)
    except (ImportError, OSError):
        return None
    return lock


#: Parts of `precompile` for each of the processes that compile beside the first one, which compiles the rod.
BESIDE = ("fit", "detector"), ("columns", "touches")


@cache
def _compile_beside() -> None:
    """Compile the kernels of the estimator in processes that end with this one, while it compiles those of the rod.

    Nearly every command needs them next. What is still missing then, this process compiles.
    """
    folder = writable_folder()
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if only is not None or folder is None or cores < 2 or multiprocessing.parent_process() is not None:
        return
    path = os.pathsep.join(filter(None, (str(PACKAGE.parent), os.environ.get("PYTHONPATH"))))
    quiet = subprocess.DEVNULL
    for parts in BESIDE:
        command = [sys.executable, "-P", "-m", f"{PACKAGE.name}.precompile", str(folder), *parts]
        with suppress(OSError):
            helper = subprocess.Popen(
                command, stdin=quiet, stdout=quiet, stderr=quiet, env=os.environ | {"PYTHONPATH": path}
            )
            atexit.register(_end, helper)


def _end(process: "subprocess.Popen[bytes]") -> None:
    process.kill()
    process.wait()  # its processor time counts as that of this process


def content_digest(dispatcher: Any) -> str:
    """Return the digest of all that a kernel's machine code follows from, but types, compiler and processor."""
    options = sorted(dispatcher.targetoptions.items())
    text = f"{dispatcher.py_func.__qualname__} {options!r} {_sources_digest(dispatcher.py_func.__code__.co_filename)}"
    return _DIGEST(text.encode()).hexdigest()


#: An import of the package at the top of a file; what is imported elsewhere is no global of a kernel.
_IMPORT = re.compile(rf"^(?:from|import) ({PACKAGE.name}[\w.]*)(?: import ([\w, ]+))?", re.MULTILINE)


@cache
def _sources_digest(path: str) -> str:
    """Return the digest of a source file and of the files of the package that it imports, one through the other."""
    texts: dict[Path, str] = {}
    waiting = [Path(path)]
    while waiting:
        file = waiting.pop()
        if file in texts or not file.is_file():
            continue
        texts[file] = file.read_text(encoding="utf-8")
        for module, names in _IMPORT.findall(texts[file]):
            base = PACKAGE.parent.joinpath(*module.split("."))
            modules = (base, base / "__init__", *(base / name.strip() for name in names.split(",") if name.strip()))
            waiting += [part.with_suffix(".py") for part in modules]
    return _DIGEST("\0".join(sorted(texts.values())).encode()).hexdigest()


def version(processor: str) -> str:
    """Return the name of the folder for code of this Python, numba and LLVM for a processor."""
    python = f"py{sys.version_info[0]}{sys.version_info[1]}{getattr(sys, 'abiflags', '')}"
    triple = llvmlite.binding.get_process_triple()
    return f"{python}-numba{numba.__version__}-llvmlite{llvmlite.__version__}-{triple}-{processor}"


@cache
def compiled_for() -> str:
    """Return the processor that this process compiles for: its own, or what `NUMBA_CPU_NAME` and `_FEATURES` state."""
    name = config.CPU_NAME or llvmlite.binding.get_host_cpu_name()
    features = config.CPU_FEATURES
    if features is None:
        features = _host_features()
    return f"{name}-{_DIGEST(features.encode()).hexdigest()[:8]}" if features else str(name)


@cache
def runs() -> tuple[str, ...]:
    """Return the processors whose code may run here, the best first: a wheel's code may be built for the baseline."""
    features = _host_features().split(",")
    if all(f"+{feature}" in features for feature in _BASELINE_FEATURES):
        return (compiled_for(), BASELINE) if compiled_for() != BASELINE else (BASELINE,)
    return (compiled_for(),)


@cache
def _host_features() -> str:
    try:
        features = llvmlite.binding.get_host_cpu_features()
    except RuntimeError:  # LLVM does not know this processor
        return ""
    if not config.ENABLE_AVX:
        features.update({name: False for name in features if name.startswith("avx")})
    return str(features.flatten())


only: Path | None = None  #: The one folder that is searched and written, where kernels are compiled for others.


def folders() -> list[Path]:
    """Return the places that are searched, see the module."""
    if only is not None:
        return [only]
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    # Without a home, "~" stays and the path is relative.
    base = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    of_user = base / "probedesign" / _DIGEST(str(PACKAGE).encode()).hexdigest()[:16]
    return [*([Path(chosen)] if chosen else []), BUILT, *([of_user] if base.is_absolute() else [])]


@cache
def writable_folder() -> Path | None:
    """Return the first place that can be written, None if none can."""
    for folder in folders():
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
            return folder
    return None


_warned: list[str] = []  #: Why compiled kernels could not be saved in this process.


def _warn(reason: str) -> None:
    """Print one line, once in a process."""
    if not _warned:
        _progress.clear()
        print(
            f"warning: the compiled kernels cannot be saved ({reason}), so every process compiles them again, which "
            "takes about a minute. Set NUMBA_CACHE_DIR to a folder that can be written.",
            file=sys.stderr,
            flush=True,
        )
    _warned.append(reason)


class _Progress:
    """One line on a terminal while kernels compile, removed when they are compiled."""

    def __init__(self) -> None:
        self.depth, self.done, self.began = 0, 0, 0.0

    def start(self, name: str) -> None:
        """Show that a kernel compiles; kernels that it calls start before it finishes."""
        if self.depth == 0 and self.done == 0:
            self.began = time.perf_counter()
        self.depth += 1
        self.show(f"now {name}")

    def finish(self) -> None:
        """Count a kernel."""
        self.depth, self.done = max(self.depth - 1, 0), self.done + 1
        if self.depth == 0:
            self.clear()

    def clear(self) -> None:
        """Remove the line."""
        if sys.stderr.isatty():
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)

    def show(self, now: str) -> None:
        """Replace the line."""
        if sys.stderr.isatty():
            spent = time.perf_counter() - self.began if self.began else 0.0
            text = f"Compiling the kernels, once, about a minute: {self.done} in {spent:.0f} s, {now}"
            print(f"\r\x1b[K{text[:110]}", end="", file=sys.stderr, flush=True)


_progress = _Progress()
