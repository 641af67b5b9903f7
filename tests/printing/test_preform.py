"""`probedesign print` against a server on the loopback that follows PreForm's published API, and faults in it."""

import hashlib
import json
import shutil
import signal
import socket
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.design import load_design
from probedesign.design.catalog import RESINS
from probedesign.geometry import build_geometry
from probedesign.printing import check
from probedesign.printing import preform_client as client
from probedesign.printing.check import HEIGHT_ABOVE_RAFT, RAFT_THICKNESS
from probedesign.printing.preform_client import Connection, NoResponseError, PreForm, PreFormError, connection_to
from probedesign.printing.preform_job import PrintOrder, load_job, path_mapping, prepare_job
from probedesign.printing.preform_settings import MaterialList, select_settings
from tests.printing.fake_preform import MATERIALS, PNG, STL_RECORD, FakePreForm

SIZES = {"probe": (19, 19, 83), "sensor_adapter": (30, 30, 8), "clamp_ring": (30, 30, 2.5)}
DESIGN = """schema = 1
name = "thin"
[probe]
length_mm = 80.0
base_d_mm = 12.0
tip_d_mm = 2.0
"""


def tetrahedron(size) -> bytes:
    """Return the smallest closed body of that extent as binary STL."""
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float) * size
    faces = np.zeros(4, STL_RECORD)
    faces["v"] = corners[[(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]]
    return b"test".ljust(80) + np.uint32(4).tobytes() + faces.tobytes()


@pytest.fixture(scope="module", autouse=True)
def examined_once():
    """Examine the layers of each mount once: almost all tests here check and print the same one."""
    examine, known = check.oriented_parts, {}

    def oriented_parts(*mount):
        key = repr(mount)
        if key not in known:
            known[key] = examine(*mount)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(check, "oriented_parts", oriented_parts)
        yield


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Return a design and an export of it that needs no CAD."""
    monkeypatch.chdir(tmp_path)
    Path("thin.toml").write_text(DESIGN)
    folder = tmp_path / "exports" / "thin"
    folder.mkdir(parents=True)
    files = {f"{name}.stl": tetrahedron(size) for name, size in SIZES.items()} | {"assembly.step": b"step"}
    for name, content in files.items():
        (folder / name).write_bytes(content)
    manifest = {
        "fingerprint": build_geometry(load_design("thin.toml")).fingerprint,
        "design": {"material": {"resin": "elastic-50a"}},
        "files": {name: {"sha256": hashlib.sha256(content).hexdigest()} for name, content in files.items()},
        "print_scale": {name: [1.0, 1.0, 1.0] for name in SIZES},
    }
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


@pytest.fixture
def fake(place):
    with FakePreForm() as server:
        yield server


def prepared(fake, place, order=PrintOrder(), timeout_s=5.0, operation_s=20.0, on_progress=None):  # noqa: B008  # immutable
    """Run the command with short timeouts."""
    server = PreForm(
        connection_to(fake.url, timeout_s),
        operation_s,
        poll_s=0.005,
        on_progress=on_progress or (lambda step, share: None),
    )
    job = load_job(load_design("thin.toml"), place, order.parts)
    return prepare_job(server, job, path_mapping(place, order.server_folder, True, fake.url), order)


def left_over(folder):
    """Files that were not requested."""
    return [p.name for p in folder.iterdir() if p.name.startswith(".")]


# What is asked of PreForm


def test_adapters_stand_as_the_print_check_chose_and_only_some_get_supports(fake, place):
    """The manifest states a side for each part; a part on the platform needs no supports and is no problem without."""
    manifest = json.loads((place / "manifest.json").read_text())
    manifest["print_check"] = {"orientation": {
        "sensor_adapter": {"side": "upright", "supports": False, "rests_on": "its foot"},
        "clamp_ring": {"side": "upside down", "supports": True, "rests_on": "its top"},
    }}  # fmt: skip
    (place / "manifest.json").write_text(json.dumps(manifest))
    result = prepared(fake, place, PrintOrder(parts="adapters"))
    assert result.problems == ()
    assert result.orientation == {
        "sensor_adapter": "upright, on the platform",
        "clamp_ring": "upside down, on supports",
    }
    assert len(fake.body("auto-support")["models"]) == 1
    assert fake.body("import-model")["orientation"]["z_direction"] == [0, 0, -1]  # the last part imported
    for part in manifest["print_check"]["orientation"].values():
        part["supports"] = False
    (place / "manifest.json").write_text(json.dumps(manifest))
    before = len(fake.calls)
    assert prepared(fake, place, PrintOrder(parts="adapters")).problems == ()
    assert not any("auto-support" in call for call in fake.calls[before:])


def test_the_probe_is_prepared_upright_and_supported_and_nothing_is_sent(fake, place):
    result = prepared(fake, place)
    scene = "/scene/*/"
    assert fake.calls == [
        "GET /",
        "GET /list-materials/",
        "POST /scene/",
        f"POST {scene}import-model/",
        f"GET {scene}",
        f"POST {scene}auto-support/",
        f"POST {scene}auto-layout/",
        f"GET {scene}",
        f"GET {scene}print-validation/",
        f"POST {scene}estimate-print-time/",
        f"POST {scene}save-screenshot/",
        f"DELETE {scene}",
    ]
    assert fake.body("scene") == {
        "machine_type": "FORM-3-1", "material_code": "FLELCL01", "print_setting": "STAGE3_DEFAULT",
        "layer_thickness_mm": 0.1,
    }  # fmt: skip
    assert fake.body("import-model") == {
        "file": str(place / "probe.stl"), "name": "probe", "repair_behavior": "REPAIR", "units": "MILLIMETERS",
        "orientation": {"z_direction": [0, 0, 1], "x_direction": [1, 0, 0]},
    }  # fmt: skip
    supports = fake.body("auto-support")
    assert (supports["raft_thickness_mm"], supports["height_above_raft_mm"]) == (RAFT_THICKNESS, HEIGHT_ABOVE_RAFT)
    assert supports["internal_supports_enabled"] is False
    assert (result.layer_count, result.volume_ml, result.print_time_s) == (1600, 12.34, 15120.0)
    assert result.problems == () and result.sent_to is None
    assert (place / "preform-probe.png").read_bytes() == PNG
    assert left_over(place) == [] and fake.scenes == {}


def test_the_adapters_are_another_job_in_a_rigid_resin(fake, place):
    result = prepared(fake, place, PrintOrder(parts="adapters"))
    assert sorted(result.parts) == ["clamp_ring", "sensor_adapter"]
    assert (result.selection.material, result.selection.setting) == ("Grey V4", "0.100 mm (Default settings)")
    assert (place / "preform-adapters.png").is_file()


@pytest.mark.parametrize("form", [False, True])
@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("parts", ["probe", "adapters"])
def test_nothing_goes_to_a_printer_without_send(fake, place, form, force, parts):
    prepared(fake, place, PrintOrder(parts=parts, form_file=str(place / "x.form") if form else None, force=force))
    assert fake.printed == []
    assert not any("print/" in call for call in fake.calls)


def test_what_is_sent_waits_in_the_printers_queue(fake, place):
    result = prepared(fake, place, PrintOrder(printer="Form3-TestyTest"))
    fingerprint = build_geometry(load_design("thin.toml")).fingerprint
    assert fake.printed == [
        {"printer": "Form3-TestyTest", "job_name": f"thin-{fingerprint}-probe", "print_now": False, "models": 1}
    ]
    assert (result.sent_to, result.job_id) == ("Form3-TestyTest", "4711")


@pytest.mark.parametrize(
    ("found", "message"),
    [
        ({"cups": 1}, "probe: 1 cup(s) that trap resin"),
        ({"unsupported_minima": 3}, "probe: 3 place(s) that begin in mid-air"),
        ({"undersupported": True}, "probe: too few supports"),
    ],
)
def test_a_problem_keeps_the_job_from_the_printer_but_not_from_its_file(fake, place, found, message):
    fake.validation |= found
    form = place / "x.form"
    result = prepared(fake, place, PrintOrder(form_file=str(form), printer="Form3-TestyTest"))
    assert result.problems == (message,)
    assert fake.printed == [] and result.sent_to is None and form.is_file()
    prepared(fake, place, PrintOrder(form_file=str(form), printer="Form3-TestyTest", force=True))
    assert len(fake.printed) == 1


def test_a_part_off_the_platform_is_a_problem(fake, place):
    fake.model = {"in_bounds": False}
    assert prepared(fake, place).problems == ("probe: outside the build volume",)


def test_a_part_that_was_not_validated_is_a_problem(fake, place):
    fake.faults["print-validation"] = lambda handler: handler.answer(200, {"per_model_results": {}}) or True
    assert prepared(fake, place).problems == ("probe: PreForm did not validate it",)


def test_a_lost_part_is_a_problem(fake, place):
    fake.faults["auto-layout"] = lambda handler: [s["models"].clear() for s in fake.scenes.values()] and None
    assert prepared(fake, place).problems == ("probe: no longer in the scene",)


def test_progress_is_reported_by_step(fake, place):
    fake.polls, steps = 2, []
    prepared(fake, place, on_progress=lambda step, share: steps.append((step, share)))
    shares = [share for step, share in steps if step == "supports" and share is not None]
    assert shares == pytest.approx([1 / 3, 2 / 3])
    assert steps[0] == ("the version", None)


def test_an_answer_at_once_is_as_good_as_an_operation(fake, place):
    """A server may finish a short call instead of accepting it; the spec allows 200 and 202."""
    fake._of_scene = lambda m, s, rest, body, later: FakePreForm._of_scene(fake, m, s, rest, body, False)
    assert prepared(fake, place).print_time_s == 15120.0


# Which material


@pytest.mark.parametrize(
    ("product", "resin", "material", "label", "code"),
    [
        ("Form 3", "elastic-50a", None, "Elastic 50A V1", "FLELCL01"),
        ("Form 3", "elastic-50a", "elastic 50a v2", "Elastic 50A V2", "FLELCL02"),
        ("Form 3", "elastic-50a", "FLELCL02", "Elastic 50A V2", "FLELCL02"),
        ("Form 3", "flexible-80a", None, "Flexible 80A V2", "FLFL8002"),  # of the same family as the preferred V1
        ("Form 3L", "elastic-50a", None, "Elastic 50A V1", "FLELCL01"),
    ],
)
def test_the_material_is_found_in_preforms_own_list(product, resin, material, label, code):
    chosen = select_settings(MaterialList.model_validate(MATERIALS), product, resin, material)
    assert (chosen.printer, chosen.material) == (product, label)
    assert chosen.scene_settings["material_code"] == code
    assert chosen.scene_settings["layer_thickness_mm"] == 0.1
    assert chosen.scene_settings["print_setting"] != "LEGACY"


@pytest.mark.parametrize(
    ("product", "resin", "material", "message"),
    [
        ("Form 4", "rigid", None, "PreForm knows no Form 4; it has: Form 3/3+, Form 3L"),
        ("Form 3", "silicone-40a", None, "PreForm has no Silicone 40A for a Form 3/3+; --material takes another"),
        ("Form 3", "rigid", "Gray V4", "--material 'Gray V4': PreForm has none for a Form 3/3+; it has: Grey V4"),
        ("Form 3", "rigid", "Draft V1", "Draft V1 on a Form 3/3+: PreForm has no layer of 0.1 mm; it has: 0.3"),
    ],
)
def test_errors_name_what_preform_has(product, resin, material, message):
    with pytest.raises(InputError) as error:
        select_settings(MaterialList.model_validate(MATERIALS), product, resin, material)
    assert message in str(error.value)


def test_every_resin_has_a_name_in_preform():
    assert all(resin.preform_labels for resin in RESINS.values())


def test_a_resin_unknown_to_preform_needs_its_material_named():
    materials = MaterialList.model_validate(MATERIALS)
    with pytest.raises(InputError, match=r"new-resin: .* --material .* it has: "):
        select_settings(materials, "Form 3", "new-resin")
    assert select_settings(materials, "Form 3", "new-resin", "Grey V4").material == "Grey V4"


# Whose files


def test_a_remote_server_gets_its_own_paths(fake, place, tmp_path):
    elsewhere = tmp_path / "other disk"
    shutil.copytree(place, elsewhere)
    fake.root = ("C:\\probes\\thin", elsewhere)
    order = PrintOrder(server_folder="C:\\probes\\thin", form_file="thin.form")
    result = prepared(fake, place, order)
    assert fake.body("import-model")["file"] == "C:\\probes\\thin\\probe.stl"
    assert result.form_file == fake.body("save-form")["file"] == "C:\\probes\\thin\\thin.form"
    assert (elsewhere / "thin.form").is_file() and (elsewhere / "preform-probe.png").is_file()
    assert not (place / "preform-probe.png").exists()


def test_a_remote_server_without_a_folder_is_refused_first(fake, place, capsys):
    assert run(["print", "thin.toml", "--preform", "http://192.0.2.1:44388"]) == 2
    assert "--server-folder names the folder there" in capsys.readouterr().err
    assert run(["print", "thin.toml", "--preform", fake.url, "--server-folder", "probes/thin"]) == 2
    assert "'probes/thin' is not a full path" in capsys.readouterr().err
    assert fake.diary == []


def test_a_file_reported_as_written_must_exist(fake, place):
    fake.writes = False
    with pytest.raises(PreFormError, match="does not exist; if PreForm runs elsewhere, --server-folder"):
        prepared(fake, place)
    assert left_over(place) == [] and fake.scenes == {}


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: (f / "manifest.json").unlink(), "make the parts first: probedesign export"),
        (lambda f: (f / "manifest.json").write_text("[1]"), "is no manifest of an export"),
        (lambda f: (f / "manifest.json").write_text("[" * 100000), "is no manifest of an export"),
        (lambda f: (f / "probe.stl").write_bytes(b"other"), "is not the file of its manifest"),
        (lambda f: (f / "probe.stl").unlink(), "cannot be read: No such file"),
        (lambda f: Path("thin.toml").write_text(DESIGN.replace("80.0", "81.0")), "another geometry, resin or scale"),
        (lambda f: Path("thin.toml").write_text(DESIGN + "[print]\nscale_z = 1.01\n"), "another geometry, resin or"),
        (lambda f: Path("thin.toml").write_text(DESIGN + '[material]\nresin = "silicone-40a"\n'), "another geometry"),
    ],
)
def test_only_the_designs_own_export_is_printed(fake, place, capsys, spoil, message):
    spoil(place)
    assert run(["print", "thin.toml", "--preform", fake.url]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1 and message in captured.err
    assert fake.diary == []


def test_manifest_names_cannot_lead_out_of_the_folder(fake, place):
    manifest = json.loads((place / "manifest.json").read_text())
    manifest["files"]["../../secret.stl"] = manifest["files"]["clamp_ring.stl"]
    (place / "manifest.json").write_text(json.dumps(manifest))
    job = load_job(load_design("thin.toml"), place, "adapters")
    assert sorted(job.sizes) == ["clamp_ring", "sensor_adapter"]


def test_a_part_in_inches_is_detected(fake, place):
    box = {"min_corner": dict.fromkeys("xyz", 0.0), "max_corner": {"x": 482.6, "y": 482.6, "z": 2108.2}}
    fake.model = {"bounding_box": box}
    with pytest.raises(PreFormError, match=r"reads probe as 482\.6 x 482\.6 x 2108\.2 mm; its file has 19\.0 x"):
        prepared(fake, place)


def test_a_tilted_part_is_detected(fake, place):
    box = {"min_corner": dict.fromkeys("xyz", 0.0), "max_corner": {"x": 83.0, "y": 19.0, "z": 19.0}}
    fake.model = {"bounding_box": box}
    with pytest.raises(PreFormError, match="wrong units, or not upright"):
        prepared(fake, place)


def test_an_import_without_a_model_is_detected(fake, place):
    fake._import = lambda scene, body: {}
    with pytest.raises(PreFormError, match="imported probe as 0 models, not one"):
        prepared(fake, place)
    assert fake.scenes == {}


# Faults


def closes(handler):
    handler.close_connection = True
    handler.connection.shutdown(socket.SHUT_RDWR)
    return True


def stops_in_the_headers(handler):
    handler.wfile.write(b"HTTP/1.1 200 OK\r\nContent-Type: application/json")
    return closes(handler)


def stops_after_the_headers(handler):
    handler.wfile.write(b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n")
    return closes(handler)


def stops_half_way(handler):
    handler.wfile.write(b'HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n{"id": "a')
    handler.wfile.flush()
    return closes(handler)


def drips(handler):
    """The server sends a byte of header at intervals without end, so no single read times out."""
    try:
        handler.wfile.write(b"HTTP/1.1 200 OK\r\nX: ")
        while True:
            handler.wfile.write(b"a")
            handler.wfile.flush()
            time.sleep(0.02)
    except OSError:
        handler.close_connection = True
    return True


def sleeps(handler):
    handler.rfile.read(1)  # until the other side gives up
    handler.close_connection = True
    return True


def floods(handler):
    try:
        handler.wfile.write(b"HTTP/1.1 200 OK\r\nContent-Length: 99999999999\r\n\r\n")
        while True:
            handler.wfile.write(bytes(2**20))
    except OSError:
        handler.close_connection = True
    return True


def replies(status, content, kind="application/json"):
    def fault(handler):
        handler.raw(status, content if isinstance(content, bytes) else json.dumps(content).encode(), kind)
        return True

    return fault


def hisses(handler):
    handler.wfile.write(b"SSH-2.0-OpenSSH_9.6\r\n")
    return closes(handler)


HOSTILE = {"error": {"code": "EVIL\x1b[2J", "message": "two\nlines \x1b[31m" + "x" * 5000}}


@pytest.mark.parametrize("step", ["/", "scene", "operations", "print"])
@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (closes, "not to the end"),
        (stops_in_the_headers, "not to the end"),
        (stops_after_the_headers, "not to the end"),
        (stops_half_way, "not to the end"),
        (drips, "not within 0.3 s"),
        (sleeps, "not within 0.3 s"),
        (hisses, "not to the end"),
        (replies(200, b"<html>Printer</html>", "text/html"), "is not PreForm"),
        (replies(200, b"[" * 100_000), "is not PreForm"),
        (replies(200, [1, 2]), "is not PreForm"),
        (replies(302, b""), "with 302 Found; is that PreForm"),
        (replies(500, b"oops"), "with 500 Internal Server Error; is that PreForm"),
        (replies(400, {"error": {"code": "INPUT_ERROR", "message": "Scene type not supported"}}),
         r"PreForm refuses .*: Scene type not supported \(INPUT_ERROR\)"),
        (replies(400, HOSTILE), r"two lines \\x1b\[31mxxx"),
        (replies(400, {"error": 5}), "with 400 Bad Request; is that PreForm"),
    ],
    ids=[
        "closes", "headers", "no-body", "half", "drips", "sleeps", "ssh",
        "html", "deep", "list", "302", "500", "400", "hostile", "odd",
    ],
)  # fmt: skip
def test_faulty_answers_are_one_line_errors(fake, place, step, fault, message):
    fake.faults[step] = fault
    with pytest.raises(PreFormError, match=message) as error:
        prepared(fake, place, PrintOrder(printer="Form3-TestyTest"), timeout_s=0.3)
    text = str(error.value)
    assert text.isprintable() and len(text) < 700
    assert fake.printed == [] and left_over(place) == []


def test_an_answer_without_end_is_not_read(fake, place, monkeypatch):
    monkeypatch.setattr(client, "MAX_REPLY", 2**21)
    fake.faults["list-materials"] = floods
    with pytest.raises(PreFormError, match="is longer than 2097152 bytes"):
        prepared(fake, place)


@pytest.mark.parametrize(
    "answer",
    [
        {"id": "../../devices", "models": []},
        {"id": 5},
        {"models": []},
        {"id": "a", "models": [{"id": "b/c"}]},
        {"id": "a", "models": 3},
    ],
)
def test_ids_that_lead_elsewhere_are_refused(fake, place, answer):
    fake.faults["scene"] = replies(200, answer)
    with pytest.raises(PreFormError, match="is not PreForm: its answer to a new scene: "):
        prepared(fake, place)
    assert fake.calls[-1] == "POST /scene/"


@pytest.mark.parametrize(
    ("state", "message"),
    [
        ({"status": "PAUSED"}, "its answer to the import of probe: status"),
        ({"status": "IN_PROGRESS", "progress": float("nan")}, "progress"),
        ({"status": "FAILED"}, "PreForm fails at the import of probe: no reason stated"),
        ({"status": "FAILED", "result": {"error": {"message": "The mesh is empty"}}}, "of probe: The mesh is empty$"),
        ({"status": "SUCCEEDED", "result": 3}, "result"),
    ],
)
def test_invalid_operation_states_are_errors(fake, place, state, message):
    fake.faults["operations"] = replies(200, state)
    with pytest.raises(PreFormError, match=message):
        prepared(fake, place)
    assert fake.scenes == {}  # cleared up all the same


def test_an_operation_that_the_server_forgot(fake, place):
    fake.faults["operations"] = lambda handler: fake.operations.clear()
    with pytest.raises(PreFormError, match=r"refuses the import of probe: Operation not found \(OPERATION_NOT_FOUND\)"):
        prepared(fake, place)


def test_an_operation_that_does_not_end(fake, place):
    fake.polls = 10**9
    with pytest.raises(
        NoResponseError, match=r"not done with the import of probe after 0\.2 s \(0% done\); --timeout-s"
    ):
        prepared(fake, place, operation_s=0.2)
    assert fake.scenes == {}


@pytest.mark.parametrize("step", ["auto-support", "auto-layout", "estimate-print-time", "save-screenshot", "print"])
def test_an_operation_that_fails_passes_on_preforms_words(fake, place, step):
    fake.failing[step] = {"error": {"code": "NO_ROOM", "message": "It does not fit"}}
    with pytest.raises(PreFormError, match=r"^PreForm fails at .*: It does not fit \(NO_ROOM\)$"):
        prepared(fake, place, PrintOrder(printer="Form3-TestyTest"))
    assert fake.scenes == {} and left_over(place) == []


def forgets(handler):
    """The upload is accepted, but its result is never reported."""
    handler.fake.faults["operations"] = lambda _: handler.fake.operations.clear()


@pytest.mark.parametrize(
    "fault", [closes, replies(200, b"<html>"), replies(502, b"Bad Gateway"), replies(200, {"job_id": 5}), forgets]
)
def test_an_unanswered_upload_has_an_unknown_outcome(fake, place, fault):
    fake.faults["print"] = fault
    with pytest.raises(NoResponseError, match="whether Form3-TestyTest has received the job is unknown"):
        prepared(fake, place, PrintOrder(printer="Form3-TestyTest"))


def interrupt_at(wanted):
    def on_progress(step, share):
        if step == wanted and share is not None:
            raise KeyboardInterrupt

    return on_progress


@pytest.mark.parametrize("step", ["the import of probe", "supports", "a picture", "the form file"])
def test_an_interruption_leaves_neither_files_nor_scenes(fake, place, step):
    before = {p.name for p in place.iterdir()}
    with pytest.raises(KeyboardInterrupt) as interruption:
        prepared(fake, place, PrintOrder(form_file=str(place / "x.form"), printer="X"), on_progress=interrupt_at(step))
    assert not str(interruption.value)
    assert fake.scenes == {} and fake.printed == []
    assert {p.name for p in place.iterdir()} <= before | {"preform-probe.png"}


def test_ctrl_c_in_the_terminal(fake, place):
    fake.polls = 10**9
    command = [sys.executable, "-m", "probedesign.cli.main", "print", "thin.toml", "--preform", fake.url]
    heard = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # ignored in a shell's background
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=heard)
    try:
        while not any(path.startswith("/operations") for _, path, _ in list(fake.diary)):
            assert process.poll() is None, process.communicate()
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert (process.returncode, out, err) == (130, "", "probedesign: error: interrupted\n")
    assert fake.scenes == {} and left_over(place) == []


def test_an_interrupted_upload_names_the_printer(fake, place):
    with pytest.raises(KeyboardInterrupt, match="whether X has received the job is unknown"):
        prepared(fake, place, PrintOrder(printer="X"), on_progress=interrupt_at("the upload"))


# Addresses


@pytest.mark.parametrize(
    "url",
    [
        "localhost:44388", "https://localhost:44388", "http://", "http://a:b", "http://a:99999", "http://[::1",
        "http://me:secret@host", "http://host/scene/", "http://host?x=1", "ftp://host", "", "http://host:0",
    ],
)  # fmt: skip
def test_invalid_addresses_are_refused(url):
    with pytest.raises(InputError, match=r"is not the address of a PreFormServer; write http://localhost:44388$"):
        connection_to(url)


def test_addresses():
    assert connection_to("http://localhost") == Connection("localhost", 44388)
    assert connection_to("http://[::1]:5").url == "http://[::1]:5"
    local = [connection_to(f"http://{h}").local for h in ("localhost", "127.0.0.1", "[::1]", "192.0.2.1", "mac.local")]
    assert local == [True, True, True, False, False]


@pytest.mark.parametrize("host", ["127.0.0.1", "no-such-host.invalid", "a" * 80 + ".invalid", "a..b"])
def test_a_missing_server_error_names_the_start_command(host):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # bound and not listening: no other process takes the port meanwhile
        port = taken.getsockname()[1]
        with pytest.raises(NoResponseError, match=rf"no server responds .*; start it: PreFormServer --port {port}$"):
            Connection(host, port, 5.0).request("the version", "GET", "/")


def test_environment_proxies_are_ignored(fake, place, monkeypatch):
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:9")
    assert prepared(fake, place).api == "0.9.7"


# The command


def test_the_command_prints_its_outcome(fake, place, capsys):
    fake.polls = 0
    assert run(["print", "thin.toml", "--preform", fake.url, "--save-form", "exports/thin.form"]) == 0
    out = capsys.readouterr().out
    for piece in (
        "PreForm (API 0.9.7)",
        "Elastic 50A V1 on a Form 3, 0.100 mm (Default settings)",
        "12.3 ml with supports",
        "4 h 12 min",
        "no problems",
        "no; send it with --send PRINTER",
        str(place / "preform-probe.png"),
    ):
        assert piece in out
    assert Path("exports/thin.form").read_bytes() == b"form" and fake.printed == []


def test_the_commands_json(fake, place, capsys):
    fake.polls = 0
    assert run(["print", "thin.toml", "--preform", fake.url, "--send", "Form3-TestyTest", "--json"]) == 0
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    assert captured.err == ""
    assert document["ok"] and (document["sent_to"], document["job_id"]) == ("Form3-TestyTest", "4711")
    assert document["print_time_s"] == 15120.0 and document["scene_settings"]["material_code"] == "FLELCL01"


def test_the_command_fails_on_problems_unless_forced(fake, place, capsys):
    fake.validation |= {"unsupported_minima": 1}
    fake.polls = 0
    arguments = ["print", "thin.toml", "--preform", fake.url, "--send", "Form3-TestyTest"]
    assert run(arguments) == 1
    assert "validation found problems; --force sends it anyway" in capsys.readouterr().out
    assert fake.printed == []
    assert run([*arguments, "--force"]) == 0
    assert len(fake.printed) == 1


def test_a_design_that_the_check_refuses_does_not_reach_preform(fake, place, capsys):
    Path("thin.toml").write_text(DESIGN.replace("tip_d_mm = 2.0", "tip_d_mm = 1.2"))
    assert run(["print", "thin.toml", "--preform", fake.url]) == 2
    assert "the print check found errors: probe: minimum thickness" in capsys.readouterr().err
    assert fake.diary == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--save-form", "x.stl"], "PreForm's files end in .form"),
        (["--save-form", "none/x.form"], "there is no folder"),
        (["--save-form", "there.form"], "exists already; --force replaces it"),
        (["--send", " "], "is not the name of a printer"),
        (["--send", "a\nb"], "is not the name of a printer"),
        (["--timeout-s", "nan"], "--timeout-s nan is out of range"),
        (["--timeout-s", "0"], "--timeout-s 0 is out of range"),
        (["--parts", "all"], "--parts"),
        (["--material", "Gray V4"], "it has: Grey V4"),
    ],
)
def test_wrong_options_are_one_line(fake, place, capsys, options, message):
    Path("there.form").write_text("mine")
    assert run(["print", "thin.toml", "--preform", fake.url, *options]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1 and message in captured.err
    assert Path("there.form").read_text() == "mine" and fake.printed == []


def test_milled_parts_are_not_printed(fake, place):
    """No request reaches PreForm; the soft probe is printed as before."""
    Path("thin.toml").write_text(DESIGN + '[mount]\nadapters = "milled"\n')
    assert run(["print", "thin.toml", "--parts", "adapters", "--preform", fake.url]) == 2
    with pytest.raises(InputError, match="milled"):
        prepared(fake, place, PrintOrder("adapters"))
    assert prepared(fake, place).parts == ("probe",)
