"""`probedesign check`: the print check of a design."""

from typing import TYPE_CHECKING

from probedesign.cli.console import plural, print_json
from probedesign.cli.options import DesignFile, JsonOutput

if TYPE_CHECKING:
    from probedesign.printing.check import PrintCheck


def check(design: DesignFile, /, *, as_json: JsonOutput = False) -> int:
    """Check a design against the rules of its printer and its resins, before any CAD.

    Exit status 1 if a rule finds an error; warnings do not change it. The rules, their sources and their confidence:
    docs/printing.md.

    Args:
        design: the design file, or its name.
        as_json: print one JSON document.
    """
    from probedesign import pipeline
    from probedesign.design import load_design
    from probedesign.mount import root_contradiction

    checked = load_design(design)
    found, root = pipeline.check(checked), root_contradiction(checked)
    if as_json:
        passed = [finding.as_record() for finding in found.passed]
        record = {"name": found.name, "fingerprint": found.fingerprint, **found.as_record(), "passed": passed}
        print_json(record | {"root_warning": root or None})
    else:
        _print_check(found)
        if root:
            print(f"\nwarning: {root}")
    return 1 if found.errors else 0


def _print_check(found: "PrintCheck") -> None:
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
