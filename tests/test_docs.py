"""The examples of the docs print the values in their comments."""

import re
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize("page", ["mechanics", "estimation", "prediction", "stereo"])
def test_the_examples_print_the_values_in_their_comments(page, monkeypatch):
    monkeypatch.chdir(ROOT)
    text = (ROOT / f"docs/{page}.md").read_text(encoding="utf-8")
    code = "".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL))
    expected = re.findall(r"^print\(.*\) +# (.*)$", code, re.MULTILINE)
    assert len(expected) == code.count("print(") > 1
    printed, names = StringIO(), dict[str, Any]()
    with redirect_stdout(printed):
        exec(code, names)
    assert printed.getvalue().splitlines() == expected
