"""The examples of the docs print what stands beside them."""

import re
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

MECHANICS = Path(__file__).parent.parent / "docs/mechanics.md"


def test_the_examples_of_the_mechanics_print_what_they_say():
    code = "".join(re.findall(r"```python\n(.*?)```", MECHANICS.read_text(encoding="utf-8"), re.DOTALL))
    said = re.findall(r"^print\(.*?\)  +# (.*)$", code, re.MULTILINE)
    assert len(said) == code.count("print(") > 10
    printed, names = StringIO(), dict[str, Any]()
    with redirect_stdout(printed):
        exec(code, names)
    assert printed.getvalue().splitlines() == said
