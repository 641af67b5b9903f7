"""`probedesign check`: will it print?"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from probedesign.cli.console import counted, print_json

if TYPE_CHECKING:
    from probedesign.printing.check import PrintCheck
    from probedesign.printing.rules import Finding


def check(design: Path, /, *, as_json: Annotated[bool, Parameter(name="--json")] = False) -> int:
    """Check a design against the rules of its printer and its resins, before anything is drawn.

    Exit status 1 if there is an error; warnings are shown and pass. What the rules are and how sure: docs/printing.md.

    Args:
        design: the design file.
        as_json: print one JSON document.
    """
    from probedesign import pipeline

    found = pipeline.check(design)
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
        _print_finding(finding)
    print(
        f"{counted(len(found.errors), 'error')}, {counted(len(found.warnings), 'warning')}; "
        f"{len(found.passed)} of {len(found.findings)} checks pass"
    )
    print("\nwhen you print it")
    for advice in found.advice:
        print(f"  {advice}")


def _print_finding(finding: "Finding") -> None:
    print(f"  {finding.severity:<7}  {finding.message}")
    print(f"           {finding.rule}, {finding.confidence} confidence: {finding.source}")
