"""Change the flange adapter of a design in CadQuery, look at it, and export it with its manifest.

Open the file in cq-editor or run it cell by cell with ocp-vscode; `python examples/changed_adapter.py [DESIGN [OUT]]`
writes the files. Lengths are millimetres.
"""

import sys
from pathlib import Path

from probedesign.cad import assembly, export_changed, flange_adapter
from probedesign.design import load_design

arguments = sys.argv[1:] if __name__ == "__main__" else []  # a viewer has arguments of its own
design_path = Path(arguments[0]) if arguments else Path(__file__).resolve().parents[1] / "designs/large.toml"
out = Path(arguments[1]) if len(arguments) > 1 else Path("exports/changed")

design = load_design(design_path)
plate = flange_adapter(design)

# %% add a blind hole for the screw of a camera bracket, beside the sensor
top = plate.faces(tag="sensor_face")
radius = top.val().BoundingBox().xmax
changed = top.workplane(origin=(0, 0, 0)).pushPoints([(0.0, 0.75 * radius)]).hole(2.5, 4.0)

# %% look at it
whole = assembly(design, flange_adapter=changed)
if "show_object" in globals():  # cq-editor
    show_object(whole, name=design.name)  # noqa: F821
else:
    try:
        from ocp_vscode import show
    except ImportError:  # without a viewer
        pass
    else:
        show(whole)

# %% export: STL, STEP, GLB and manifest, after the checks for overlap and for clearance to the sensor
if __name__ == "__main__":
    manifest = export_changed(design, out, flange_adapter=changed)
    print("wrote", manifest["folder"], *manifest["files"])
