"""The tutorial of docs/measurements.md: its commands print the output that it shows."""

import re
import shutil
from pathlib import Path

from probedesign.campaigns import read_campaign
from probedesign.cli.main import run

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs/measurements.md").read_text(encoding="utf-8")


def test_the_run_of_the_tutorial_prints_what_the_page_says(tmp_path, monkeypatch, capsys):
    shutil.copytree(ROOT / "designs", tmp_path / "designs")
    monkeypatch.chdir(tmp_path)
    commands = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)[0].splitlines()
    for command in commands:
        assert run(command.removeprefix("probedesign ").split()) == 0
        out = capsys.readouterr().out
    expected = re.findall(r"<!-- output -->\n```\n(.*?)```", PAGE, re.DOTALL)[0]
    assert expected == out[: out.index("\nwrote")].rstrip() + "\n"


def test_the_campaign_file_of_the_page_is_one(tmp_path):
    text = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)[0]
    (tmp_path / "campaign.toml").write_text(text, encoding="utf-8")
    (tmp_path / "tests.csv").write_text("test\nhang\n")
    assert read_campaign(tmp_path).name == "large"
