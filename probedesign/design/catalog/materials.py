"""Resins by name: what fills a design's `[material]` where the file says nothing. Every number carries its source."""

from dataclasses import dataclass
from typing import Literal

from probedesign.core.errors import unknown_name
from probedesign.core.units import MPA

Provenance = Literal["assumed", "datasheet", "identified"]


@dataclass(frozen=True)
class Quantity:
    """A number in SI with where it comes from."""

    value: float
    provenance: Provenance
    source: str


@dataclass(frozen=True)
class Resin:
    """A printable material.

    Attributes:
        name: as written in a design file.
        youngs_modulus: E at small strain [Pa].
        shear_modulus: G [Pa]; kept apart from E on purpose (see docs/decisions/0004).
        density: cured [kg/m³].
        friction: tangential over normal force of a touch [-], standard deviation of the prior per tangential direction.
    """

    name: str
    youngs_modulus: Quantity
    shear_modulus: Quantity
    density: Quantity
    friction: Quantity


ELASTIC_FRICTION = Quantity(
    0.6, "assumed", "soft polyurethane on card, plastic or metal: about 0.5 to 1; assumed until measured"
)
"""Friction of an elastic resin that nobody has measured [-]. No value is published for Elastic 50A."""

_PAPER = "paper, section IV: identified on the paper's prints, not on yours"

ELASTIC_50A = Resin(
    name="elastic-50a",
    youngs_modulus=Quantity(2.32 * MPA, "assumed", _PAPER),
    shear_modulus=Quantity(0.761 * MPA, "assumed", _PAPER),
    density=Quantity(1010.0, "datasheet", "Formlabs Elastic 50A V1, 1.00-1.02 g/ml"),
    friction=ELASTIC_FRICTION,
)


def _incompressible(name: str, E_mpa: float, density: float, E_source: str, density_source: str) -> Resin:
    """A soft resin known by E alone: G = E/3, the incompressible limit, marked as assumed."""
    return Resin(
        name=name,
        youngs_modulus=Quantity(E_mpa * MPA, "assumed", E_source),
        shear_modulus=Quantity(E_mpa * MPA / 3.0, "assumed", "E/3, the incompressible limit"),
        density=Quantity(density, "datasheet", density_source),
        friction=ELASTIC_FRICTION,
    )


FLEXIBLE_80A = _incompressible(
    "flexible-80a", 6.3, 1120.0, "stress at 100 % strain (V1) taken for E: identify before you rely on it",
    "Formlabs Flexible 80A V2, 1.12 g/ml",
)  # fmt: skip
SILICONE_40A = _incompressible(
    "silicone-40a", 1.7, 1040.0, "rule of thumb for Shore 40A (Gent's relation): identify before you rely on it",
    "Formlabs Silicone 40A, 1.04 g/ml",
)  # fmt: skip

RESINS = {resin.name: resin for resin in (ELASTIC_50A, FLEXIBLE_80A, SILICONE_40A)}

RIGID_RESIN = "rigid resin, e.g. Grey V4"
"""What the adapters are printed from; any that is stiff against the probe will do."""
RIGID_DENSITY = 1180.0
"""Density of the rigid adapters [kg/m³]. Source: Formlabs Grey/Clear V4, 1.15-1.2 g/ml; the middle, assumed."""


def resin_named(name: str) -> Resin:
    """The resin of that name.

    Raises:
        InputError: no such resin; the message lists the known ones.
    """
    try:
        return RESINS[name]
    except KeyError:
        raise unknown_name("material.resin", name, RESINS) from None
