"""What an identification changes in a design file."""

import tomllib
from typing import Any

from probedesign.design import Design
from probedesign.design_edit import Change
from probedesign.errors import InputError
from probedesign.estimation.unknowns import ASSUMED_STIFFNESS, IDENTIFIED
from probedesign.identification.parameters import ROOT
from probedesign.identification.result import Identification, Identified

MATERIAL = {
    "E": "youngs_modulus_mpa",
    "G": "shear_modulus_mpa",
    "density": "density_kg_m3",
}
"""Keys of `[material]`."""
TOLERANCES = {"E": "youngs_modulus", "G": "shear_modulus", "density": "density"}
"""Keys of `[tolerances]`."""
GOES_WITH = {
    "E": ("material.youngs_modulus_mpa", "material.stiffness_spread", "tolerances.youngs_modulus",
          "tolerances.youngs_modulus_by_diameter"),
    "G": ("material.shear_modulus_mpa", "tolerances.shear_modulus"),
    "density": ("material.density_kg_m3", "tolerances.density"),
}  # fmt: skip
"""What an identification of each replaces in a design where it was not identified before."""


def changes_of(found: Identification, design: Design, day: str) -> tuple[Change, ...]:
    """The lines that a design gets; poses and gravity are of the bench and not of the probe.

    The value written is that with the design's diameters as they are, which the frozen probe carries too: of E and
    diameters it is E·d⁴ that was measured, and `youngs_modulus_by_diameter` says so. The standard deviations written
    have in them what the fit's intervals do not count.

    Args:
        found: the numbers.
        design: as it stands.
        day: for the notes.

    Raises:
        InputError: nothing was told that a design holds, or the fit is not to be trusted.
    """
    if found.result != "ok":
        why = found.why or "the search found no end"
        raise InputError(f"{found.data}: {found.result}: {why}; nothing is written")
    told = [one for one in found.found if one.identified and one.name in (*MATERIAL, ROOT)]
    if not told:
        raise InputError(f"{found.data}: tells nothing that a design holds; ask for E, G, density or root")
    changes = [_value(one, found, day) for one in told]
    changes += [Change("material.provenance", MATERIAL[one.name], '"identified"')
                for one in told if one.name in MATERIAL]  # fmt: skip
    changes += [_spread(one, day) for one in told if one.name in TOLERANCES]
    E, G = found.of("E"), found.of("G")
    return (*changes, *(_of_E(E, design, G is None, day) if E is not None else ()))


def _of_E(E: Identified, design: Design, alone: bool, day: str) -> list[Change]:
    """What else goes with E: the spread of fused touches, how it goes with the diameters, and the tolerance of G,
    which would follow that spread, if the tests told E alone."""
    changes = [Change("material", "stiffness_spread", f"{E.share_in_all:.2g}",
                      f"identified {day}: of E, as in [tolerances], for fusing touches")]  # fmt: skip
    if E.by_diameter is not None:
        changes.append(Change("tolerances", "youngs_modulus_by_diameter", f"{E.by_diameter:.2f}",
                              f"identified {day}: E·d⁴ was measured, so E goes with the diameters"))  # fmt: skip
    if alone and design.tolerances.shear_modulus is None:
        changes.append(Change("tolerances", "shear_modulus", f"{_before(design):.2g}",
                              "as before: the tests did not tell it"))  # fmt: skip
    return changes


def check_overwritable(
    design: Design, text: str, changes: tuple[Change, ...], where: str, force: bool
) -> None:
    """Refuse to replace what someone set or identified before, unless told to.

    A material's value that is not identified yet is what an identification is for, and what says how well it is
    known goes with it.

    Args:
        design: as it stands.
        text: of its file.
        changes: that are wanted.
        where: names the file in errors.
        force: replace all the same.

    Raises:
        InputError: a value stands in the file, and differs.
    """
    stands = [f"{one.table}.{one.key}" for one in changes
              if not _open(one, design) and _before_in(text, one) not in (None, _told(one))]  # fmt: skip
    if stands and not force:
        raise InputError(
            f"{where}: set or identified already: {', '.join(stands)}; --force replaces what stands there and keeps "
            "it as a comment, or write another file with --out"
        )


def _open(change: Change, design: Design) -> bool:
    """Whether the change says that a value is identified now, or is of one that is not yet, or goes with it."""
    if change.table == "material.provenance":
        return True
    name = next((name for name, keys in GOES_WITH.items() if f"{change.table}.{change.key}" in keys), None)
    return name is not None and getattr(design.material.provenance, MATERIAL[name]) != "identified"


def _before_in(text: str, change: Change) -> object:
    """What stands in the file; None if nothing does."""
    value: Any = tomllib.loads(text)
    for part in (*change.table.split("."), change.key):
        value = value.get(part) if isinstance(value, dict) else None
    return value


def _told(change: Change) -> object:
    return tomllib.loads(f"v = {change.text}")["v"]


def _value(one: Identified, found: Identification, day: str) -> Change:
    ends = f"{one.low_in_all:.4g} ... {one.high_in_all:.4g}"
    doubt = f"; {one.doubt}" if one.doubt else ""
    tests = f"{found.tests} test{'s' * (found.tests != 1)}"
    note = f"identified {day}, {tests}: {ends} in 95 %, with these diameters{doubt}"
    table = "mount" if one.name == ROOT else "material"
    return Change(
        table, "root_rigid_radii" if one.name == ROOT else MATERIAL[one.name], f"{one.value:.4g}", note
    )


def _before(design: Design) -> float:
    """How well G was known, where no tolerance of it is set."""
    spread = design.material.stiffness_spread
    usual = IDENTIFIED if design.youngs_modulus.provenance == "identified" else ASSUMED_STIFFNESS
    return usual if spread is None else spread


def _spread(one: Identified, day: str) -> Change:
    """Standard deviation, relative, in all."""
    assert one.std is not None
    note = f"identified {day}: {one.std / one.value:.2g} by the fit"
    if one.std != one.std_in_all:
        note += ", the rest what it does not count, each cause as one standard deviation"
    return Change("tolerances", TOLERANCES[one.name], f"{one.share_in_all:.2g}", note)
