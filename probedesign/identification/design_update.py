"""Changes of a design by measurements: values, their uncertainties and where they come from."""

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.files import backup
from probedesign.core.units import MPA
from probedesign.design import Design
from probedesign.design.edit import Change, edit_text
from probedesign.design.io import design_text, parse_design, write_design
from probedesign.identification.measured_print import axis_changes, deviation_std_mm
from probedesign.identification.parameters import PARAMETERS
from probedesign.identification.result import Identification, Identified
from probedesign.mount.mount import build_geometry, exported_root_radii

#: Parameters that a design file holds.
IN_DESIGN = {name: parameter for name, parameter in PARAMETERS.items() if parameter.design_key}
AXIS = tuple(name for name, parameter in IN_DESIGN.items() if parameter.design_key.startswith("probe."))
MATERIAL = {name: parameter for name, parameter in IN_DESIGN.items() if parameter.design_key.startswith("material.")}
#: Keys that an identification of E replaces as well, where E was not identified before.
REPLACED_WITH_E = ("material.stiffness_spread", "tolerances.youngs_modulus_by_diameter", "tolerances.root_radii")


def design_changes(fit: Identification, design: Design, day: str) -> tuple[Change, ...]:
    """Return the keys that a design gets; poses and gravity belong to the bench and not to the probe.

    The value written is conditional on the design's diameters, which the frozen probe uses too: of E and diameters it
    is E·d⁴ that was measured, and `youngs_modulus_by_diameter` states it. G and the root go with E, whether the tests
    or a prior determine them. `day` is for the comments.

    Raises:
        InputError: no number of a design was identified, or the fit is not valid.
    """
    if not fit.valid:
        why = fit.why or "the search did not converge"
        raise InputError(f"{fit.data}: {fit.result}: {why}; nothing is written")
    of_rod = IN_DESIGN.keys() - set(AXIS)
    numbers = [number for number in fit.found if number.estimated and number.name in of_rod]
    axis = _axis_changes(fit, design, day)
    if not axis and not any(number.identified for number in numbers):
        raise InputError(f"{fit.data}: no number of a design is identified; use --for {', '.join(IN_DESIGN)}")
    changes = [*axis, *(_value(number, fit, day) for number in numbers)]
    for number in numbers:
        if number.name in MATERIAL:
            provenance = '"identified"' if number.identified else '"assumed"'
            changes.append(Change("material.provenance", _split_key(number.name)[1], provenance))
    for number in numbers:
        if PARAMETERS[number.name].attribute:
            spread = number.relative_std if number.name in MATERIAL else number.std
            note = f"identified {day}, all errors of the bench included" if number.identified else number.why
            changes.append(Change("tolerances", PARAMETERS[number.name].attribute, f"{spread:.2g}", note))
    keys = [_split_key(number.name)[1] for number in numbers if number.name in MATERIAL and number.identified]
    if fit.served and keys:
        sources = design.material.provenance.model_dump()
        stay = any(sources[key] == "identified" for key in sources if key not in keys)
        served = dict.fromkeys((*(design.material.identified_tests if stay else ()), *fit.served))
        note = f"identified {day}: fingerprints of the tests that served; validate leaves them out"
        changes.append(Change("material", "identified_tests", json.dumps(list(served)), note))
    E = fit.of("E")
    if E is None:
        return tuple(changes)
    changes.append(Change("material", "stiffness_spread", f"{E.relative_std:.2g}",
                          f"identified {day}: of E, as in [tolerances], for fusing touches"))  # fmt: skip
    if E.by_diameter is not None:
        changes.append(Change("tolerances", "youngs_modulus_by_diameter", f"{E.by_diameter:.2f}",
                              f"identified {day}: E·d⁴ was measured, so E goes with the diameters"))  # fmt: skip
    return tuple(changes)


def _axis_changes(fit: Identification, design: Design, day: str) -> tuple[Change, ...]:
    """Return the changes of the axis: both directions of the bow together, and the factor on the curvature.

    Raises:
        InputError: they were fitted with an E that is exactly the design's, and that nobody identified.
    """
    of = {number.name: number for number in fit.found if number.identified and number.name in AXIS}
    if of and fit.of("E") is None and design.material.provenance.youngs_modulus_mpa != "identified":
        raise InputError(f"{fit.data}: {', '.join(of)}: fitted with exactly the E of the design, which is "
                         f"not identified; use --for E,{','.join(of)}")  # fmt: skip
    if not {"bow_x", "bow_y"} <= of.keys():
        of = {name: number for name, number in of.items() if name == "curvature"}
    factor, bow, std_mm = of.get("curvature"), None, 0.0
    if "bow_x" in of:
        i = [fit.correlated.index(name) for name in of]
        std = np.array([number.std for number in of.values()])
        std_mm = deviation_std_mm(design.probe.designed_axis, fit.correlation[np.ix_(i, i)] * np.outer(std, std))
        bow = (of["bow_x"].value, of["bow_y"].value)
    scale = None if factor is None or factor.std is None else (factor.value, factor.std)
    return axis_changes(design, bow, std_mm, scale, f"identified {day}")


