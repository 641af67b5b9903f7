"""Coupons of a design: a stepped cone and a straight rod in its resin, and sheets of the diameters to measure.

Both parts stand upright on a foot, as the probe does. They are written unscaled, so that their drawn over their
measured size is the scale of `[print]`.
"""

import hashlib
import math
import os
from pathlib import Path
from typing import Any

import cadquery as cq
import numpy as np

from probedesign.cad.exchange import step_bytes
from probedesign.cad.folder import check_target, digests, listed_digests, write_export
from probedesign.cad.kernel import revolved
from probedesign.cad.mesh import checked_mesh, stl_bytes
from probedesign.core.errors import CheckFailedError, InputError
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.mount import build_geometry

STEPS = 5
#: Height of a step [mm]: wider than the jaws of calipers, about 3 mm, with room to either edge (assumed).
STEP_HEIGHT_MM = 8.0
FOOT_RIM_MM, FOOT_HEIGHT_MM = 3.0, 3.0  #: Rim and height of the foot [mm]: those of the probe's flange, about.
LEAST_RANGE = 0.7  #: Smallest over largest diameter above which the steps go down to half of the largest.
SLENDERNESS = 10.0  #: Length of the rod over its diameter, within 40 ... 100 mm.
PLACES = 7  #: Places at which the probe is measured: from 5 to 95 % of its flank, one of them halfway.
CHECK_LIMIT = 1e-9  #: Relative, of a solid's volume to its closed form, as in `verify`.
Disc = tuple[float, float, float]  #: Diameter, and the heights between which it is [mm].


def export_coupon(design: Design, out: Path | None = None) -> dict[str, Any]:
    """Write a stepped cone and a straight rod in the resin of a design, with sheets for the diameters.

    Args:
        design: whose range of diameters the coupons cover.
        out: output folder; `exports/NAME/coupon` if None.

    Returns:
        The manifest, with the output folder under `folder`.

    Raises:
        InputError: the folder cannot be written, or a sheet there was filled in.
        CheckFailedError: a part disagrees with its closed form; nothing is written.
    """
    folder = Path(os.path.abspath(out or Path("exports") / design.name / "coupon"))
    check_target(folder, "coupon")
    listed = listed_digests(folder)
    for path in (folder / "coupon.csv", folder / "calipers.csv"):
        if path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() != listed.get(path.name):
            raise InputError(f"{path}: was filled in; move it, or name another folder with --out")
    fingerprint = build_geometry(design).fingerprint
    s, diameters = zip(*design.probe.blunt_mm, strict=True)
    largest, smallest = max(diameters), min(diameters)
    if smallest > LEAST_RANGE * largest:
        smallest = largest / 2.0
    steps = tuple(round(float(d), 2) for d in np.linspace(largest, smallest, STEPS))
    rod_d = round(float(np.interp(design.probe.length_mm / 2.0, s, diameters)), 2)
    rod_length = round(min(max(SLENDERNESS * rod_d, 40.0), 100.0), 1)
    parts = {
        "coupon_steps": [(d, i * STEP_HEIGHT_MM, (i + 1) * STEP_HEIGHT_MM) for i, d in enumerate(steps)],
        "coupon_rod": [(rod_d, 0.0, rod_length)],
    }
    contents = {
        "coupon.csv": _coupon_sheet(design, parts).encode(),
        "calipers.csv": _probe_sheet(design, fingerprint).encode(),
    }
    assembled, x = cq.Assembly(name=f"{design.name}-coupon"), 0.0
    for name, discs in parts.items():
        solid = _solid(name, discs)
        title = f"probedesign {fingerprint} {design.name} {name}"
        contents[f"{name}.stl"] = stl_bytes(checked_mesh(name, solid), title)
        assembled.add(solid, name=name, loc=cq.Location(cq.Vector(x, 0.0, 0.0)))
        x += 2.0 * (steps[0] + 2.0 * FOOT_RIM_MM)
    contents["coupon.step"] = step_bytes(
        assembled, "coupon.step", f"{design.name}: coupons, geometry {fingerprint}, units mm", design.date
    )
    manifest = {
        "kind": "coupon",
        "name": design.name,
        "fingerprint": fingerprint,
        "resin": design.resin.name,
        "steps_mm": list(steps),
        "step_height_mm": STEP_HEIGHT_MM,
        "rod_mm": [rod_d, rod_length],
        "files": digests(contents),
    }
    return write_export(folder, contents, manifest)


def _solid(name: str, discs: list[Disc]) -> cq.Solid:
    """Return the coupon: a foot below z = 0 and the discs above it, checked against their volume."""
    foot = discs[0][0] + 2.0 * FOOT_RIM_MM
    stack = [(foot, -FOOT_HEIGHT_MM, 0.0), *discs]
    outline = [(0.0, -FOOT_HEIGHT_MM)]
    for d, low, high in stack:
        outline += [(d / 2.0, low), (d / 2.0, high)]
    outline.append((0.0, stack[-1][2]))
    solid = revolved([(r * MM, z * MM) for r, z in outline])
    volume = sum(math.pi / 4.0 * d**2 * (high - low) for d, low, high in stack)
    if not solid.isValid() or abs(solid.Volume() / volume - 1.0) > CHECK_LIMIT:
        raise CheckFailedError(f"{name}: the solid is not valid, or differs from its volume of {volume:.6g} mm³")
    return solid


def _coupon_sheet(design: Design, parts: dict[str, list[Disc]]) -> str:
    lines = [
        f"# coupons of {design.name}, {design.resin.product}: diameters along x and along y, at s above the foot",
        f"# resin: {design.resin.name}",
        "# these parts are not scaled; probedesign measured DESIGN coupon.csv writes scales and offset of [print]",
        "# coupon_length: heights of the tops above the foot, by the depth rod of the calipers, at two sides",
        "part,s_mm,drawn_mm,diameter_x_mm,diameter_y_mm",
    ]
    for name, discs in parts.items():
        for d, low, high in discs:
            heights = (0.5,) if name == "coupon_steps" else (0.1, 0.5, 0.9)
            lines += [f"{name},{low + height * (high - low):g},{d:g},," for height in heights]
    lines += [f"coupon_length,{discs[-1][2]:g},{discs[-1][2]:g},," for discs in parts.values()]
    return "\n".join(lines) + "\n"


def _probe_sheet(design: Design, fingerprint: str) -> str:
    probe = design.probe
    s, d = zip(*probe.blunt_mm, strict=True)
    lines = [
        f"# fingerprint: {fingerprint}",
        f"# diameters of {design.name} along x and along y; s from the top of the flange; std: of one reading, 0.03 mm "
        "if empty",
        "s_mm,diameter_mm,diameter_y_mm,std_mm,note",
    ]
    for station in np.round(np.linspace(0.05, 0.95, PLACES) * probe.flank_end_mm, 1).tolist():
        lines.append(f"{station:g},,,,drawn {float(np.interp(station, s, d)):.3f} mm")
    return "\n".join(lines) + "\n"
