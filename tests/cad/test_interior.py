"""The interior of the rigid parts, by which the print check cuts layers, is that of the drawn solids."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cadquery", reason="the parts are drawn with CadQuery: pip install 'probedesign[cad]'")

from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.gp import gp_Pnt
from OCP.TopAbs import TopAbs_State

from probedesign.mount.interior import clamp_ring_interior, flange_adapter_interior, sensor_adapter_interior

POINTS = 1500


@pytest.mark.parametrize("name", ["sensor_adapter", "clamp_ring", "flange_adapter"])
def test_the_interior_is_that_of_the_solid(large: Any, name: str) -> None:
    interiors: dict[str, Callable[..., Any]] = {
        "sensor_adapter": lambda x, y, z: sensor_adapter_interior(large.adapter, x, y, z),
        "clamp_ring": lambda x, y, z: clamp_ring_interior(large.adapter, x, y, z),
        "flange_adapter": lambda x, y, z: flange_adapter_interior(large.plate, x, y, z),
    }
    shape = large.parts[name].shape
    box = shape.BoundingBox()
    rng = np.random.default_rng(3)
    low, high = np.array([box.xmin, box.ymin, box.zmin]) - 0.5, np.array([box.xmax, box.ymax, box.zmax]) + 0.5
    inside_solid = BRepClass3d_SolidClassifier(shape.wrapped)  # `isInside` of CadQuery makes one for each point
    differ = []
    for p in rng.uniform(low, high, (POINTS, 3)):
        one = np.array([p[0]]), np.array([p[1]])
        inside = bool(interiors[name](one[0] * 1e-3, one[1] * 1e-3, p[2] * 1e-3)[0])
        inside_solid.Perform(gp_Pnt(*p), 1e-6)  # mm, the tolerance of `isInside`
        if inside != (inside_solid.State() == TopAbs_State.TopAbs_IN):
            differ.append(p)
    letters = {"sensor_adapter": large.adapter.on_wall.top, "clamp_ring": large.adapter.on_ring.top,
               "flange_adapter": large.plate.on_plate.top}  # fmt: skip
    for p in differ:  # the engraving is left out, to a depth of 0.4 mm
        assert 1e3 * letters[name] - 0.4 <= p[2] <= 1e3 * letters[name], p
    assert len(differ) < 0.02 * POINTS
