"""Numbers that were identified and that the design does not say."""

import json
from pathlib import Path
from typing import Any

from probedesign.design import Design
from probedesign.identification.design_update import MATERIAL
from probedesign.units import MPA


def unwritten(design: Design, fingerprint: str, file: Path) -> str:
    """Which numbers of an earlier identification a design does not have, in words; empty if none, or none was made.

    Args:
        design: that is to be used.
        fingerprint: of its geometry.
        file: `identification.json` of a probe of its name.
    """
    try:
        data = json.loads(file.read_bytes())
        if data["result"] != "ok" or data["fingerprint"] != fingerprint:
            return ""
        told = [one for one in data["found"] if one["result"] == "identified" and one["name"] in MATERIAL]
        apart = list(filter(None, (_apart(one, design) for one in told)))
        return f"by {data['tests']} tests of {data['data']}, {', '.join(apart)}" if apart else ""
    except (OSError, ValueError, KeyError, TypeError):  # none was made, or another program's file
        return ""


def _apart(one: dict[str, Any], design: Design) -> str:
    """Whether a number differs in the four digits that a design gets."""
    quantities = {
        "E": (design.youngs_modulus, MPA),
        "G": (design.shear_modulus, MPA),
        "density": (design.density, 1.0),
    }
    quantity, unit = quantities[one["name"]]
    found, has = f"{one['value']:.4g}", f"{quantity.value / unit:.4g}"
    return "" if found == has else f"{one['name']} {found} {one['unit']}, where the design has {has}"
