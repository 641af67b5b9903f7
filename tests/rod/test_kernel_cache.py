"""The cache of compiled kernels: what is edited, damaged or for another processor is compiled anew.

A copy of the package's decorators gets two small kernels of its own, one of which calls the other in another file.
"""

import json
import os
import resource
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult
from numba.core.cpu import CPUTargetOptions
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from packaging.requirements import Requirement

from probedesign.rod.kernels import cache, inner, kernel

INNER = "from probedesign.rod.kernels import inner\nFACTOR = 2.0\n\n@inner\ndef scaled(x):\n    return FACTOR * x\n"
OUTER = (
    "from probedesign.rod.kernels import kernel\nfrom probedesign.rod.kernels.one import scaled\n\n"
    "@kernel\ndef answer(x):\n    return scaled(x) + 1.0\n"
)
RUN = """
import json
from probedesign.rod.kernels.two import answer
print(json.dumps([answer(10.0), answer(11.0), sum(answer.stats.cache_hits.values())]))
"""
COMPILED, LOADED = 0, 1


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return a folder with a package of the same name."""
    root = tmp_path / "root"
    for name in ("core", "rod/kernels"):
        (root / "probedesign" / name).mkdir(parents=True)
    for name in ("", "core", "rod"):
        (root / "probedesign" / name / "__init__.py").write_text("")
    for name in ("core/files.py", "core/errors.py", "rod/kernels/__init__.py", "rod/kernels/cache.py"):
        shutil.copy(cache.PACKAGE / name, root / "probedesign" / name)
    (root / "probedesign/rod/kernels/one.py").write_text(INNER)
    (root / "probedesign/rod/kernels/two.py").write_text(OUTER)
    return root


def start(package: Path, **environment: str) -> "subprocess.Popen[str]":
    clean = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    # Python itself decides by the time of a file whether its bytecode is old, so none is written.
    own = {"PYTHONPATH": str(package), "PYTHONDONTWRITEBYTECODE": "1", "XDG_CACHE_HOME": str(package / "home")}
    return subprocess.Popen([sys.executable, "-c", RUN], env=clean | own | environment, text=True, cwd=package,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE)  # fmt: skip


def finish(process: "subprocess.Popen[str]") -> tuple[list[float], str]:
    out, err = process.communicate()
    assert process.returncode == 0, err
    return json.loads(out), err


def run(package: Path, **environment: str) -> tuple[list[float], str]:
    return finish(start(package, **environment))


def edit(package: Path, old: str, new: str) -> None:
    """Edit the file of the called kernel; its size and times stay as they are."""
    file = package / "probedesign/rod/kernels/one.py"
    before = file.stat()
    file.write_text(file.read_text().replace(old, new))
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert file.stat().st_size == before.st_size


def test_an_edited_kernel_is_compiled_anew_wherever_it_is_called(package):
    assert run(package) == ([21.0, 23.0, COMPILED], "")
    assert run(package) == ([21.0, 23.0, LOADED], "")
    edit(package, "FACTOR = 2.0", "FACTOR = 5.0")
    assert run(package) == ([51.0, 56.0, COMPILED], "")
    assert len(list(package.glob("probedesign/_compiled/*/*.kernel"))) == 2  # former versions are removed


def _scaled(x):
    return 2.0 * x


def use() -> list[float]:
    """Return two values of a kernel that this process has not compiled or loaded yet, and whether it was loaded."""
    scaled = inner(_scaled)

    def answer(x):
        return scaled(x) + 1.0

    dispatcher = kernel(answer)
    return [dispatcher(10.0), dispatcher(11.0), sum(dispatcher.stats.cache_hits.values())]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return the one folder where kernels are searched and saved."""
    monkeypatch.setattr(cache, "only", tmp_path / "kernels")
    monkeypatch.setattr(cache, "_warned", [])
    cache.writable_folder.cache_clear()
    yield tmp_path / "kernels"
    cache.writable_folder.cache_clear()


def test_a_damaged_file_is_compiled_anew(folder, capsys):
    assert use() == [21.0, 23.0, COMPILED]
    for damage in (lambda content: content[:-1], lambda content: content[:200] + b"\0" + content[201:], lambda _: b""):
        files = list(folder.glob("*/*.kernel"))
        assert len(files) == 2
        for file in files:
            file.write_bytes(damage(file.read_bytes()))
        assert use() == [21.0, 23.0, COMPILED]
    assert use() == [21.0, 23.0, LOADED]
    assert capsys.readouterr().err == ""


