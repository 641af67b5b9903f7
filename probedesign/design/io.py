"""Read, draft, render and write design files: checked designs as commented TOML."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from probedesign.core.csv_tables import read_text
from probedesign.core.errors import CheckFailedError, InputError, quoted, unknown_name
from probedesign.core.files import MAX_TOML, check_regular, write_atomically
from probedesign.core.units import MPA
from probedesign.design.catalog import CUSTOM, OBJECT_COMPLIANCE, PROBES, RESINS, Quantity, Resin, find, paper_tables
from probedesign.design.diagnostics import Table, check_toml, parse_toml, read_toml
from probedesign.design.schema import AXIS_KEYS, AXIS_KINDS, Design, PrinterRecord, ResinRecord
from probedesign.design.sensor_catalog import FILES, SENSORS, SensorRecord, load_sensor
from probedesign.design.sensors import SensorModel

COMMENT_COLUMN = 36
#: Default tip: a sixth of the base, as of the large probe of the paper. Elastic 50A requires features of 1.5 mm; 2 mm
#: leaves a margin for thin prints (assumed).
TIP_RATIO, MIN_TIP_D_MM = 6.0, 2.0
#: Gravity in base axes [m/s²] by where a mounted probe points.
POINTS = {"down": (0.0, 0.0, 9.81), "up": (0.0, 0.0, -9.81), "sideways": (9.81, 0.0, 0.0)}

#: Comment beside a key, unless the notes of the design replace it.
COMMENTS = {
    "date": "of the design, on its sheets",
    "owner": "of the design, on its sheets",
    "probe.shape": "cone | cylinder | profile",
    "probe.length_mm": "of the flexible part, base to tip",
    "probe.profile_mm": 's, diameter; only for shape = "profile"',
    "probe.tip": "blunt | rounded: a round end within the same length",
    "probe.section": "round | hollow | elliptic",
    "probe.bore_ratio": "inner over outer diameter, all along",
    "probe.flatness": "diameter along y over that along x; the diameters here are along x",
    "probe.base_fillet_mm": "radius of the fillet at s = 0, between flank and flange",
    "probe.assumed": "dimensions that nobody has confirmed; every report names them",
    "probe.axis": f"{' | '.join(AXIS_KINDS)}; length_mm is measured along it",
    **{f"probe.{key}": axis.comment for key, axis in AXIS_KEYS.items()},
    "probe.bow_mm": "deviation of the print's tip towards x and y, lying without load: a constant curvature",
    "probe.measured": "measured on the print; diameters and bow in [tolerances] go with them",
    "material.resin": "fills what is not given here",
    "material.shear_coefficient": "of the rod's section; 1 is the paper's",
    "material.identified_tests": "fingerprints of the tests that served; validate leaves them out",
    "material.stiffness_spread": "standard deviation of a common factor on E and G, for fusing touches",
    "material.creep_spread": "standard deviation of its relaxation while touches are fused; 0 leaves creep out",
    "sensor.averaging_samples": "samples in one reading",
    "mount.gravity_base_m_s2": "in base axes: z from base to tip, x through the clocking mark",
    "contact.friction": "tangential over normal force, standard deviation of the prior",
    "contact.object_compliance_m_N": "yielding of the touched object, scale of the half-normal prior; 0 is rigid",
    "contact.object_walk_mm": "step of a loose object between two touches, standard deviation on each axis",
    "print.scale_xy": "flexible part, printed over drawn, from a coupon; files to print only",
    "print.scale_z": "printed over drawn, along its axis",
    "print.offset_xy_mm": "by how much all its diameters come out wider, beside the scale, from a coupon",
    "print.rigid_scale_xy": "rigid parts, printed over drawn",
    "mount.hold": "clamped | glued: the flange's underside as well | bonded at s = 0; the root is computed for it",
    "mount.ring_screw": "M2 | M3",
    "mount.flange_thickness_mm": "soft flange below s = 0",
    "mount.flange_lip_mm": "its radial width around the base",
    "mount.squeeze_mm": "compression of the lip; by default the least that the tolerances allow",
    "mount.root_rigid_radii": "bending that the base lacks, in base radii; 0 is the bare rod, below 0 it yields",
}

HEADER = """\
# A soft probe. Edit by hand: every load checks the file and names the line of what is wrong.
# A number's unit ends its name. Diameters are of the printed part.
"""


def default_tip_d_mm(base_d_mm: float) -> float:
    """Return the default tip diameter [mm] of a tapered probe of that base diameter [mm].

    A sixth of the base, at least 2 mm, rounded to 0.1 mm, never wider than the base.
    """
    return min(base_d_mm, round(max(base_d_mm / TIP_RATIO, MIN_TIP_D_MM), 1))


def sensor_keys(choice: str) -> dict[str, str]:
    """Return `[sensor]` for the name of a sensor, with its finest calibration, or for the name of a calibration.

    Raises:
        InputError: the name is neither; the message lists the known ones.
    """
    known = []
    for model in SENSORS.values():
        names = [calibration.name for calibration in model.calibrations]
        if choice in (model.name, *names):
            return {"model": model.name, "calibration": names[0] if choice == model.name else choice}
        known += [model.name, *names]
    raise unknown_name("sensor.calibration", choice, known)


def known_sensor(choice: str) -> SensorModel:
    """Return the known sensor of that name, or with a calibration of that name.

    Raises:
        InputError: the name is neither.
    """
    return SENSORS[sensor_keys(choice)["model"]]


def _sensor_tables(choice: str) -> dict[str, Any]:
    """Return `[sensor]` for the name of a sensor or calibration; a sensor whose holes are assumed is written out."""
    keys = sensor_keys(choice)
    if not SENSORS[keys["model"]].assumed_shape:
        return keys
    record = load_sensor(FILES / f"{keys['model']}.toml")
    return {**keys, "model": CUSTOM, "own": record.model_dump(exclude_none=True, mode="json")}


def material_keys(resin: Resin) -> dict[str, Any]:
    """Return `[material]` with the numbers of the resin written out, so that the file is complete by itself."""
    quantities = _quantities(resin)
    numbers = {key: float(f"{q.value / unit:.9g}") for key, (q, unit) in quantities.items()}
    provenance = {key: q.provenance for key, (q, _) in quantities.items()}
    return {"resin": resin.name, **numbers, "provenance": provenance}


def _quantities(resin: Resin) -> dict[str, tuple[Quantity, float]]:
    return {
        "youngs_modulus_mpa": (resin.youngs_modulus, MPA),
        "shear_modulus_mpa": (resin.shear_modulus, MPA),
        "density_kg_m3": (resin.density, 1.0),
    }


def new(
    name: str | None = None,
    *,
    length_mm: float,
    base_d_mm: float,
    tip_d_mm: float | None = None,
    tip: str = "blunt",
    shape: str = "cone",
    section: str = "round",
    bore_ratio: float | None = None,
    flatness: float | None = None,
    resin: str = "elastic-50a",
    sensor: str = "nano17",
    robot_flange: str = "iso-9409-1-50-4-m6",
    friction: float | None = None,
    hold: str = "clamped",
    points: str = "sideways",
    printer: str = "form-3",
    axis: str = "straight",
    axis_bend_deg: float | None = None,
    axis_turns: float | None = None,
    axis_azimuth_deg: float | None = None,
) -> Design:
    """Return a new design from a few dimensions, as `probedesign new` writes it, with defaults for everything else.

    Args:
        name: of the design; None for one that contains the parameters, such as `cylinder-80x6-hollow-0.5`.
        length_mm, base_d_mm, tip, shape, section, bore_ratio, flatness: as in `[probe]`.
        tip_d_mm: None for `default_tip_d_mm`, unless it is a cylinder.
        resin, robot_flange: names of the catalog.
        sensor: a known sensor or calibration.
        friction: tangential over normal force of a touch, standard deviation of the prior; None for the resin's.
        points: where the mounted probe points, a key of `POINTS`.
        hold, printer: as in `[mount]` and `[print]`.
        axis, axis_bend_deg, axis_turns, axis_azimuth_deg: as in `[probe]`.

    Raises:
        InputError: a value is out of range or contradicts another.
    """
    material = find(RESINS, resin, "material.resin")
    if tip_d_mm is None and shape != "cylinder":
        tip_d_mm = default_tip_d_mm(base_d_mm)
    bends = {"axis_bend_deg": axis_bend_deg, "axis_turns": axis_turns, "axis_azimuth_deg": axis_azimuth_deg}
    probe = {"shape": shape, "length_mm": length_mm, "base_d_mm": base_d_mm, "tip_d_mm": tip_d_mm, "tip": tip,
             "section": section, "bore_ratio": bore_ratio, "flatness": flatness, "axis": axis, **bends}  # fmt: skip
    if name is None:
        ratio, sizes = flatness if bore_ratio is None else bore_ratio, (length_mm, base_d_mm, tip_d_mm)
        bent = (bends.get(key) for key, of in AXIS_KEYS.items() if of.needed)
        words = [shape, "x".join(f"{size:g}" for size in sizes if size is not None)]
        words += [] if section == "round" else [section, *([] if ratio is None else [f"{ratio:g}"])]
        words += [] if tip == "blunt" else [tip]
        words += [] if axis == "straight" else [axis, *(f"{size:g}" for size in bent if size is not None)]
        name = "-".join(words).replace("+", "")
    return check_design({
        "schema": 1,
        "name": name,
        "probe": probe,
        "material": material_keys(material),
        "sensor": _sensor_tables(sensor),
        "mount": {"robot_flange": robot_flange, "hold": hold, "gravity_base_m_s2": find(POINTS, points, "points")},
        "contact": {
            "friction": material.friction.value if friction is None else friction,
            "object_compliance_m_N": OBJECT_COMPLIANCE.value,
        },
        "print": {"printer": printer},
    })  # fmt: skip


def notes_of(design: Design) -> dict[str, str]:
    """Return the comments beside the numbers of a design of `new` that state their sources, for `render_design`."""
    material, friction, probe = design.resin, design.friction.value, design.probe
    notes = {f"material.{key}": f"{q.provenance}: {q.source}" for key, (q, _) in _quantities(material).items()}
    source = material.friction.source if friction == material.friction.value else "assumed until measured"
    notes["contact.friction"] = f"{COMMENTS['contact.friction']}; {source}"
    notes["contact.object_compliance_m_N"] = (
        f"{COMMENTS['contact.object_compliance_m_N']}; {OBJECT_COMPLIANCE.provenance}: {OBJECT_COMPLIANCE.source}"
    )
    if probe.shape == "cone" and probe.tip_d_mm == default_tip_d_mm(probe.base_d_mm):
        notes["probe.tip_d_mm"] = f"by default base / {TIP_RATIO:g}, at least {MIN_TIP_D_MM:g} mm"
    if design.sensor.own is not None:
        interface = design.sensor.own.interface.model_dump(exclude_none=True)
        for name in design.sensor_model.assumed_shape:
            keys = [f"{name}.{last}" for last in interface[name]] if isinstance(interface[name], dict) else [name]
            notes |= {f"sensor.own.interface.{key}": "assumed: measure it" for key in keys}
        notes["sensor.own.assumed"] = "remove what you have measured; export needs the interface"
    return notes


def render_design(design: Design, notes: Mapping[str, str] | None = None) -> str:
    """Return the text of a design file that loads as exactly this design.

    Args:
        design: the design.
        notes: comments by `table.key`, beside the value; the one of "" is for the whole file.

    Returns:
        TOML, ending in a newline.
    """
    comments = COMMENTS | dict(notes or {})
    about = comments.get("", "").splitlines()
    lines = [HEADER + ("#\n" if about else "") + "".join(f"# {line}\n" for line in about)]
    for table, values in _tables("", design.model_dump(by_alias=True)):
        lines += [f"\n[{table}]"] if table else []
        for key, value in values.items():
            lines.append(_commented(f"{key} = {_toml(value)}", comments.get(f"{table}.{key}")))
        if table == "probe" and design.probe.profile_mm is None:
            (s0, d0), *_, (s1, d1) = design.probe.blunt_mm
            example = _toml(((s0, d0), ((s0 + s1) / 2, (d0 + d1) / 2), (s1, d1)))
            lines.append(_commented(f"# profile_mm = {example}", COMMENTS["probe.profile_mm"]))
    return "\n".join(lines) + "\n"


def _tables(name: str, values: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield a table and those in it in order, without the keys that are not set and without provenances that are those
    of a missing number; the name of an item of a list is in brackets of its own."""
    given = {key: value for key, value in values.items() if value is not None and value != ()}
    inner = {key: value for key, value in given.items() if isinstance(value, dict)}
    lists = {key: value for key, value in given.items() if isinstance(value, tuple) and isinstance(value[0], dict)}
    own = {key: value for key, value in given.items() if key not in inner and key not in lists}
    yield name, own
    for key, value in inner.items():
        if key == "provenance":
            value = {k: v for k, v in value.items() if k in own or v != "assumed"}
        if value or key != "provenance":
            yield from _tables(f"{name}.{key}".lstrip("."), value)
    for key, items in lists.items():
        yield from ((f"[{name}.{key}]", table) for item in items for _, table in _tables("", item))


