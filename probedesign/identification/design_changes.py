"""What an identification changes in a design file."""

import tomllib
from typing import Any

from probedesign.design import Design
from probedesign.design_edit import Change
from probedesign.errors import InputError
from probedesign.estimator.unknowns import IDENTIFIED, Unknowns
from probedesign.identification.identification import Identification, Identified
from probedesign.identification.unknowns import ROOT

MATERIAL = {
    "E": "youngs_modulus_mpa",
    "G": "shear_modulus_mpa",
    "density": "density_kg_m3",
}
"""Keys of `[material]`."""
TOLERANCES = {"E": "youngs_modulus", "G": "shear_modulus", "density": "density"}
"""Keys of `[tolerances]`."""


def changes_of(found: Identification, design: Design, day: str) -> tuple[Change, ...]:
    """The lines that a design gets; poses and gravity are of the bench and not of the probe.

    The interval written is that with the design's diameters as they are, which the frozen probe carries too: of E and
    diameters it is E·d⁴ that was measured.

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
    spreads = {TOLERANCES[one.name]: _share(one) for one in told if one.name in TOLERANCES}
    if "youngs_modulus" in spreads:
        changes.append(Change("material", "stiffness_spread", f"{spreads['youngs_modulus']:.2g}",
                              f"identified {day}: of E, for fusing touches"))  # fmt: skip
        if (
            "shear_modulus" not in spreads and design.tolerances.shear_modulus is None
        ):  # else it would follow stiffness_spread, and nobody measured it
            spreads["shear_modulus"] = _before(design)
    changes += [
        Change("tolerances", key, f"{value:.2g}", _source(key, told, day)) for key, value in spreads.items()
    ]
    return tuple(changes)


def check_overwritable(
    design: Design, text: str, changes: tuple[Change, ...], where: str, force: bool
) -> None:
    """Refuse to replace what someone set or identified before, unless told to.

    A material's value that is not identified yet is what an identification is for.

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
    """Whether the change is of a material's value that is not identified yet, or says that it is now."""
    if change.table == "material.provenance":
        return True
    named = change.table == "material" and change.key in MATERIAL.values()
    return named and getattr(design.material.provenance, change.key) != "identified"


def _before_in(text: str, change: Change) -> object:
    """What stands in the file; None if nothing does."""
    value: Any = tomllib.loads(text)
    for part in (*change.table.split("."), change.key):
        value = value.get(part) if isinstance(value, dict) else None
    return value


def _told(change: Change) -> object:
    return tomllib.loads(f"v = {change.text}")["v"]


def _value(one: Identified, found: Identification, day: str) -> Change:
    note = f"identified {day}, {found.tests} tests: {one.low:.4g} ... {one.high:.4g} in 95 %, with these diameters"
    table = "mount" if one.name == ROOT else "material"
    return Change(
        table, "root_rigid_radii" if one.name == ROOT else MATERIAL[one.name], f"{one.value:.4g}", note
    )


def _share(one: Identified) -> float:
    assert one.std is not None
    return one.std / one.value


def _before(design: Design) -> float:
    """How well G was known, where no tolerance of it is set."""
    spread = design.material.stiffness_spread
    usual = IDENTIFIED if design.youngs_modulus.provenance == "identified" else Unknowns.stiffness
    return usual if spread is None else spread


def _source(key: str, told: list[Identified], day: str) -> str:
    names = [TOLERANCES[one.name] for one in told if one.name in TOLERANCES]
    return f"identified {day}" if key in names else "as before: the tests did not tell it"
