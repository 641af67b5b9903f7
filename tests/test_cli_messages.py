"""Wording of the commands: one transcript with a success and a refusal of each, the numbers masked.

Other tests check exit statuses, codes and numbers. `python -m tests.test_cli_messages` writes the transcript anew.
"""

import contextlib
import io
import platform
import re
import shlex
import sys
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import pytest

from probedesign.cli.main import NAMES, run
from probedesign.core.errors import MissingDependencyError

TRANSCRIPT = Path(__file__).parent / "data/cli_messages.txt"
SCRIPT = """\
new a --length 150 --base-d 12
new a --length 150 --base-d 12
new b --length 100 --base-d 10 --tip-d 2
studio designs/a.toml --no-open
studio designs/none.toml
check designs/a.toml
check designs/none.toml
export designs/a.toml
export designs/none.toml
coupon designs/a.toml
coupon designs/none.toml
measured designs/b.toml calipers.csv --out designs/measured.toml
measured designs/a.toml calipers.csv
predict designs/a.toml
predict
compare designs/a.toml designs/b.toml --at 0.8 --touches 1
compare designs/a.toml designs/b.toml --out designs/a.toml
sweep designs/a.toml --vary probe.length_mm=100,120
sweep designs/a.toml --vary probe.length_mm=100,120 --workers 0
optimize designs/a.toml --at 0.8 --touches 1 --over length
optimize designs/a.toml --at 0.8 --touches 1 --over length
advise soft --force-mN 1 --reach-mm 40 --points down
advise soft --force-mN 1 --reach-mm 40
deploy designs/a.toml
deploy designs/a.toml --out designs/a.toml
twin designs/a.toml
twin designs/a.toml --format stl
campaign designs/a.toml data --stage
campaign designs/a.toml data --stage
plan designs/a.toml bench --minutes 60 --for E
plan designs/a.toml bench --minutes 60 --for E
identify designs/a.toml data --for E
identify designs/a.toml data --for E,densty
deploy designs/a.toml
identify designs/a.toml data --for E --out designs/c.toml
validate exports/a/a.probe.json data
validate exports/a/a.probe.json
live exports/a/a.probe.json --source "sim:?speed=max&rate_hz=50&seconds=2" --record run.csv --count 3
live exports/a/a.probe.json --source "sim:?speed=max&rate_hz=50&seconds=2" --record run.csv --count 3
live exports/a/a.probe.json --source "sim:?speed=max&rate_hz=50&seconds=2" --record run.mcap --count 1
calibrate exports/a/a.probe.json --source "sim:?orientations=6&speed=max"
calibrate exports/a/a.probe.json --source "sim:?orientations=6&speed=max"
estimate exports/a/a.probe.json run.csv --out estimates.csv
estimate exports/a/a.probe.json run.csv --out run.csv
estimate exports/a/a.probe.json run.csv --page run.html
estimate exports/a/a.probe.json run.csv --page run.html --out run.html
explore exports/a/a.probe.json run.csv --pose poses.csv --tare-s 0:0.5 --out map
explore exports/a/a.probe.json run.csv --pose poses.csv
recover run.mcap
recover run.csv
markers data --no-overlays
markers data --base-side middle
simulate exports/a/a.probe.json --port 0 --http-port 0 --scene free --seconds 0.1
simulate exports/a/a.probe.json --seconds 0
demo --out demo
demo --out designs
doctor
doctor --sjon
"""


def manifest() -> dict[str, object]:
    """Return what `export` prints of a manifest."""
    return {
        "folder": "exports/a", "files": ["probe.stl", "probe.3mf", "assembly.step", "assembly.html", "parts.csv"],
        "fingerprint": "dbfe02e41516", "mass": {"whole": {"mass_kg": 0.0201}},
        "T_sensor_base": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.0156], [0, 0, 0, 1]],
        "verification": {"volume": {"ok": True}, "mass": {"ok": False}},
        "assumptions": ["density of the steel parts"],
        "print_scale": {"probe": [1.01, 1.01, 1.02], "adapter": [1.0, 1.0, 1.0]},
        "print_check": {
            "findings": [{"severity": "warning", "message": "the tip is thin"}],
            "orientation": {"clamp_ring": {"side": "upright", "rests_on": "its underside", "supports": False}},
        },
        "tolerance_stacks": [{"what": "compression of the lip", "ok": True}],
        "screws": [{"count": 4, "screw": "M2x10", "into": "the sensor", "entry_mm": 2.5, "entry_allowed_mm": [2, 3]}],
    }  # fmt: skip


