"""`probedesign check`: check whether a design can be printed."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from probedesign.cli.console import plural, print_json

if TYPE_CHECKING:
    from probedesign.printing.check import PrintCheck


def check(design: Path, /, *, as_json: Annotated[bool, Parameter(name="--json")] = False) -> int:
    """Check a design against the rules of its printer and its resins, before any CAD.

    Exit status 1 if a rule finds an error; warnings do not change it. The rules, their sources and their confidence:
    docs/printing.md.

    Args:
        design: the design file.
        as_json: print one JSON document.
    """
    from probedesign import pipeline
    from probedesign.design import load_design

    found = pipeline.check(load_design(design))
    if as_json:
        passed = [finding.as_record() for finding in found.passed]
        print_json(
            {"name": found.name, "fingerprint": found.fingerprint, **found.as_record(), "passed": passed}
        )
    else:
        _print(found)
    return 1 if found.errors else 0


def _print(found: "PrintCheck") -> None:
    print(f"{found.name}  geometry {found.fingerprint}  {found.resin} on a {found.printer}")
    for finding in (*found.errors, *found.warnings):
        print(f"  {finding.severity:<7}  {finding.message}")
        print(f"           {finding.rule}, {finding.confidence} confidence: {finding.source}")
    print(
        f"{plural(len(found.errors), 'error')}, {plural(len(found.warnings), 'warning')}; "
        f"{len(found.passed)} of {len(found.findings)} checks passed"
    )
    print("\nadvice for printing")
    for advice in found.advice:
        print(f"  {advice}")
