"""The docs are correct: commands and examples run, examples print the values in their comments, links resolve."""

import html
import json
import re
import runpy
import shlex
import shutil
import tomllib
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

import probedesign
from probedesign.cli.main import run
from probedesign.simulation import scenes, simulated_run

ROOT = Path(__file__).parent.parent
#: Pages whose examples follow from each other and print values.
WITH_VALUES = ("mechanics", "estimation", "prediction", "stereo")


def blocks_of(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize("page", WITH_VALUES)
def test_the_examples_print_the_values_in_their_comments(page, monkeypatch):
    monkeypatch.chdir(ROOT)
    code = "".join(blocks_of(ROOT / f"docs/{page}.md", "python"))
    expected = re.findall(r"^print\(.*\) +# (.*)$", code, re.MULTILINE)
    assert len(expected) == code.count("print(") > 1
    printed, names = StringIO(), dict[str, Any]()
    with redirect_stdout(printed):
        exec(code, names)
    assert printed.getvalue().splitlines() == expected


def steps_of(page: Path) -> list[list[str] | str]:
    found: list[list[str] | str] = []
    for language, block in re.findall(r"```(sh|python)\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
        if language == "sh":
            lines = [shlex.split(line, comments=True) for line in block.replace("\\\n", " ").splitlines()]
            found += [words[1:] for words in lines if words and words[0] == "probedesign"]
        elif page.stem not in WITH_VALUES:
            found.append(block)
    return found


ALL_PAGES = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
PAGES = sorted(page for page in ALL_PAGES if steps_of(page))
SLOW = {"choosing", "curved"}  #: Pages whose commands take minutes: searches and Monte Carlo checks.


#: Every twelfth touch of the card house that `explore --rehearse` simulates.
TOUCHES = scenes.touch_targets()[::12]


@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=[pytest.mark.slow] * (page.stem in SLOW), id=page.stem) for page in PAGES]
)
def test_the_commands_of_a_page_run_in_order(page, tmp_path, monkeypatch, capsys):
    """In a folder with nothing but the designs of the project; its examples of Python run between them.

    Of an export one part is enough: tests/cad examines whole ones.
    """
    pytest.importorskip("cadquery")
    shutil.copytree(ROOT / "designs", tmp_path / "designs")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(scenes, "touch_targets", lambda *_: TOUCHES)
    monkeypatch.setattr(simulated_run, "SAMPLE_RATE", 437.5)  # an eighth of the samples of simulated runs
    results = []
    for step in steps_of(page):
        if isinstance(step, list):
            status = run([*step, "--only", "probe"] if step[0] == "export" else step)
            assert status == 0, f"probedesign {shlex.join(step)}: {capsys.readouterr().err}"
            continue
        names = dict[str, Any]()
        exec(step, names)
        results += [value.result for value in names.values() if isinstance(getattr(value, "result", None), str)]
    assert set(results) <= {"ok"}
    if page.stem in ("README", "tutorial"):
        assert results


@pytest.mark.parametrize("page", ALL_PAGES, ids=lambda page: page.stem)
def test_files_in_a_page_can_be_parsed(page):
    for text in blocks_of(page, "toml"):
        tomllib.loads(text)
    for text in blocks_of(page, "json"):
        json.loads(text)


DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


@pytest.mark.parametrize("page", DOCUMENTS, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_to_a_file_and_a_heading(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)|(?:src|href)=\"([^\"]+)\"", text):
        link = "".join(target)
        if link.startswith(("http://", "https://", "mailto:")):
            continue
        name, _, anchor = link.partition("#")
        file = (page.parent / name).resolve() if name else page
        assert file.exists(), f"{page.name}: {link}"
        if anchor and file.suffix == ".md":
            assert anchor in anchors(file.read_text(encoding="utf-8")), f"{page.name}: {link}"


def anchors(text: str) -> set[str]:
    """Return the anchors of a page: those that it names, and those that its headings get on GitHub and on the site."""
    headings = re.findall(r"^#+ +(.*)$", text, re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings]
    return {*re.findall(r"<a id=\"([^\"]+)\"", text), *plain}


def test_the_site_lists_every_page_and_every_public_name():
    """`sphinx-build -W` refuses a page that no table of contents lists; this needs no Sphinx."""
    index = (ROOT / "docs/index.md").read_text(encoding="utf-8")
    for page in (ROOT / "docs").glob("*.md"):
        listed = re.search(rf"^(.* <)?{page.stem}>?$", index, re.MULTILINE)
        assert page.stem in ("README", "index", "paper") or listed, page.name
    documented = re.findall(r"auto(?:class|function|exception):: (\w+)", (ROOT / "docs/api.md").read_text())
    assert sorted(documented) == sorted(probedesign.__all__)


@pytest.mark.parametrize("script", sorted((ROOT / "docs/gallery").glob("plot_*.py")), ids=lambda path: path.stem)
def test_an_example_of_the_gallery_draws_one_picture_with_named_axes(script, monkeypatch):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    monkeypatch.setattr(pyplot, "show", lambda: None)
    pyplot.close("all")
    runpy.run_path(str(script))
    (axes,) = pyplot.gcf().axes
    assert axes.get_title() or axes.get_xlabel()  # a polar chart has a title
    assert axes.lines or axes.patches
    pyplot.close("all")


@pytest.mark.slow
def test_the_site_is_built_without_warnings(tmp_path):
    build = pytest.importorskip("sphinx.cmd.build")
    assert build.main(["-q", "-W", str(ROOT / "docs"), str(tmp_path)]) == 0
    for page in (ROOT / "docs").glob("*.md"):
        if page.stem not in ("README", "paper"):
            title = page.read_text(encoding="utf-8").splitlines()[0].removeprefix("# ").replace("`", "")
            built = (tmp_path / f"{page.stem}.html").read_text(encoding="utf-8")
            heading = re.search(r"<h1>(.*?)<a ", built, re.DOTALL)
            assert heading and html.unescape(re.sub(r"<[^>]*>", "", heading[1])) == title
