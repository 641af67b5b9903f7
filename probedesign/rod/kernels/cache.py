"""How kernels are compiled, and the cache of what was compiled: one file a function, found by its content.

What only kernels call becomes LLVM code for its callers, not machine code: numba makes every compiled function ready to
be called from Python, and emits the machine code of it and of all that it calls, which LLVM does again in each caller.

numba's own cache checks the file of a function, not what the function calls. Here the name of a file contains a digest
of the kernel's source file and of all files of the package that it imports, one through the other, so a compiled
function is either found whole and current or compiled anew. Files are searched in `folders`, and saved in the first
that can be written. The first process that compiles starts two others, which compile the estimator meanwhile.

The libraries replace methods of numba that are not part of its public interface, so pyproject.toml limits numba to the
versions that have them.
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
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
from numba.core.caching import NullCache
from numba.core.codegen import JITCodeLibrary, get_host_cpu_features
from numba.core.compiler import Compiler, CompileResult, compile_result
from numba.core.registry import cpu_target
from numba.core.serialize import dumps

from probedesign.core.errors import InputError
from probedesign.core.files import write_atomically

PACKAGE = Path(__file__).parents[2]
BUILT = PACKAGE / "_compiled"  #: Kernels that were compiled when the wheel was built.
#: Processor that a wheel is compiled for: instructions of the x86-64 processors since about 2013. Source: x86-64 psABI,
#: micro-architecture levels.
BASELINE = "x86-64-v3"
_BASELINE_FEATURES = {"+avx", "+avx2", "+bmi", "+bmi2", "+f16c", "+fma", "+lzcnt", "+movbe"}
SUFFIX = ".kernel"
_DIGEST = hashlib.sha256
_DIGEST_SIZE = 32


class KernelLibrary(JITCodeLibrary):
    """Machine code of a kernel with its own copies of all that it calls.

    Of a function that several libraries define, the process uses the copy that it loaded first. The copies are rounded
    alike only if they were optimised alike, so results would depend on which kernels were compiled and which loaded.
    """

    def _optimize_final_module(self) -> None:
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name == "linkonce_odr":
                function.linkage = "internal"
        super()._optimize_final_module()


class LinkedLibrary(JITCodeLibrary):
    """LLVM code of a function and of those that it calls, to be linked into and optimised with its callers."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return zero: there is no address without machine code."""
        return 0

    @property
    def codegen(self) -> "LinkedLibrary":
        """Return what the environment of the function is given to."""
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing: an environment belongs to machine code. That of the caller gets it."""

    def serialize_using_object_code(self) -> tuple[str, str, bytes]:
        """Return what is saved."""
        return self.name, "linked", self._get_module_for_linking().as_bitcode()


class KernelCompiler(Compiler):
    """numba's compiler, into the libraries above."""

    def define_pipelines(self) -> Any:
        """Return numba's passes, which compile into the library that is there."""
        state = self.state
        library = LinkedLibrary if state.flags.no_cpython_wrapper else KernelLibrary
        state.library = library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().define_pipelines()


def _rebuild(target: Any, saved: tuple[Any, ...]) -> CompileResult:
    """Return a compiled function from what `CompileResult._reduce` returned in another process."""
    (name, kind, code), fndesc, environment, signature, objectmode, lifted, annotation, reload_init, envs = saved
    if kind != "linked":
        return CompileResult._rebuild(target, *saved)
    library = LinkedLibrary(target.codegen(), name)
    library._final_module = library._shared_module = llvmlite.binding.parse_bitcode(code)
    library._finalized = True
    return compile_result(
        target_context=target, typing_context=target.typing_context, library=library, environment=environment,
        entry_point=target.get_executable(library, fndesc, environment), fndesc=fndesc, type_annotation=annotation,
        signature=signature, objectmode=objectmode, lifted=lifted, reload_init=reload_init, referenced_envs=envs,
    )  # fmt: skip


