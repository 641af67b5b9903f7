"""The examples of the docs print what stands beside them."""

import re
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize("page", ["mechanics", "estimation", "prediction", "stereo"])
def test_the_examples_print_what_they_say(page, monkeypatch):
    monkeypatch.chdir(ROOT)
    text = (ROOT / f"docs/{page}.md").read_text(encoding="utf-8")
    code = "".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL))
    said = re.findall(r"^print\(.*\) +# (.*)$", code, re.MULTILINE)
    assert len(said) == code.count("print(") > 1
    printed, names = StringIO(), dict[str, Any]()
    with redirect_stdout(printed):
        exec(code, names)
    assert printed.getvalue().splitlines() == said
