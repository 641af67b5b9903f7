"""The print check of a design: every rule, on every part, before anything is drawn."""

from dataclasses import dataclass
from typing import Any

from probedesign.design import Design
from probedesign.errors import InputError
from probedesign.geometry import ProbeGeometry, build_geometry
from probedesign.mount import FlangeAdapter, SensorAdapter, flange_adapter_for, sensor_adapter_for
from probedesign.printing import limits
from probedesign.printing.compensation import scale_of
from probedesign.printing.mount_rules import mount_findings
from probedesign.printing.probe_rules import flange_findings, probe_findings
from probedesign.printing.rule import Finding
from probedesign.printing.volume_rules import part_fits, probe_fits
from probedesign.units import MM

CURE = {"elastic-50a": "wash 20 min, cure 20 min at 60 °C (Formlabs, Elastic 50A)"}


@dataclass(frozen=True)
class PrintCheck:
    """What the rules say of a design.

    Attributes:
        name: of the design.
        fingerprint: of its geometry.
        printer, resin: that the rules were taken for.
        findings: one a rule and place, those that are ok too.
        advice: what no rule can measure.
    """

    name: str
    fingerprint: str
    printer: str
    resin: str
    findings: tuple[Finding, ...]
    advice: tuple[str, ...]

    @property
    def errors(self) -> list[Finding]:
        """What is not to be expected to print."""
        return [f for f in self.findings if f.severity == "error"]

    @property
    def warnings(self) -> list[Finding]:
        """What may fail or come out badly."""
        return [f for f in self.findings if f.severity == "warning"]

    @property
    def passed(self) -> list[Finding]:
        """What keeps its rule."""
        return [f for f in self.findings if f.severity == "ok"]

    @property
    def fits(self) -> bool:
        """Whether the flexible part stands in the printer."""
        return not any(f.rule == limits.BUILD_VOLUME.name and f.part == "probe" for f in self.errors)

    def as_record(self) -> dict[str, Any]:
        """For JSON and the manifest, without what passed."""
        return {
            "ok": not self.errors,
            "printer": self.printer,
            "resin": self.resin,
            "layer_mm": limits.LAYER,
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
        findings.append(limits.MOUNT.impossible("clamp_ring", str(error)))
    else:
        findings += [*flange_findings(adapter), *mount_findings(adapter, plate)]
        findings += _rigid_sizes(design, adapter, plate)
    return PrintCheck(
        design.name, geometry.fingerprint, design.printer.name, design.resin.name, tuple(findings), _advice(design)
    )  # fmt: skip


def _probe_size(design: Design, geometry: ProbeGeometry) -> list[Finding]:
    sx, _, sz = scale_of(design, "probe")
    width = max(geometry.flange.diameter, 2.0 * float(geometry.radius.max()))
    below, length = geometry.flange.thickness / MM, geometry.length / MM
    return probe_fits(design.printer, sx * width / MM, below, length, sz)


def _rigid_sizes(design: Design, a: SensorAdapter, plate: FlangeAdapter) -> list[Finding]:
    sx, _, sz = scale_of(design, "rigid parts")
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
    cure = CURE.get(design.resin.name, "wash and cure as the resin's data sheet says")
    return (
        f"print it standing on its flange, {limits.LAYER:g} mm layers, supports below the flange only",
        cure,
        "cure it hanging or in a V-groove: lying down, its own weight would cure in as a bend",
        "measure its diameters when cured: they decide its stiffness",
    )
