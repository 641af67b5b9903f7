"""Binary STL files: 80 bytes of header, the number of triangles, 50 bytes per triangle."""

import numpy as np
from numpy.typing import NDArray

RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
PREAMBLE = 84
"""Bytes before the first triangle."""


def stl_bytes(corners: NDArray[np.float32], title: str) -> bytes:
    """Return a binary STL file.

    Args:
        corners: of each triangle, counter-clockwise from outside [mm], (m, 3, 3).
        title: of the header; must not begin with "solid", which marks a text file.
    """
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    records = np.zeros(len(corners), dtype=RECORD)
    records["corners"] = corners
    records["normal"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    header = f"{title}, mm".encode("ascii", "replace")[:80].ljust(80)
    return header + np.uint32(len(records)).tobytes() + records.tobytes()


def stl_corners(content: bytes) -> NDArray[np.float32]:
    """Return the corners of each triangle of a binary STL file, in the file's unit, (m, 3, 3)."""
    corners: NDArray[np.float32] = np.frombuffer(content, RECORD, offset=PREAMBLE)["corners"]
    return corners