class KernelCache(NullCache):
    """The cache of one kernel, as numba's dispatcher calls it."""

    def __init__(self, dispatcher: Any) -> None:
        function = dispatcher.py_func
        self.name = f"{function.__module__.partition('.')[2]}.{function.__name__}"
        self._dispatcher = dispatcher
        self._lock: Any = None

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return the compiled function, None if it must be compiled; wait while another process compiles it."""
        self._unlock()  # of an attempt that failed
        target.refresh()
        loaded = self._load(signature, target)
        if loaded is None:
            self._lock = _lock(self._file(signature, runs()[0]))
            loaded = self._load(signature, target) if self._lock is not None else None
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
        folder, content = writable_folder(), dumps(compiled._reduce())
        try:
            if folder is None:
                _warn("no folder for them can be written")
            else:
                path = folder / self._file(signature, runs()[0])
                write_atomically(path, _DIGEST(content).digest() + content, durable=False)  # `_load` checks it
                for other in path.parent.glob(f"{self.name}-*{SUFFIX}"):
                    if other.name.split("-")[1] != path.name.split("-")[1]:
                        other.unlink(missing_ok=True)  # of a former version of this kernel
        except (OSError, InputError) as error:
            _warn(str(error))
        finally:
            self._unlock()

    def _file(self, signature: Any, processor: str) -> Path:
        assert " at 0x" not in str(signature), f"{self.name}: no other process finds a file named by an address"
        types = _DIGEST(str(signature).encode()).hexdigest()
        return Path(version(processor)) / f"{self.name}-{content_digest(self._dispatcher)[:16]}-{types[:16]}{SUFFIX}"

    def _load(self, signature: Any, target: Any) -> Any:
        for processor in runs():
            file = self._file(signature, processor)
            for folder in folders():
                with suppress(OSError):
                    saved = (folder / file).read_bytes()
                    digest, content = saved[:_DIGEST_SIZE], saved[_DIGEST_SIZE:]
                    if _DIGEST(content).digest() == digest:  # otherwise the file is damaged
                        return _rebuild(target, pickle.loads(content))
        return None

    def _unlock(self) -> None:
        if self._lock is not None:
            Path(self._lock.name).unlink(missing_ok=True)
            self._lock.close()
            self._lock = None


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
BESIDE = ("fit",), ("touches",)


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
    for parts in BESIDE:
        command = [sys.executable, "-P", "-m", f"{PACKAGE.name}.precompile", str(folder), *parts]
        with suppress(OSError):
            helper = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                env=os.environ | {"PYTHONPATH": path},
            )  # fmt: skip
            atexit.register(helper.wait)  # last, so that its processor time counts as that of this process
            atexit.register(helper.kill)


@cache
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
def runs() -> tuple[str, ...]:
    """Return the processors whose code runs here: the one that this process compiles for, and that of a wheel."""
    _triple, name, features = cpu_target.target_context.codegen().magic_tuple()
    compiled_for = f"{name}-{_DIGEST(features.encode()).hexdigest()[:8]}" if features else str(name)
    has_baseline = set(get_host_cpu_features().split(",")) >= _BASELINE_FEATURES
    return (compiled_for, BASELINE) if has_baseline and compiled_for != BASELINE else (compiled_for,)


only: Path | None = None  #: The one folder that is searched and written, where kernels are compiled for others.


def folders() -> list[Path]:
    """Return the folders that are searched: `NUMBA_CACHE_DIR`, that of the wheel, and one of the user."""
    if only is not None:
        return [only]
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    # Without a home, "~" stays and the path is relative.
    base = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    of_user = base / "probedesign" / _DIGEST(str(PACKAGE).encode()).hexdigest()[:16]
    return [*([Path(chosen)] if chosen else []), BUILT, *([of_user] if base.is_absolute() else [])]


@cache
def writable_folder() -> Path | None:
    """Return the first folder that can be written, None if none can."""
    for folder in folders():
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
            return folder
    return None


_warned: list[str] = []  #: Why compiled kernels could not be saved in this process.


def _warn(reason: str) -> None:
    if not _warned:
        _progress.show("")
        print(
            f"warning: the compiled kernels cannot be saved ({reason}), so every process compiles them again, which "
            "takes about a minute. Set NUMBA_CACHE_DIR to a folder that can be written.",
            file=sys.stderr,
            flush=True,
        )
    _warned.append(reason)


class _Progress:
    """One line on a terminal while kernels compile, removed when they are compiled."""

    depth = compiled = 0

    def start(self, name: str) -> None:
        self.depth += 1  # kernels that it calls start before it finishes
        self.show(f"now {name}")

    def finish(self) -> None:
        self.depth, self.compiled = max(self.depth - 1, 0), self.compiled + 1
        if self.depth == 0:
            self.show("")

    def show(self, now: str) -> None:
        if sys.stderr.isatty():
            text = f"Compiling the kernels, once, about a minute: {self.compiled} done, {now}" if now else ""
            print(f"\r\x1b[K{text[:110]}", end="", file=sys.stderr, flush=True)


_progress = _Progress()
