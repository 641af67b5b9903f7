"""`.cal` files: both versions give one matrix; what no sensor can have is refused."""

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.live.sources.daq import read_calibration
from tests.live.cal_file import U, text

pytest.importorskip("defusedxml")


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
    assert np.allclose((volts - zero) @ calibration.matrix.T, wrench, rtol=1e-12, atol=1e-14)
    assert calibration.ranges.tolist() == [25, 25, 35, 0.25, 0.25, 0.25]
    assert (calibration.serial, calibration.part) == ("FT1", "SI-25-0.25")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("no xml", "not valid or safe XML"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "not valid or safe XML"),
        ("<FTSensor/>", "not an ATI calibration"),
        (text("1.0", units="N-furlong"), "TorqueUnits = 'N-furlong' is not a known unit"),
        (text("1.0").replace("BasicTransform", "Other"), "so its origin is unknown"),
        (text("1.0", 'Dx="1" Dy="0" Dz="6" Rx="0" Ry="0" Rz="0"'), "BasicTransform has Dx"),
        (text("1.0").replace('Name="Tz"', 'Name="Ty"'), "a calibration has Fx, Fy"),
        (text("1.0").replace('scale="1.5"', 'scale="0"'), "scale of Axis Tz = '0' must be 1 numbers"),
        (text("1.1").replace(" 0.1 -14.8 ", " 0.1 "), "values of UserAxis Tz"),
        (text("1.1").replace("0.1 -14.8 -0.3 -14.3 1.0 -14.3", "0 0 0 0 0 0"), "its matrix is singular"),
    ],
)
def test_what_is_no_calibration(read, content, expected):
    with pytest.raises(InputError) as error:
        read(content)
    assert expected in str(error.value) and "FT1.cal" in str(error.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match=r"none\.cal: cannot be read as a calibration: No such file"):
        read_calibration(tmp_path / "none.cal")