def replace_slow_and_local_parts(patch: pytest.MonkeyPatch) -> None:
    """Replace CAD, worker processes, photographs and the list of installed packages by fixed results."""
    from probedesign.campaigns import photographs
    from probedesign.cli import doctor
    from probedesign.optimization import sweep
    from probedesign.optimization.objective import METRICS

    good = {"probe.length_mm": 100.0, "error_mm": 14.4, "detectable_mN": 0.28, "sag_mm": 2.6, "print_errors": 0}
    bad = {"probe.length_mm": 120.0, "result": "refused", "reason": "too slender"}
    records = [
        dict.fromkeys(METRICS, 1.0) | {"point": 0, "result": "ok", "reason": ""} | good,
        dict.fromkeys(METRICS) | {"point": 1} | bad,
    ]
    swept = sweep.SweepResult(records, 1, [Path("sweep.csv")], ["a record was dropped"])
    patch.setattr(sweep, "sweep", lambda *_: swept)
    found = SimpleNamespace(pixels=range(14), dark=True, std_px=SimpleNamespace(max=lambda: 0.1))
    tests = [
        SimpleNamespace(test="touch-01", found=[found, found], problem="", residual_px=0.11),
        SimpleNamespace(test="touch-02", found=[], problem="overexposed"),
    ]
    patch.setattr(photographs, "find_all", lambda *_: (tests, ["camera left: 20 control points"]))
    patch.setattr(photographs, "write_pixels", lambda data, *_: data / "pixels.csv")
    patch.setattr("probedesign.studio.page.StudioPage.wait", lambda _: None)
    patch.setattr(metadata, "version", lambda name: missing() if name == "mcap" else "1.0")
    patch.setattr(platform, "machine", lambda: "machine")
    patch.setattr(platform, "system", lambda: "System")
    patch.setattr(metadata, "requires", lambda _: ["numpy>=2", "mcap>=1; extra == 'live'"])
    patch.setattr(
        doctor, "_numba_cache", lambda: {"folder": "cache", "writable": False, "processor": "cpu", "kernels": 3}
    )


def missing() -> str:
    raise metadata.PackageNotFoundError("mcap")


def replace_export(patch: pytest.MonkeyPatch) -> None:
    """Replace the export of parts."""
    from probedesign import cad
    from probedesign.cli import demo

    reasons = [str(MissingDependencyError.of_extra("export", "CadQuery", "cad")), "explore needs mcap"]
    numbers = {"located": 9, "touches": 10, "error_mm": 1.0, "predicted_mm": 1.0}
    made = {"skipped": reasons, "made": ["a", "b"], "page": "demo/index.html", **numbers}
    whole = demo.run_demo
    patch.setattr(demo, "run_demo", lambda folder, *_: made if str(folder) == "demo" else whole(folder, *_))
    patch.setitem(vars(cad), "export_parts", lambda *_: manifest())  # setattr would import CadQuery
    coupon = {
        "folder": "exports/a/coupon", "files": ["calipers.csv", "coupon.step"], "steps_mm": [12.0, 2.0],
        "step_height_mm": 8.0, "rod_mm": [7.0, 70.0],
    }  # fmt: skip
    patch.setitem(vars(cad), "export_coupon", lambda *_: coupon)


def masked(text: str) -> list[str]:
    """Return the lines that have words: numbers as #, no repeated spaces or lines, no rows that begin with numbers."""
    text = re.sub(r"\b(?=\w*\d)[0-9a-f]{8}(?:[0-9a-f]{4})?\b", "FINGERPRINT", text)
    text = text.replace(str(Path.cwd()), "HERE")
    text = re.sub(r"(<|(?<![\w.-])[-+])?\d+(\.\d+)*(e[-+]\d+)?", "#", text)
    lines = [" ".join(line.split()) for line in text.splitlines()]
    return list(dict.fromkeys(line for line in lines if re.search(r"^(?!# #).*[A-Za-z]{2}", line)))


def transcript(patch: pytest.MonkeyPatch) -> str:
    """Run the script in the current folder and return what the commands print."""
    replace_slow_and_local_parts(patch)
    replace_export(patch)
    rows = "".join(f"{0.02 * i:.2f},0,0,0,0,0,0,1\n" for i in range(300))
    Path("poses.csv").write_text(f"time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw\n{rows}")
    Path("calipers.csv").write_text("s_mm,diameter_mm\n20,8.42\n50,6.05\n80,3.42\n")
    blocks = []
    for line in SCRIPT.splitlines():
        arguments = shlex.split(line)
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = run(arguments)
        printed = [*masked(out.getvalue()), *(f"stderr: {text}" for text in masked(err.getvalue()))]
        blocks.append("\n".join([f"$ probedesign {line}", *printed, f"status {status}"]))
    return "\n\n".join(blocks) + "\n"


def test_each_command_prints_the_words_of_the_transcript(tmp_path, monkeypatch):
    pytest.importorskip("mcap")
    monkeypatch.chdir(tmp_path)
    assert transcript(monkeypatch).splitlines() == TRANSCRIPT.read_text(encoding="utf-8").splitlines()


def test_the_transcript_has_a_success_and_a_refusal_of_each_command():
    statuses = {(block.split()[2], int(block.split()[-1])) for block in TRANSCRIPT.read_text("utf-8").split("\n\n")}
    assert statuses == {(name, status) for name in NAMES for status in (0, 2)}


if __name__ == "__main__":
    import os
    import tempfile

    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as monkeypatch:
        os.chdir(folder)
        TRANSCRIPT.write_text(transcript(monkeypatch), encoding="utf-8")
        sys.stdout.write(TRANSCRIPT.read_text(encoding="utf-8"))
