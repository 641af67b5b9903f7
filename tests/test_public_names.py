"""A public name of a module has a caller outside its definition, or a page of the documentation that names it."""

import ast
import re
import subprocess
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MANY = 20  #: More often than a definition names itself.


def listed(*patterns):
    done = subprocess.run(["git", "ls-files", *patterns], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        pytest.skip("not a git checkout")
    return [ROOT / line for line in done.stdout.split() if (ROOT / line).is_file()]


def names_in(tree):
    found = Counter()
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.alias(name=name):
                found[name] += 1
            case ast.Constant(value=str(text)) if " " not in text:
                found.update(re.findall(r"\w+", text))
    return found


def definitions(tree):
    """Yield the public names that a module defines, each with its definition."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names = [node.name]
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
        else:
            continue
        yield from ((name, node) for name in names if not name.startswith("_"))


def test_every_public_name_is_used_or_documented():
    used, trees = Counter(), {}
    for path in listed("probedesign/*.py", "ros/*.py", "benchmarks/*.py", "examples/*.py"):
        trees[path] = ast.parse(path.read_text(encoding="utf-8"))
        used.update(names_in(trees[path]))
    documented = set()
    for path in listed("docs/*.md", "README.md", "docs/*.ipynb", "pyproject.toml"):
        documented.update(re.findall(r"\w+", path.read_text(encoding="utf-8")))
    unused = [
        f"{path.relative_to(ROOT)}: {name}"
        for path, tree in trees.items()
        if ROOT / "probedesign" in path.parents
        for name, node in definitions(tree)
        if used[name] < MANY and name not in documented and used[name] <= names_in(node)[name]
    ]
    assert not unused, "\n".join(unused)
