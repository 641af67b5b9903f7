"""Resins by name: properties that fill a design's `[material]`, and how each is printed, cured and toleranced.

Every number has its source. A new resin is one record in `RESINS`; the other packages read it.
"""

from dataclasses import dataclass
from typing import Literal

from probedesign.core.errors import unknown_name
from probedesign.core.units import MPA

Provenance = Literal["assumed", "datasheet", "identified"]


@dataclass(frozen=True)
class Quantity:
    """A number in SI units with its provenance and source."""

    value: float
    provenance: Provenance
    source: str


@dataclass(frozen=True)
class Resin:
    """A printable material.

    Attributes:
        name: as written in a design file.
        product: name of the product, in messages and sources.
        youngs_modulus: E at small strain [Pa].
        shear_modulus: G [Pa]; independent of E on purpose (docs/decisions/0004).
        density: cured [kg/m³].
        friction: tangential over normal force of a touch [-], standard deviation of the prior per tangential direction.
        density_tolerance_source: source of the relative standard deviation of the density, `Tolerances.density`.
        preform_labels: labels in PreForm, the version first from which the properties were taken; empty if unknown.
        cure: instruction for washing and curing.
    """

    name: str
    product: str
    youngs_modulus: Quantity
    shear_modulus: Quantity
    density: Quantity
    friction: Quantity
    density_tolerance_source: str
    preform_labels: tuple[str, ...] = ()
    cure: str = "wash and cure as the resin's data sheet says"


ELASTIC_FRICTION = Quantity(
    0.6, "assumed", "soft polyurethane on card, plastic or metal: about 0.5 to 1; assumed until measured"
)
"""Friction of an elastic resin that has not been measured [-]. No value is published for Elastic 50A."""

_PAPER = "paper, section IV: identified on the paper's prints, not on yours"

ELASTIC_50A = Resin(
    name="elastic-50a",
    product="Elastic 50A",
    youngs_modulus=Quantity(2.32 * MPA, "assumed", _PAPER),
    shear_modulus=Quantity(0.761 * MPA, "assumed", _PAPER),
    density=Quantity(1010.0, "datasheet", "Formlabs Elastic 50A V1, 1.00-1.02 g/ml"),
    friction=ELASTIC_FRICTION,
    density_tolerance_source="datasheet: Formlabs Elastic 50A V1, 1.00-1.02 g/ml, its half width taken for one "
    "standard deviation",
    preform_labels=("Elastic 50A V1", "Elastic 50A V2"),
    cure="wash 20 min, cure 20 min at 60 °C (Formlabs, Elastic 50A)",
)


def _incompressible(
    name: str, product: str, E_mpa: float, density: float, E_source: str, density_source: str, label: str
) -> Resin:
    """Return a soft resin of which E alone is known: G = E/3, the incompressible limit, marked as assumed."""
    return Resin(
        name=name,
        product=product,
        youngs_modulus=Quantity(E_mpa * MPA, "assumed", E_source),
        shear_modulus=Quantity(E_mpa * MPA / 3.0, "assumed", "E/3, the incompressible limit"),
        density=Quantity(density, "datasheet", density_source),
        friction=ELASTIC_FRICTION,
        density_tolerance_source=f"assumed: 1 %, as of Elastic 50A; the data sheet of {product} has no range",
        preform_labels=(label,),
    )


FLEXIBLE_80A = _incompressible(
    "flexible-80a", "Flexible 80A", 6.3, 1120.0,
    "stress at 100 % strain (V1) taken for E: identify before you rely on it",
    "Formlabs Flexible 80A V2, 1.12 g/ml", "Flexible 80A V1",
)  # fmt: skip
SILICONE_40A = _incompressible(
    "silicone-40a", "Silicone 40A", 1.7, 1040.0,
    "rule of thumb for Shore 40A (Gent's relation): identify before you rely on it",
    "Formlabs Silicone 40A, 1.04 g/ml", "Silicone 40A V1",
)  # fmt: skip

RESINS = {resin.name: resin for resin in (ELASTIC_50A, FLEXIBLE_80A, SILICONE_40A)}

RIGID_RESIN = "rigid resin, e.g. Grey V4"
"""Material of the adapters; any resin that is stiff against the probe is suitable."""
RIGID_PREFORM_LABELS = ("Grey V4", "Grey V5")
"""Labels of that resin in PreForm."""
RIGID_DENSITY = 1180.0
"""Density of the rigid adapters [kg/m³]. Source: Formlabs Grey/Clear V4, 1.15-1.2 g/ml; the middle, assumed."""


def resin_named(name: str) -> Resin:
    """Return the resin of that name.

    Raises:
        InputError: no such resin; the message lists the known ones.
    """
    try:
        return RESINS[name]
    except KeyError:
        raise unknown_name("material.resin", name, RESINS) from None
