"""Check that a design can be printed, and scale its parts for the print.

The check applies every rule to every part before anything is drawn. Scale compensation enlarges printed parts by their
shrinkage. It changes only the files to print: not the mechanics, the fingerprint, the STEP file or the check of the
drawn parts.
"""

from dataclasses import dataclass
from typing import Any

from probedesign.core.errors import InputError
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.geometry import ProbeGeometry, build_geometry
from probedesign.mount import FlangeAdapter, SensorAdapter, flange_adapter_for, sensor_adapter_for
from probedesign.printing.rules import (
    BUILD_VOLUME,
    LAYER,
    MOUNT,
    Finding,
    flange_findings,
    mount_findings,
    part_fits,
    probe_findings,
    probe_fits,
)

AS_DRAWN = (1.0, 1.0, 1.0)


def print_scale(design: Design, part: str) -> tuple[float, float, float]:
    """Return the printed size over the drawn size, along x, y and z, of a printed part."""
    return design.print_.scale if part == "probe" else design.print_.rigid_scale


def is_compensated(design: Design) -> bool:
    """Return whether any part is printed in another size than drawn."""
    return any(print_scale(design, part) != AS_DRAWN for part in ("probe", "rigid parts"))


def scale_note(design: Design, part: str) -> str:
    """Return the note for a part's file; empty if the part is printed as drawn."""
    scale = print_scale(design, part)
    return "" if scale == AS_DRAWN else f" scaled {scale[0]:g} {scale[1]:g} {scale[2]:g}"


@dataclass(frozen=True)
class PrintCheck:
    """The findings of all rules on a design.

    Attributes:
        name: of the design.
        fingerprint: of its geometry.
        printer, resin: the rules depend on.
        findings: one per rule and feature, passed ones included.
        advice: for what no rule can measure.
    """

    name: str
    fingerprint: str
    printer: str
    resin: str
    findings: tuple[Finding, ...]
    advice: tuple[str, ...]

    @property
    def errors(self) -> list[Finding]:
        """Return the findings that are not expected to print."""
        return [f for f in self.findings if f.severity == "error"]

    @property
    def warnings(self) -> list[Finding]:
        """Return the findings that may fail or print badly."""
        return [f for f in self.findings if f.severity == "warning"]

    @property
    def passed(self) -> list[Finding]:
        """Return the findings that meet their limit."""
        return [f for f in self.findings if f.severity == "ok"]

    @property
    def fits(self) -> bool:
        """Return whether the flexible part fits the printer's build volume."""
        return not any(f.rule == BUILD_VOLUME.name and f.part == "probe" for f in self.errors)

    def as_record(self) -> dict[str, Any]:
        """Return the check for JSON and the manifest, without the passed findings."""
        return {
            "ok": not self.errors,
            "printer": self.printer,
            "resin": self.resin,
            "layer_mm": LAYER,
            "errors": len(self.errors),
            "warnings": len(self.warnings),
            "findings": [f.as_record() for f in (*self.errors, *self.warnings)],
            "advice": list(self.advice),
        }


def check_print(design: Design) -> PrintCheck:
    """Check a design against the rules of its printer and of both resins."""
    geometry = build_geometry(design)
    findings = [*_probe_size(design, geometry), *probe_findings(geometry)]
    plate = flange_adapter_for(design.sensor_model, design.robot_flange)
    try:
        adapter = sensor_adapter_for(geometry, design.sensor_model)
    except InputError as error:
        findings.append(MOUNT.impossible("clamp_ring", str(error)))
    else:
        findings += [*flange_findings(adapter), *mount_findings(adapter, plate)]
        findings += _rigid_sizes(design, adapter, plate)
    return PrintCheck(
        design.name, geometry.fingerprint, design.printer.name, design.resin.name, tuple(findings), _advice(design)
    )  # fmt: skip


def _probe_size(design: Design, geometry: ProbeGeometry) -> list[Finding]:
    sx, _, sz = print_scale(design, "probe")
    width = max(geometry.flange.diameter, 2.0 * float(geometry.radius.max()))
    below, length = geometry.flange.thickness / MM, geometry.length / MM
    return probe_fits(design.printer, sx * width / MM, below, length, sz)


def _rigid_sizes(design: Design, a: SensorAdapter, plate: FlangeAdapter) -> list[Finding]:
    sx, _, sz = print_scale(design, "rigid parts")
    sizes = {
        "sensor_adapter": (a.body_d, a.body_top),
        "clamp_ring": (a.body_d, a.ring_thickness),
        "flange_adapter": (plate.plate_d, plate.pad_top + plate.robot.spigot[1]),
    }
    findings = []
    for part, (width, height) in sizes.items():
        findings += part_fits(part, design.printer, sx * width / MM, sz * height / MM)
    return findings


def _advice(design: Design) -> tuple[str, ...]:
    return (
        f"print it upright on its flange, {LAYER:g} mm layers, supports below the flange only",
        design.resin.cure,
        "cure it hanging or in a V-groove: lying flat, it would cure bent under its own weight",
        "measure its diameters after curing: they determine its stiffness",
    )
