"""The probes of the paper as presets, and the conditions of its Table I.

Source: "Spatial Position Estimation of Lightweight and Delicate Objects using a Soft haptic Probe", section IV and
Table I.
"""

from typing import Any

from probedesign.design.catalog import ELASTIC_50A

#: Length, base and tip diameter [mm]. The lengths are from Table I; all diameters except the large probe's base are
#: assumed: the paper shows them in a figure without numbers.
PROBES = {"large": (150.0, 12.0, 2.0), "medium": (100.0, 8.0, 2.0), "small": (50.0, 5.0, 1.5)}
#: Touches of Table I by probe: fraction of the length and force [N]. The directions of the pushes are not given.
CONDITIONS = {
    "large": ((0.133, 0.25), (0.266, 0.22), (0.266, 0.053), (0.4, 0.103), (0.4, 0.052), (0.533, 0.014), (0.533, 0.032),
              (0.666, 0.011), (0.8, 0.006)),
    "medium": ((0.1, 1.5), (0.3, 0.23), (0.5, 0.126), (0.5, 0.055), (0.7, 0.26), (0.8, 0.02), (0.9, 0.005)),
    "small": ((0.2, 0.4), (0.4, 0.11), (0.4, 0.2), (0.6, 0.07), (0.6, 0.047), (0.6, 0.083), (0.8, 0.032)),
}  # fmt: skip
_MATERIAL = {"youngs_modulus_mpa": 2.32, "shear_modulus_mpa": 0.761, "density_kg_m3": 1010.0}
_PROVENANCE = dict(zip(_MATERIAL, ("identified", "identified", "datasheet"), strict=True))


def paper_tables(name: str) -> dict[str, Any]:
    """Return the tables of one of the paper's probes, as in designs/large.toml, medium.toml and small.toml.

    Args:
        name: a key of `PROBES`.
    """
    length, base, tip = PROBES[name]
    probe = {"shape": "cone", "length_mm": length, "base_d_mm": base, "tip_d_mm": tip,
             "assumed": ["tip_d_mm"] if name == "large" else ["base_d_mm", "tip_d_mm"]}  # fmt: skip
    material = {"resin": "elastic-50a", **_MATERIAL, "provenance": _PROVENANCE}
    sensor = {"model": "nano17", "calibration": "si-12-0.12"}
    return {"schema": 1, "name": name, "probe": probe, "material": material, "sensor": sensor,
            "mount": {"hold": "bonded", "root_rigid_radii": 0.12},
            "contact": {"friction": ELASTIC_50A.friction.value}}  # fmt: skip
