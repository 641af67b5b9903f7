"""The structure of the code: its size, circles of imports, and how many attributes the methods of a class change."""

import ast
import graphlib
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[1]
SIZES: dict[str, list[int]] = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["probedesign"]["size"]


def _files(folder: str) -> list[Path]:
    """Return the Python files of a folder that git tracks or would track."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", f"{folder}/*.py"]
    names = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\n")
    return [ROOT / name for name in names if name and (ROOT / name).exists()]


@pytest.mark.parametrize("name", SIZES)
def test_a_package_keeps_its_budget_of_lines_and_modules(name):
    # A larger number in pyproject.toml needs a line in CHANGELOG.md that says why.
    files = [file for file in _files(name) if name != "probedesign" or file.parent == ROOT / name]
    lines = sum(file.read_bytes().count(b"\n") for file in files)
    assert lines <= SIZES[name][0]
    assert len(files) <= SIZES[name][1]


def test_every_package_and_nothing_else_has_a_budget():
    folders = {"/".join(file.relative_to(ROOT).parts[:2]) for file in _files("probedesign/*")}
    assert folders | {"probedesign", "tests", "benchmarks"} == set(SIZES)


def test_no_module_imports_itself_through_others_typing_and_functions_included():
    graph = grimp.build_graph("probedesign", cache_dir=None, exclude_type_checking_imports=False)
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    graphlib.TopologicalSorter(imports).prepare()  # a CycleError names the circle


def _changed_attributes(class_: ast.ClassDef) -> Iterator[str]:
    """Yield the attributes of an instance that methods other than its constructor assign."""
    for method in class_.body:
        if isinstance(method, ast.FunctionDef | ast.AsyncFunctionDef) and method.name != "__init__":
            for node in ast.walk(method):
                if (
                    isinstance(node, ast.Attribute)
                    and isinstance(node.ctx, ast.Store)
                    and ast.unparse(node.value) == "self"
                ):
                    yield node.attr


def test_methods_change_at_most_15_attributes_of_a_class():
    for file in _files("probedesign"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ClassDef):
                changed = set(_changed_attributes(node))
                assert len(changed) <= 15, f"{file.name}: {node.name} changes {len(changed)} attributes"
