"""What a print job is made of: the exported files, checked to be those of the design."""

import hashlib
import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from probedesign.design import Design
from probedesign.errors import InputError
from probedesign.geometry import build_geometry
from probedesign.printing.compensation import scale_of
from probedesign.printing.preform.replies import Corner

Parts = Literal["probe", "adapters"]
STL_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
PLAIN = re.compile(r"[A-Za-z0-9_-]+\.stl")


@dataclass(frozen=True)
class PrintJob:
    """One platform of one resin.

    Attributes:
        name: as the printer shows it.
        product: name of the printer that the design asks for.
        resin: of the design, or "rigid".
        folder: of the export, absolute.
        sizes: of each part in its file, along x, y and z [mm]; the file is its name with .stl.
    """

    name: str
    product: str
    resin: str
    folder: Path
    sizes: dict[str, Corner]

    def file(self, part: str) -> Path:
        """Where the part lies."""
        return self.folder / f"{part}.stl"


def job_of(design: Design, folder: Path, parts: Parts) -> PrintJob:
    """The job that prints the probe, or the one that prints all rigid parts.

    Args:
        design: that was exported.
        folder: of the export.
        parts: the soft probe, or the rigid rest: two resins, two jobs.

    Raises:
        InputError: the folder holds no export, one of another design, or files that were changed since.
    """
    folder = Path(os.path.abspath(folder))
    manifest = _manifest(folder / "manifest.json")
    _check_same(design, manifest, folder)
    names = [
        name
        for name in manifest["files"]
        if PLAIN.fullmatch(name) and (name == "probe.stl") == (parts == "probe")
    ]
    if not names:
        raise InputError(
            f"{folder}: its manifest lists no STL files for --parts {parts}; export the design again"
        )
    sizes = {name[:-4]: _size(folder / name, manifest["files"][name]) for name in names}
    fingerprint = build_geometry(design).fingerprint
    resin = design.resin.name if parts == "probe" else "rigid"
    return PrintJob(f"{design.name}-{fingerprint}-{parts}", design.printer.product, resin, folder, sizes)


def _manifest(path: Path) -> dict[str, Any]:
    try:
        manifest = json.loads(path.read_bytes())
    except FileNotFoundError:
        raise InputError(f"{path}: not found; make the parts first: probedesign export") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is no manifest of an export; export the design again") from None
    if not isinstance(manifest, dict) or not isinstance(manifest.get("files"), dict):
        raise InputError(f"{path}: is no manifest of an export; export the design again")
    return manifest


def _check_same(design: Design, manifest: dict[str, Any], folder: Path) -> None:
    """Refuse parts of another geometry, resin or scale than the design's."""
    exported = manifest.get("design")
    resin = exported.get("material", {}).get("resin") if isinstance(exported, dict) else None
    scales = manifest.get("print_scale")
    same = (
        manifest.get("fingerprint") == build_geometry(design).fingerprint
        and resin == design.resin.name
        and isinstance(scales, dict)
        and all(scale == list(scale_of(design, part)) for part, scale in scales.items())
    )
    if not same:
        raise InputError(
            f"{folder}: the parts there are of another geometry, resin or scale than the design; export it again"
        )


def _size(path: Path, record: Any) -> Corner:
    """Extent of the mesh in a file that is the one the manifest knows."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; export the design again") from None
    if not isinstance(record, dict) or hashlib.sha256(content).hexdigest() != record.get("sha256"):
        raise InputError(f"{path}: is not the file of its manifest; export the design again")
    corners = np.frombuffer(content, STL_RECORD, offset=84)["corners"].reshape(-1, 3)
    x, y, z = (float(v) for v in np.ptp(corners, axis=0))
    return (x, y, z)