def test_without_a_folder_to_write_it_compiles_and_prints_one_line(folder, capsys, monkeypatch):
    folder.write_text("in the way")
    monkeypatch.setattr(cache, "only", None)
    monkeypatch.setattr(cache, "BUILT", folder)
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(folder))
    for _ in range(2):
        cache._warned.clear()  # as in another process
        assert use() == use() == [21.0, 23.0, COMPILED]
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and "NUMBA_CACHE_DIR" in err


def test_a_full_disk_leaves_no_file_and_prints_one_line(folder, capsys):
    cache.writable_folder()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, limits[1]))  # no file may have a byte
    try:
        assert use() == [21.0, 23.0, COMPILED]
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "NUMBA_CACHE_DIR" in err
    assert not list(folder.glob("*/*.kernel"))
    cache._warned.clear()
    assert use() == [21.0, 23.0, COMPILED]
    assert capsys.readouterr().err == ""


@pytest.mark.skipif(cache.BASELINE not in cache.runs(), reason="this processor lacks the baseline's instructions")
def test_code_is_used_only_where_the_processor_runs_it(package):
    run(package, NUMBA_CPU_NAME=cache.BASELINE, NUMBA_CPU_FEATURES="")
    assert run(package)[0][-1] == LOADED  # built for the baseline, which this processor has
    assert run(package, NUMBA_ENABLE_AVX="0")[0] == [21.0, 23.0, COMPILED]  # a processor without AVX


def test_processes_at_once_compile_a_kernel_once(package):
    processes = [start(package) for _ in range(2)]
    found = [finish(process)[0] for process in processes]
    assert sorted(values[-1] for values in found) == [COMPILED, LOADED]


def test_the_digest_of_every_kernel_is_that_of_another_process():
    """An address or the order of a set in it would make every process compile."""
    code = (
        "from probedesign.rod.kernels.cache import content_digest as digest;"
        "from probedesign.estimation import fusion_kernel, detector, multistart;"
        "from probedesign.rod.kernels import newton;"
        "kernels = [k for m in (fusion_kernel, detector, multistart, newton) for k in vars(m).values()];"
        "digests = [digest(k) for k in kernels if hasattr(k, 'py_func')]"
    )
    here: dict[str, list[str]] = {}
    exec(code, here)
    there = subprocess.check_output([sys.executable, "-c", code + "; print(digests)"], text=True,
                                    env=os.environ | {"PYTHONHASHSEED": "1"})  # fmt: skip
    assert here["digests"] and there.strip() == str(here["digests"])


@pytest.mark.slow
def test_a_process_that_compiles_computes_the_bits_of_one_that_loads(tmp_path):
    """Each kernel has its own copies of what it calls, so results do not depend on what was compiled before it."""
    code = (
        "import pathlib, sys, probedesign; from probedesign import precompile;"
        "precompile.cache.only = pathlib.Path(sys.argv[1]);"  # so that the first one compiles all of it
        "probe = probedesign.build_probe(probedesign.parse_design(precompile.DESIGN));"
        "eq = probe.solve(gravity_base=(9.81, 0.0, 0.0), s_contact=0.1, force_base=(0.01, 0.002, 0.0));"
        "c = probe.estimator().estimate(eq.wrench_base);"
        "print(*(x.tobytes().hex() for x in (eq.p_base, eq.R_at(0.05), c.force_base, c.cov_surface_base)))"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    first, second = (subprocess.check_output(command, cwd=cache.PACKAGE.parent) for _ in range(2))
    assert first == second


@kernel
def _allocates(x):
    copied = np.empty(2)
    copied[:] = x
    return copied[0]


def test_numba_has_the_private_names_that_the_kernels_replace():
    """If this fails, numba changed what `cache` replaces: adapt it, or keep the bound of numba in pyproject.toml."""
    for name in ("_optimize_final_module", "_finalize_final_module", "_finalize_dynamic_globals",
                 "_get_module_for_linking", "get_pointer_to_function", "serialize_using_object_code"):  # fmt: skip
        assert hasattr(JITCodeLibrary, name), name
    assert hasattr(CPUTargetOptions, "_nrt") and hasattr(Dispatcher, "get_call_template")
    assert hasattr(Compiler, "define_pipelines")
    assert hasattr(CompileResult, "_reduce") and hasattr(CompileResult, "_rebuild")
    assert hasattr(CompileResult, "_find_referenced_environments")


def test_numba_is_bounded_to_the_minor_versions_with_those_names():
    project = tomllib.loads((cache.PACKAGE.parent / "pyproject.toml").read_text())["project"]
    (bound,) = (Requirement(text).specifier for text in project["dependencies"] if text.startswith("numba"))
    assert numba.__version__ in bound and "1.0" not in bound


def test_a_kernel_that_allocates_memory_does_not_compile():
    for _ in range(2):  # the first attempt leaves no lock behind
        with pytest.raises(NumbaError):
            _allocates(np.zeros(2))
