"""The 3MF packages of a design, one for each resin: a print job has one."""

from collections.abc import Mapping

from probedesign.cad.drawing import Drawing
from probedesign.cad.mesh import Mesh
from probedesign.cad.threemf import Piece, threemf_bytes
from probedesign.materials import RIGID_RESIN
from probedesign.printing.check import scale_note


def pieces_of(drawing: Drawing, meshes: Mapping[str, Mesh]) -> dict[str, list[Piece]]:
    """What goes into which file."""
    number = f"{drawing.design.name}-{drawing.geometry.fingerprint}"
    pieces = [Piece(name, f"{number}-{name}", mesh) for name, mesh in meshes.items()]
    return {
        "probe.3mf": [piece for piece in pieces if piece.name == "probe"],
        "adapters.3mf": [piece for piece in pieces if piece.name != "probe"],
    }


def packages_of(drawing: Drawing, meshes: Mapping[str, Mesh]) -> dict[str, bytes]:
    """The content of each file."""
    design = drawing.design
    resins = {"probe.3mf": design.resin.name, "adapters.3mf": RIGID_RESIN}
    titles = {"probe.3mf": "flexible probe", "adapters.3mf": "adapters and clamp ring"}
    return {
        file: threemf_bytes(
            pieces,
            {
                "Title": f"{design.name}: {titles[file]}",
                "Designer": "probedesign",
                "Description": f"geometry {drawing.geometry.fingerprint}{scale_note(design, pieces[0].name)}, "
                f"{resins[file]}",
            },
        )
        for file, pieces in pieces_of(drawing, meshes).items()
    }
