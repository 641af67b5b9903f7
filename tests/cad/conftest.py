"""One CAD model and one export, made once for all tests of the parts."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from probedesign.design import Design, parse_design

LARGE = "length_mm = 150.0\nbase_d_mm = 12.0\ntip_d_mm = 2.0"


def design_of(probe: str = LARGE, robot_flange: str = "iso-9409-1-50-4-m6", name: str = "large") -> Design:
    mount = f'[mount]\nrobot_flange = "{robot_flange}"\n'
    return parse_design(f'schema = 1\nname = "{name}"\n[probe]\n{probe}\n{mount}')


@pytest.fixture(scope="session")
def make_design() -> Callable[..., Design]:
    return design_of


@pytest.fixture(scope="session")
def large() -> Any:
    """The 150 × 12→2 mm cone, drawn."""
    from probedesign.cad.model import build_cad

    return build_cad(design_of())


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """The same probe, exported: its folder and the manifest as returned."""
    from probedesign.cad import export_parts

    folder = tmp_path_factory.mktemp("exports") / "large"
    return folder, export_parts(design_of(), folder)
