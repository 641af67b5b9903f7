"""STEP file of an assembly: the same bytes for the same assembly."""

import re
import tempfile
from itertools import count
from pathlib import Path

import cadquery as cq

from probedesign.core.errors import CheckFailedError

STEP_END = b"END-ISO-10303-21;"
EPOCH = "1970-01-01T00:00:00"
"""Time in the header of every file, as ISO 10303-21 requires one."""
_HEADER_TIME = re.compile(r"'\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d'")
_OCCURRENCE = re.compile(r"(NEXT_ASSEMBLY_USAGE_OCCURRENCE\(')\d+('.*?\);)", re.DOTALL)
"""A part in its assembly, with a number that the kernel counts through all assemblies of a process."""
_LINE_BREAK = re.compile(r"\s*\n\s*")
_ENTITY = re.compile(r"^#(\d+) = (.*?);$", re.MULTILINE | re.DOTALL)
_REFERENCE = re.compile(r"#(\d+)")
_STYLES = "MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION"


def step_bytes(assembly: cq.Assembly) -> bytes:
    """Return the STEP file of an assembly.

    Raises:
        CheckFailedError: the kernel does not write the file to its end.
    """
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "assembly.step"
        assembly.export(str(path), "STEP")
        content = path.read_bytes() if path.is_file() else b""
    if not content.rstrip().endswith(STEP_END):
        raise CheckFailedError("assembly.step: the kernel did not write it to its end")
    return reproducible(content.decode("ascii")).encode("ascii")


def reproducible(text: str) -> str:
    """Return a STEP file without its time of writing, its parts counted from 1, its styles in the order of the shapes.

    The kernel writes the styles last, in the order of the addresses of the shapes in memory.
    """
    text = _HEADER_TIME.sub(f"'{EPOCH}'", text, count=1)
    numbers = count(1)
    # the number's digits decide where the kernel breaks the line
    text = _OCCURRENCE.sub(lambda m: m[1] + str(next(numbers)) + _LINE_BREAK.sub("", m[2]), text)
    first = re.search(rf"^#(\d+) = {_STYLES}", text, re.MULTILINE)
    if first is None:
        return text
    start, end, number = first.start(), text.rindex("ENDSEC;"), int(first[1])
    entities = {int(m[1]): " ".join(m[2].split()) for m in _ENTITY.finditer(text[start:end])}

    def referenced(entity: int) -> list[int]:
        return [int(r) for r in _REFERENCE.findall(entities[entity])]

    def styled_shape(root: int) -> list[int]:
        return [r for r in referenced(root) if r not in entities]

    order: dict[int, int] = {}
    stack = sorted((e for e in entities if entities[e].startswith(_STYLES)), key=styled_shape, reverse=True)
    while stack:  # depth first from each style's root
        entity = stack.pop()
        if entity not in order:
            order[entity] = number + len(order)
            stack += [r for r in reversed(referenced(entity)) if r in entities]
    if len(order) != len(entities):
        raise CheckFailedError("assembly.step: its styles have a form that is not known")

    def renumbered(entity: int) -> str:
        return _REFERENCE.sub(lambda m: f"#{order.get(int(m[1]), int(m[1]))}", entities[entity])

    lines = "".join(f"#{order[entity]} = {renumbered(entity)};\n" for entity in order)
    return text[:start] + lines + text[end:]