def _commented(line: str, comment: str | None) -> str:
    return f"{line:<{COMMENT_COLUMN - 1}} # {comment}" if comment else line


def _toml(value: Any) -> str:
    """Return a checked value as TOML; floats read back exactly, and the text of JSON is text of TOML."""
    match value:
        case bool():
            return "true" if value else "false"
        case tuple():
            return f"[{', '.join(_toml(v) for v in value)}]"
        case str():
            return json.dumps(value)
        case _:
            return repr(value)


def write_design(text: str, path: str | Path, force: bool = False) -> None:
    """Write the text of a design file, after it was read back and compared.

    Args:
        text: of the design file.
        path: of the file; missing folders are made.
        force: replace a file that exists.

    Raises:
        InputError: the text is not a valid design, the file exists, or it cannot be written.
        CheckFailedError: the written file does not read back as the same design.
    """
    path = Path(path)
    design = parse_design(text, str(path))

    def check(written: Path) -> None:
        if load_design(written) != design:
            raise CheckFailedError(f"{path}: did not read back as it was written")

    write_atomically(path, text.encode(), replace=force, check=check)


def load_design(path: str | Path) -> Design:
    """Read and check a design file, or return a probe of the paper.

    Args:
        path: the TOML file; the name of a probe of the paper, such as "large", if there is no such file.

    Returns:
        The design.

    Raises:
        InputError: the file cannot be read, is not TOML, or has a wrong value; one line.
    """
    return parse_design(design_text(Path(path)), str(path))


