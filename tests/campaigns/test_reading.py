"""Data folders: valid tables, and the refusal of mistakes in one line."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from probedesign.campaigns import read_campaign
from probedesign.campaigns.checks import check_probe
from probedesign.core.errors import InputError
from probedesign.design.io import load_design
from probedesign.probe import build_probe
from probedesign.vision.camera import Camera

TOML = """schema = 1
probe = "large"
[base]
p_world_mm = [0.0, 0.0, 250.0]
rotation_world_deg = [0.0, 90.0, 0.0]
[gravity]
world_m_s2 = [0.0, 0.0, -9.81]
[markers]
s_mm = [10.0, 20.0, 30.0]
std_mm = 0.5
[cameras]
names = ["left", "right"]
[weighing]
mass_g = 6.77
std_g = 0.01
of = "flexible"
"""
TESTS = """test,force_x_world_N,force_y_world_N,force_z_world_N,s_contact_mm,std_s_mm,direction,note
hang,0,0,0,,,,"free, at rest"
a-1,,,,60,0.05,+y,
"""
MARKERS = """test,marker,x_world_mm,y_world_mm,z_world_mm
hang,1,10,0,250
hang,2,20,0,250
hang,3,30.2,0,249.5
"""
WRENCHES = """# frame: sensor
test,time_s,Fx_mN,Fy_mN,Fz_mN,Mx_Nmm,My_Nmm,Mz_Nmm
hang,0,66,0,0,0,4,0
hang,1,68,0,0,0,4,0
"""


@pytest.fixture
def folder(tmp_path):
    for name, text in (("campaign.toml", TOML), ("tests.csv", TESTS), ("markers.csv", MARKERS),
                       ("wrenches.csv", WRENCHES)):  # fmt: skip
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.fixture
def seen(folder):
    """The same from two cameras, 70° apart, clicked exactly."""
    (folder / "markers.csv").unlink()
    middle, box = np.array([0.02, 0.0, 0.25]), np.array([0.1, 0.08, 0.08])
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
    points = middle + np.concatenate([corners, corners * 0.5]) * box
    markers = np.array([(10.0, 0, 250), (20, 0, 250), (30, 0, 249.5)]) / 1e3
    control, pixels = (["point,x_world_mm,y_world_mm,z_world_mm,camera,u_px,v_px"], ["test,camera,marker,u_px,v_px"])
    for name, side in (("left", -0.3), ("right", 0.3)):
        camera = Camera.looking(name, (0.02 + side, -0.4, 0.35), middle, 2000.0, (1600, 1200))
        control += [f"{i},{p[0] * 1e3},{p[1] * 1e3},{p[2] * 1e3},{name},{u},{v}"
                    for i, (p, (u, v)) in enumerate(zip(points, camera.project(points), strict=True))]  # fmt: skip
        pixels += [f"hang,{name},{i},{u},{v}" for i, (u, v) in enumerate(camera.project(markers), 1)]
    (folder / "control_points.csv").write_text("\n".join(control) + "\n")
    (folder / "pixels.csv").write_text("\n".join(pixels) + "\n")
    return folder


def refusal(folder, file, old, new) -> str:
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new))
    with pytest.raises(InputError) as caught:
        read_campaign(folder)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_folder_is_read_in_si(folder):
    campaign = read_campaign(folder)
    hang, touched = campaign.tests
    assert (campaign.name, campaign.fingerprint) == ("large", None)
    assert hang.free and not touched.free and touched.force_world is None
    np.testing.assert_allclose(
        hang.T_world_base[:3, 2], [1.0, 0.0, 0.0], atol=1e-12
    )  # z of the base along the world's x
    np.testing.assert_allclose(hang.wrenches.mean(axis=0), [0.067, 0, 0, 0, 0.004, 0], atol=1e-15)
    assert hang.frame == "sensor" and hang.markers is not None and touched.markers is None
    np.testing.assert_allclose(hang.markers.p_world[2], [0.0302, 0.0, 0.2495])
    np.testing.assert_allclose(hang.markers.cov_world[0], 0.5e-3**2 * np.eye(3))
    assert (touched.s_contact, touched.std_s, touched.direction) == (0.06, 5e-5, "+y")
    assert (campaign.std_base, campaign.weighing.mass) == (0.2e-3, pytest.approx(6.77e-3))


def test_gravity_and_mean_readings_are_in_the_base_frame(folder, large):
    """The x axis of the world is z of the base; readings at the sensor include the weight of the flange."""
    hang = read_campaign(folder).tests[0]
    np.testing.assert_allclose(hang.gravity_base, [9.81, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(hang.mean_wrench_sensor(large), [0.067, 0, 0, 0, 0.004, 0], atol=1e-15)
    at_base = hang.mean_wrench_base(large)
    np.testing.assert_allclose(at_base, large.to_base(hang.wrenches, hang.gravity_base).mean(axis=0), atol=1e-15)
    in_base = replace(hang, wrenches=at_base[None], frame="base")
    np.testing.assert_allclose(in_base.mean_wrench_sensor(large), hang.mean_wrench, atol=1e-15)


def test_units_of_the_header_are_converted(folder):
    before = read_campaign(folder).tests[0]
    text = MARKERS.replace("_mm", " [m]").replace("10,0,250", "0.01,0,0.25").replace("20,0,250", "0.02,0,0.25")
    (folder / "markers.csv").write_text(text.replace("30.2,0,249.5", "0.0302,0,0.2495"))
    np.testing.assert_allclose(read_campaign(folder).tests[0].markers.p_world, before.markers.p_world, atol=1e-15)


def test_an_assumed_frame_is_noted(folder):
    text = (folder / "wrenches.csv").read_text()
    lines = [line for line in text.splitlines() if not line.startswith("# frame")]
    (folder / "wrenches.csv").write_text("# frame: base\n" + "\n".join(lines) + "\n")
    assert not read_campaign(folder).notes
    (folder / "wrenches.csv").write_text("\n".join(lines) + "\n")
    assert [note for note in read_campaign(folder).notes if "names no frame" in note]


def test_a_test_may_have_a_base_of_its_own(folder):
    head = "test,base_x_world_mm,base_y_world_mm,base_z_world_mm,base_rx_world_deg,base_ry_world_deg,base_rz_world_deg"
    (folder / "tests.csv").write_text(f"{head}\nhang,,,,,,\na-1,5,6,7,0,0,90\n")
    hang, moved = read_campaign(folder).tests
    np.testing.assert_allclose(hang.T_world_base[:3, 3], [0, 0, 0.25])
    np.testing.assert_allclose(moved.T_world_base[:3], [[0, -1, 0, 5e-3], [1, 0, 0, 6e-3], [0, 0, 1, 7e-3]], atol=1e-15)


@pytest.mark.parametrize(("file", "old", "new", "message"), [
    ("campaign.toml", "std_mm", "std", "campaign.toml:10: unknown key 'markers.std'; did you mean 'markers.std_mm'?"),
    ("campaign.toml", "20.0, 30.0", "5.0", "campaign.toml:9: markers.s_mm item 2: 5 does not increase after 10"),
    ("campaign.toml", "-9.81", "-9810", "is not a gravity of up to 30 m/s²"),
    ("campaign.toml", "std_mm = 0.5", "", "markers.csv:2: no std_mm here, nor markers.std_mm"),
    ("campaign.toml", "schema = 1", "schema = 2", "campaign.toml:1: schema"),
    ("campaign.toml", '"right"', '"left"', "two or more different names"),
    ("tests.csv", "a-1", "hang", "tests.csv:3: test hang occurs twice, first in line 2"),
    ("tests.csv", "a-1", "../a", "is not a valid name; use letters"),
    ("tests.csv", "a-1,,,,60", "a-1,0,0,0,60", "has a contact and force 0,0,0"),
    ("tests.csv", "s_contact_mm", "s_contact", "column 's_contact': names no unit; end its name in one of _mm"),
    ("tests.csv", "s_contact_mm", "s_contact_in", "unit 'in' is not known"),
    ("wrenches.csv", "My_Nmm", "My_Nm", "mixed units: 'Mx_Nmm' and 'My_Nm'"),
    ("tests.csv", "std_s_mm", "std_s_m", "mixed units: 's_contact_mm' and 'std_s_m'"),
    ("tests.csv", "s_contact_mm", "s_contct_mm", "did you mean 's_contact_mm'?"),
    ("tests.csv", "0.05", "", "tests.csv:3: s_contact_mm has no standard deviation; give it in std_s_mm"),
    ("tests.csv", "0.05", "-0.5", "tests.csv:3: std_s_mm = -0.5 is not a standard deviation; write a positive number"),
    ("tests.csv", "0.05", "0", "tests.csv:3: std_s_mm = 0 is not a standard deviation; write a positive number"),
    ("campaign.toml", "std_mm = 0.5", "std_mm = -0.5", "std_mm = -0.5 is out of range; allowed is above 0, up to 100"),
    ("tests.csv", "0,0,0", "0,0,", "force_x_world_N is given without force_z_world_N"),
    ("tests.csv", ",60,", ",nan,", "s_contact_mm = 'nan' is not a finite number"),
    ("tests.csv", ",60,", ',"6,', "tests.csv:3: a quotation mark is opened and not closed"),
    ("tests.csv", "+y", "y", "tests.csv:3: direction = 'y' is none of +x, -x, +y, -y of the base"),
    ("tests.csv", ",60,", ",60,7,", "9 values where the header names 8"),
    ("tests.csv", ",", ";", "tests.csv:1: semicolons between the columns"),
    ("markers.csv", "hang,1", "hung,1", "markers.csv:2: test 'hung' is not in tests.csv; did you mean 'hang'?"),
    ("markers.csv", "hang,1", "hang,4", "marker 4 is beyond the list: markers.s_mm in campaign.toml has 3"),
    ("markers.csv", "hang,1", "hang,2", "test hang, marker 2 occurs twice"),
    ("markers.csv", "hang,1", "hang,x", "marker 'x' is not a number"),
    ("markers.csv", "_mm", "_m", "z_world_m = 250 is implausibly large; raw counts or a wrong unit?"),
    ("markers.csv", "10,0,250\nhang,2,20,0,250\nhang,3,30.2,0,249.5",
     "0.01,0,0.25\nhang,2,0.02,0,0.25\nhang,3,0.0302,0,0.2495",
     "markers lie 0.01011 mm apart, on the probe 10; metres in a column of millimetres"),
    ("markers.csv", "30.2,", "36,", "marker 2 and marker 3 lie 16.01 mm apart, on the probe 10; markers out of order"),
    ("markers.csv", "hang,1,10,0,250\nhang,2,20,0,250", "hang,2,10,0,250\nhang,1,20,0,250", "markers out of order"),
    ("markers.csv", "hang,1,10,0,250\nhang,2,20,0,250\nhang,3,30.2", "hang,3,10,0,250\nhang,2,20,0,250\nhang,1,30.2",
     "they count from the tip; marker 1 is nearest to the base"),
    ("markers.csv", ",0,2", ",80,2", "is the pose of the base right?"),
    ("wrenches.csv", "hang,1,", "hang,0,", "wrenches.csv:4: test hang at 0 s occurs twice, first in line 3"),
    ("wrenches.csv", "hang,1,", "hang,-1,", "wrenches.csv:4: time_s runs backward, from 0 s to -1 s"),
    ("wrenches.csv", "sensor", "tool", "frame 'tool' is not known; use sensor or base"),
    ("wrenches.csv", "68,0", "68,", "Fy_mN is empty; write the number"),
    ("wrenches.csv", "68", "9999999", "Fx_mN = 1e+07 is implausibly large; raw counts or a wrong unit?"),
    ("markers.csv", "30.2", "1e300", "markers.csv:4: x_world_mm = 1e+300 is implausibly large"),
    ("wrenches.csv", ",Mz_Nmm", "", "columns are missing: Mz_Nm"),
])  # fmt: skip
def test_a_mistake_is_one_clear_line(folder, file, old, new, message):
    assert message in refusal(folder, file, old, new)


def test_empty_columns_and_rows_of_a_spreadsheet_are_ignored(folder):
    """Columns without a name and rows of commas are ignored; a filled cell in such a column is refused."""
    before, path = read_campaign(folder).tests, folder / "tests.csv"
    lines = path.read_text().splitlines()
    width = lines[-1].count(",") + 2
    path.write_text("\n".join([f"{line},," if "," in line else line for line in lines] + ["," * width] * 2) + "\n")
    assert [test.name for test in read_campaign(folder).tests] == [test.name for test in before]
    assert "'7' is in a column without a name" in refusal(folder, "tests.csv", lines[-1] + ",,", lines[-1] + ",7,")


def test_missing_and_invalid_files_are_refused(tmp_path, folder):
    with pytest.raises(InputError, match="no such data folder"):
        read_campaign(tmp_path / "nothing")
    (folder / "tests.csv").write_bytes(b"\0\1")
    with pytest.raises(InputError, match="is a binary file; a table of tests is CSV"):
        read_campaign(folder)
    (folder / "tests.csv").write_text(TESTS.splitlines()[0])
    with pytest.raises(InputError, match="has a header and no rows"):
        read_campaign(folder)
    with (folder / "tests.csv").open("a") as file:
        file.truncate(50_000_001)  # sparse
    with pytest.raises(InputError, match="larger than 50 MB, far too large"):
        read_campaign(folder)
    shutil.move(folder / "campaign.toml", folder / "other.toml")
    with pytest.raises(InputError, match=r"has no campaign\.toml, so it is not a data folder"):
        read_campaign(folder)


@pytest.fixture(scope="module")
def large():
    return build_probe(load_design("large")).model


def test_data_of_another_probe_are_refused(folder, large):
    campaign = read_campaign(folder)
    check_probe(campaign, replace(large, fingerprint="any"))  # without a fingerprint the name decides
    with pytest.raises(InputError, match="data are of another probe: 'large', not 'small'"):
        check_probe(campaign, replace(large, name="small"))
    (folder / "tests.csv").write_text(TESTS.replace(",60,", ",160,"))
    with pytest.raises(InputError, match=r"tests\.csv: test a-1: s_contact_mm = 160 is beyond the tip of large at 150"):
        check_probe(read_campaign(folder), large)
    (folder / "campaign.toml").write_text(TOML.replace("30.0]", "30.0, 160.0]"))
    with pytest.raises(InputError, match=r"campaign\.toml: marker 4 at s = 160 mm is beyond the tip"):
        check_probe(read_campaign(folder), large)


def test_a_fingerprint_is_of_the_probe_that_is_named(folder, large):
    (folder / "campaign.toml").write_text(TOML.replace("schema = 1", 'schema = 1\nfingerprint = "abc"'))
    campaign = read_campaign(folder)
    with pytest.raises(InputError, match="fingerprint abc, not def of large"):
        check_probe(campaign, replace(large, fingerprint="def"))
    with pytest.raises(InputError, match="probe = 'large', and fingerprint abc is that of 'small'; correct the one"):
        check_probe(campaign, replace(large, name="small", fingerprint="abc"))


# cameras


def test_markers_of_two_pictures_are_located(seen):
    campaign = read_campaign(seen)
    found = campaign.tests[0].markers
    # pixels are written to 13 digits or so; the calibration is exact but for that
    np.testing.assert_allclose(found.p_world * 1e3, [(10, 0, 250), (20, 0, 250), (30, 0, 249.5)], atol=1e-4)
    assert (np.linalg.eigvalsh(found.cov_world) > 0.0).all()
    assert [note.split(":")[0] for note in campaign.notes] == ["camera left", "camera right"]


def test_markers_of_pictures_are_refused_by_the_name_of_their_table(seen):
    message = refusal(seen, "campaign.toml", "[10.0, 20.0, 30.0]", "[10.0, 15.0, 20.0]")
    assert "pixels.csv: test hang: " in message and "markers.csv" not in message


def test_a_marker_in_one_picture_only_and_swapped_cameras_are_named(seen):
    text = (seen / "pixels.csv").read_text()
    rows = "\n".join(line for line in text.splitlines() if not line.startswith("hang,right,2"))
    swapped = text.replace("left", "?").replace("right", "left").replace("?", "right")
    for wrong, words in ((rows, "test hang: marker 2 is seen by camera left only; two must see it"),
                         (swapped, "test hang: cameras left and right are swapped")):  # fmt: skip
        (seen / "pixels.csv").write_text(wrong)
        with pytest.raises(InputError, match=words):
            read_campaign(seen)


def test_mirrored_control_points_are_named(seen):
    lines = (seen / "control_points.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    turned = [",".join([*row[:2], str(-float(row[2])), *row[3:]]) for row in rows]
    (seen / "control_points.csv").write_text("\n".join([lines[0], *turned]))
    with pytest.raises(InputError, match=r"control_points\.csv: camera left: .*mirrored"):
        read_campaign(seen)


@pytest.mark.parametrize(("file", "old", "new", "message"), [
    ("pixels.csv", "hang,left,1", "hang,lft,1", "camera 'lft' is not in cameras.names of campaign.toml"),
    ("pixels.csv", "hang,left,1", "hang,left,2", "test hang, camera left, marker 2 occurs twice"),
    ("control_points.csv", ",right,", ",left,", "occurs twice"),
    ("campaign.toml", '[cameras]\nnames = ["left", "right"]', "", "which has none"),
])  # fmt: skip
def test_a_mistake_with_cameras_is_one_clear_line(seen, file, old, new, message):
    assert message in refusal(seen, file, old, new)


def test_pixels_need_control_points_and_no_second_reference(seen):
    (seen / "markers.csv").write_text(MARKERS)
    with pytest.raises(InputError, match=r"test hang has markers in markers\.csv and in pixels\.csv; keep one"):
        read_campaign(seen)
    (seen / "control_points.csv").unlink()
    with pytest.raises(InputError, match=r"control_points\.csv: is missing"):
        read_campaign(seen)