def _split_key(name: str) -> tuple[str, str]:
    table, key = PARAMETERS[name].design_key.split(".")
    return table, key


def _value(number: Identified, fit: Identification, day: str) -> Change:
    tests = f"{fit.tests} test{'s' * (fit.tests != 1)}"
    start = f"identified {day}, {tests}" if number.identified else number.why
    note = f"{start}: {number.low:.4g} ... {number.high:.4g} in 95 %, with these diameters"
    return Change(*_split_key(number.name), f"{number.value:.4g}", note)


def write_changes(
    design_path: Path, changes: tuple[Change, ...], day: str, out: Path | None, force: bool
) -> tuple[Path, Path | None]:
    """Write changes into a design file, which keeps its comments, its layout and the former values.

    Args:
        design_path: the design file.
        changes: of its keys.
        day: for the comments.
        out: a file for a changed copy; None changes the design file itself.
        force: replace values that were set or identified before, or the file `out`, of which a backup is kept.

    Returns:
        The file written; the backup of `out`, if there was one.

    Raises:
        InputError: a value or file must not be replaced, or a file cannot be written.
    """
    text = design_text(design_path)
    result = edit_text(text, changes, day, str(design_path))
    if out is None:
        if not design_path.is_file():
            raise InputError(f"{design_path}: is a probe of the paper, without a file to change; give --out FILE")
        design = parse_design(text, str(design_path))
        check_overwritable(design, text, changes, str(design_path), force)
        write_design(result, design_path, force=True)
        return design_path, None
    kept = backup(out) if force else None
    write_design(result, out, force=force)
    return out, kept


def check_overwritable(design: Design, text: str, changes: tuple[Change, ...], where: str, force: bool) -> None:
    """Refuse to replace what someone set or identified before in a file's text, unless `force` is set.

    A material's value that is not identified yet is what an identification is for, and its uncertainty goes with it.
    """
    document = tomllib.loads(text)
    present = []
    for change in changes:
        value: Any = document
        for part in (*change.table.split("."), change.key):
            value = value.get(part) if isinstance(value, dict) else None
        same = value is None or value == tomllib.loads(f"v = {change.text}")["v"]
        if not same and not _replaceable(change, design):
            present.append(f"{change.table}.{change.key}")
    if present and not force:
        raise InputError(f"{where}: set or identified already: {', '.join(present)}; --force replaces these values "
                         "and keeps them as comments, or write another file with --out")  # fmt: skip


def _replaceable(change: Change, design: Design) -> bool:
    """Return whether the change is a provenance, or of a value that is not identified yet or of its uncertainty.

    Drawn dimensions are what a measurement is for.
    """
    key = f"{change.table}.{change.key}"
    if change.table in ("probe", "material.provenance") or key == "material.identified_tests":
        return True
    if change.table == "print":  # the default: no coupon was measured
        return bool(getattr(design.print_, change.key) == type(design.print_).model_fields[change.key].default)
    if key == "mount.root_rigid_radii":  # a value that is the computed one is assumed; any other was set
        computed = round(exported_root_radii(build_geometry(design), design.mount.hold), 2)
        return design.mount.root_rigid_radii == computed and (
            design.material.provenance.youngs_modulus_mpa != "identified"
        )
    for name, parameter in MATERIAL.items():
        keys = (parameter.design_key, f"tolerances.{parameter.attribute}", *(REPLACED_WITH_E if name == "E" else ()))
        if key in keys:
            provenance: str = getattr(design.material.provenance, _split_key(name)[1])
            return provenance != "identified"
    return False


def design_diff(design: Design, fingerprint: str, file: Path) -> str:
    """Return which numbers of an earlier identification, in `file`, a design of this geometry lacks; empty if none."""
    try:
        data = json.loads(file.read_bytes())
        if data["result"] not in ("ok", "accepted") or data["fingerprint"] != fingerprint:
            return ""
        differences = []
        for number in data["found"]:
            if number["result"] == "identified" and number["name"] in MATERIAL:
                quantity = getattr(design, MATERIAL[number["name"]].attribute)
                unit = number["unit"]
                identified = f"{number['value']:.4g}"
                present = f"{quantity.value / (MPA if unit == 'MPa' else 1.0):.4g}"  # as in a design file
                if identified != present:
                    differences.append(f"{number['name']} {identified} {unit}, where the design has {present}")
        return f"by {data['tests']} tests of {data['data']}, {', '.join(differences)}" if differences else ""
    except (OSError, ValueError, KeyError, TypeError):  # no identification was made, or another program's file
        return ""
