"""What an identification changes in a design file."""

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
        raise InputError(f"{found.data}: {found.result}: {_MEANS[found.result]}; nothing is written")
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
        if "shear_modulus" not in spreads:  # else it would follow stiffness_spread, and nobody measured it
            spreads["shear_modulus"] = _before(design)
    changes += [
        Change("tolerances", key, f"{value:.2g}", _source(key, told, day)) for key, value in spreads.items()
    ]
    return tuple(changes)


def check_overwritable(design: Design, changes: tuple[Change, ...], where: str, force: bool) -> None:
    """Refuse to replace what was identified before, unless told to.

    Raises:
        InputError: one of the numbers is identified already.
    """
    told = [change.key for change in changes if change.table == "material.provenance"]
    for key in told if not force else []:
        if getattr(design.material.provenance, key) == "identified":
            raise InputError(
                f"{where}: material.{key} is identified already; --force replaces it and keeps the old value as a "
                "comment, or write another file with --out"
            )


_MEANS = {
    "inconsistent": "the tests scatter far more than stated, so the probe as designed does not explain them",
    "not_converged": "the search found no end",
}


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
    """How well G was known."""
    said = design.tolerances.shear_modulus
    if said is not None:
        return said
    spread = design.material.stiffness_spread
    usual = IDENTIFIED if design.youngs_modulus.provenance == "identified" else Unknowns.stiffness
    return usual if spread is None else spread


def _source(key: str, told: list[Identified], day: str) -> str:
    names = [TOLERANCES[one.name] for one in told if one.name in TOLERANCES]
    return f"identified {day}" if key in names else "as before: the tests did not tell it"