def design_text(path: Path) -> str:
    """Return the text of a design file, or that of a probe of the paper; see `load_design`."""
    if path.name.endswith(".probe.json"):
        raise InputError(f"{path}: is a frozen probe; give the design file that it was deployed from")
    if str(path) in PROBES and not path.is_file():
        return render_design(check_design(paper_tables(str(path))))
    return read_text(path, "design file", MAX_TOML, kind="TOML", remedy="make one with: probedesign new")


def parse_design(text: str, where: str = "design") -> Design:
    """Parse and check the text of a design file; `where` names it in errors.

    Raises:
        InputError: one line naming the key, the value, the remedy and the line.
    """
    return check_design(read_toml(text, Design, where), text, where)


def check_design(data: dict[str, Any], text: str = "", where: str = "") -> Design:
    """Check the tables of a design file and return the design.

    A sensor file that they name is read and becomes `[sensor.own]`, so that the design is complete by itself.

    Args:
        data: its tables, with the keys and units of the file.
        text: the file's text, to name the line of a wrong value; empty if there is no file.
        where: names the file in errors; empty if there is none.

    Returns:
        The design.

    Raises:
        InputError: one line naming the key, the value and the remedy.
    """
    for table, (key, record) in _FILES.items():
        data = _with_file(data, where, table, key, record)
    return check_toml(data, Design, text, where)


