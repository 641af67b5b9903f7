"""A cloud as PLY, which viewers and trimesh open: points in millimetres, coloured by how well they are known."""

import math

from probedesign.mapping.colour import colour_of
from probedesign.mapping.contact_map import Cloud
from probedesign.units import MM

_PROPERTIES = (
    "float x", "float y", "float z", "uchar red", "uchar green", "uchar blue", "float rms_mm", "float force_N",
    "int touches",
)  # fmt: skip


def ply_of(cloud: Cloud, title: str) -> bytes:
    """The file.

    Args:
        cloud: its located points.
        title: one line, for a comment.
    """
    lines = [
        "ply",
        "format ascii 1.0",
        f"comment {' '.join(title.split())}",
        "comment x y z in mm, world frame",
    ]
    lines += [
        f"element vertex {len(cloud.points)}",
        *(f"property {name}" for name in _PROPERTIES),
        "end_header",
    ]
    for point in cloud.points:
        x, y, z = point.p_world / MM
        rms = point.rms / MM
        assert math.isfinite(rms), "a point without a covariance is none"
        red, green, blue = colour_of(rms)
        told = f"{x:z.4f} {y:z.4f} {z:z.4f} {red} {green} {blue} {rms:.4f} {point.force:.6f}"
        lines.append(f"{told} {len(point.touches)}")
    return ("\n".join(lines) + "\n").encode("ascii", "replace")
