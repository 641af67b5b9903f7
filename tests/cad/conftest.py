"""One CAD model and one export, made once for all tests of the parts."""

import fcntl
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from probedesign.core.files import write_atomically
from probedesign.design import Design, parse_design
from probedesign.mount import Mount

LARGE = "length_mm = 150.0\nbase_d_mm = 12.0\ntip_d_mm = 2.0"


def design_of(probe: str = LARGE, robot_flange: str = "iso-9409-1-50-4-m6", name: str = "large") -> Design:
    mount = f'[mount]\nrobot_flange = "{robot_flange}"\n'
    return parse_design(f'schema = 1\nname = "{name}"\n[probe]\n{probe}\n{mount}')


@pytest.fixture(scope="session")
def large() -> Any:
    """The 150 × 12→2 mm cone, drawn."""
    from probedesign.cad.model import build_cad

    return build_cad(design_of())


def with_probe(large: Any, design: Design) -> Any:
    """The drawn parts with the probe of another design instead, for what looks at the probe alone."""
    from probedesign.cad.solids import probe_solid

    mount = Mount.of(design)
    probe = replace(large.parts["probe"], shape=probe_solid(mount.geometry, mount.sensor_adapter))
    return replace(large, design=design, geometry=mount.geometry, adapter=mount.sensor_adapter,
                   parts={**large.parts, "probe": probe}, fingerprints=mount.fingerprints)  # fmt: skip


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> tuple[Path, dict[str, Any]]:
    """The same probe, exported: its folder and the manifest as returned. One worker makes it for all."""
    from probedesign.cad import export_parts

    base = tmp_path_factory.getbasetemp()
    base = base if worker_id == "master" else base.parent
    folder, returned = base / "exports" / "large", base / "large.json"
    with (base / "large.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not returned.exists():
            write_atomically(returned, json.dumps(export_parts(design_of(), folder)).encode())
    return folder, json.loads(returned.read_text("utf-8"))