#: Tables whose key may be replaced by `file`, and the schema of that file.
_FILES: dict[str, tuple[str, type[Table]]] = {
    "sensor": ("model", SensorRecord), "material": ("resin", ResinRecord), "print": ("printer", PrinterRecord)
}  # fmt: skip


def _with_file(data: dict[str, Any], where: str, table: str, choice: str, record: type[Table]) -> dict[str, Any]:
    """Return the tables with `file` of one, a path relative to the design file, replaced by the content of that file.

    Raises:
        InputError: the file is wrong, or the design describes the same twice.
    """
    values = data.get(table)
    if not isinstance(values, dict) or "file" not in values:
        return data
    name, prefix = values["file"], f"{where}: " if where else ""
    if not isinstance(name, str):
        raise InputError(f"{prefix}{table}.file = {quoted(name)}: expected text in quotes")
    if twice := [key for key in (choice, "own") if key in values]:
        raise InputError(f"{prefix}{table}.{twice[0]} is not used beside {table}.file; remove one of them")
    path = Path(where).parent / name
    check_regular(path)
    described = parse_toml(read_text(path, f"{table} file", MAX_TOML, kind="TOML"), record, str(path))
    rest = {key: value for key, value in values.items() if key != "file"}
    if isinstance(described, ResinRecord):  # what is known of a resin of the catalog by its name
        rest.setdefault("stiffness_spread", described.stiffness_spread)
    return {**data, table: {**rest, choice: CUSTOM, "own": described}}
