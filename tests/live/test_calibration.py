"""`.cal` files: both versions give one matrix; what no sensor can have is refused. The numbers are made up."""

import numpy as np
import pytest

from probedesign.errors import InputError
from probedesign.live.calibration import CHANNELS, clips, read_calibration

pytest.importorskip("defusedxml")

U = np.array([  # N and N·mm of a volt about the tool face
    [0.1, 0.0, 0.3, 3.3, 0.2, -3.3],
    [0.0, -4.0, 0.0, 1.9, -0.1, 1.9],
    [3.7, 0.1, 3.8, 0.0, 3.7, -0.1],
    [0.4, -24.4, 20.9, 12.0, -21.4, 12.0],
    [-23.6, -0.7, 12.5, -20.0, 10.9, 19.7],
    [0.1, -14.8, -0.3, -14.3, 1.0, -14.3],
])  # fmt: skip
MAX = (25, 25, 35, 250, 250, 250)
SCALE = (11.0, 11.0, 6.0, 1.8, 1.8, 1.5)
DZ = 6.096


def text(
    version: str, transform: str = 'Dx="0" Dy="0" Dz="6.096" Rx="0" Ry="0" Rz="0"', units: str = "N-mm"
) -> str:
    inner = U.copy()  # about the transducer's own origin, DZ below the face
    inner[3] -= DZ * U[1]
    inner[4] += DZ * U[0]
    rows = [("Axis", inner * np.array(SCALE)[:, None], ' scale="{}"')]
    if version == "1.1":
        rows.append(("UserAxis", U, ""))
    axes = "".join(
        f'<{tag} Name="{name}" values=" {" ".join(map(repr, map(float, row)))} " max="{top}"{extra.format(scale)}/>\n'
        for tag, matrix, extra in rows
        for name, row, top, scale in zip(CHANNELS, matrix, MAX, SCALE, strict=True)
    )
    return (
        f'<?xml version="1.0" encoding="utf-8"?>\n<FTSensor Serial="FT1" NumGages="6" CalFileVersion="{version}">'
        f'<Calibration PartNumber="SI-25-0.25" ForceUnits="N" TorqueUnits="{units}" DistUnits="mm">{axes}'
        f"<BasicTransform {transform}/></Calibration></FTSensor>"
    )


@pytest.fixture
def read(tmp_path):
    def read(content: str):
        path = tmp_path / "FT1.cal"
        path.write_text(content)
        return read_calibration(path)

    return read


@pytest.mark.parametrize("version", ["1.0", "1.1"])
def test_both_versions_give_the_wrench_about_the_tool_face(read, version):
    """To a rounding of each product."""
    calibration = read(text(version))
    volts, zero = np.array([1.0, -2.0, 0.5, 3.0, -1.0, 0.2]), np.array([0.1, 0.2, -0.1, 0.0, 0.3, -0.2])
    wrench = U @ (volts - zero) * [1, 1, 1, 1e-3, 1e-3, 1e-3]
    assert np.allclose(calibration.wrench(volts, zero), wrench, rtol=1e-12, atol=1e-14)
    assert calibration.ranges.tolist() == [25, 25, 35, 0.25, 0.25, 0.25]
    assert (calibration.serial, calibration.part) == ("FT1", "SI-25-0.25")


def test_a_gauge_beyond_the_amplifier_is_no_reading():
    assert not clips(np.full(6, 9.8))
    assert clips(np.array([0.0, 0.0, -9.81, 0.0, 0.0, 0.0])) and clips(np.full(6, np.nan))


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("no xml", "no XML that can be trusted"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "no XML that can be trusted"),
        ("<FTSensor/>", "is no calibration"),
        (text("1.0", units="N-furlong"), "TorqueUnits = 'N-furlong' is no unit that is known"),
        (text("1.0").replace("BasicTransform", "Other"), "where its origin lies is not known"),
        (text("1.0", 'Dx="1" Dy="0" Dz="6" Rx="0" Ry="0" Rz="0"'), "BasicTransform has Dx"),
        (text("1.0").replace('Name="Tz"', 'Name="Ty"'), "a calibration has Fx, Fy"),
        (text("1.0").replace('scale="1.5"', 'scale="0"'), "scale of Axis Tz = '0' must be 1 numbers"),
        (text("1.1").replace(" 0.1 -14.8 ", " 0.1 "), "values of UserAxis Tz"),
        (text("1.1").replace("0.1 -14.8 -0.3 -14.3 1.0 -14.3", "0 0 0 0 0 0"), "none that a sensor can have"),
    ],
)
def test_what_is_no_calibration(read, content, told):
    with pytest.raises(InputError) as error:
        read(content)
    assert told in str(error.value) and "FT1.cal" in str(error.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match=r"none\.cal: cannot be read as a calibration: No such file"):
        read_calibration(tmp_path / "none.cal")
