"""The paper's three probes, as designs/large.toml, medium.toml and small.toml have them."""

from probedesign.design import Design, check_design
from probedesign.materials import ELASTIC_50A

PROBES = {"large": (150.0, 12.0, 2.0), "medium": (100.0, 8.0, 2.0), "small": (50.0, 5.0, 1.5)}
"""Length, base and tip diameter [mm]. The lengths are Table I's; all diameters but the large one's base are assumed:
the paper draws them in a figure without numbers."""
_MEASURED = {"youngs_modulus_mpa": 2.32, "shear_modulus_mpa": 0.761, "density_kg_m3": 1010.0}
_PROVENANCE = {
    "youngs_modulus_mpa": "identified",
    "shear_modulus_mpa": "identified",
    "density_kg_m3": "datasheet",
}


def paper_design(name: str) -> Design:
    """The design of one of them.

    Args:
        name: a key of `PROBES`.
    """
    length, base, tip = PROBES[name]
    probe = {"shape": "cone", "length_mm": length, "base_d_mm": base, "tip_d_mm": tip,
             "assumed": ["tip_d_mm"] if name == "large" else ["base_d_mm", "tip_d_mm"]}  # fmt: skip
    material = {"resin": "elastic-50a", **_MEASURED, "provenance": _PROVENANCE}
    contact = {"friction": ELASTIC_50A.friction.value}
    return check_design({"schema": 1, "name": name, "probe": probe, "material": material, "contact": contact})
