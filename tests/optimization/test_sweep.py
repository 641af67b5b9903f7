"""Parameter sweep: grid, journal, resumption after an interruption, invalid designs."""

import csv
import json
import sys
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.core.parallel import Journal
from probedesign.design import check_design, load_design
from probedesign.design.catalog import RESINS
from probedesign.design.edit import tables_of, with_values
from probedesign.optimization import sweep
from probedesign.optimization.design_space import DesignSpace
from probedesign.optimization.objective import Task
from probedesign.optimization.sweep import evaluate_point, grid_points, parse_axis
from probedesign.probe import build_probe
from probedesign.studio.session import Session

LARGE = Path(__file__).parents[2] / "designs/large.toml"
REQUEST = {"schema": 1, "vary": {"a": [1, 2]}}


def test_the_end_of_a_range_counts_in_spite_of_rounding_and_every_combination_once():
    assert parse_axis("probe.tip_d_mm=1.5:2.1:0.1")[1] == (1.5, 1.6, 1.7, 1.8, 1.9, 2.0, 2.1)
    assert parse_axis("sensor.averaging_samples=36:72:36")[1] == (36, 72)
    assert parse_axis("sensor.calibration=si-12-0.12, si-25-0.25")[1] == ("si-12-0.12", "si-25-0.25")
    grid = grid_points([parse_axis("probe.tip_d_mm=1:3:1"), parse_axis("probe.base_d_mm=8,12")])
    assert len({tuple(point.items()) for point in grid}) == len(grid) == 6


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("probe.tipd_mm=1:2:1", "did you mean 'probe.tip_d_mm'?"),
        ("probe.tip_d_mm=2:1:0.5", "wrong sign"),
        ("probe.tip_d_mm=1:2", "not START:STOP:STEP"),
        ("probe.tip_d_mm=nan:2:1", "not START:STOP:STEP"),
        ("probe.tip_d_mm=1:2:1e-9", "coarser step"),
        ("probe.tip_d_mm", "write KEY="),
        ("probe.tip_d_mm=1,,2", "empty value"),
    ],
)
def test_an_invalid_range_is_refused(text, message):
    with pytest.raises(InputError, match=message.replace("?", r"\?")):
        parse_axis(text)


def test_a_key_is_varied_and_no_other_and_another_body_has_assumed_moduli():
    """What was identified on the paper's prints says nothing of a print of another body."""
    base = tables_of(load_design(LARGE))
    changed = with_values(base, {"probe.tip_d_mm": 3.0})
    assert changed["probe"].pop("tip_d_mm") == 3.0
    provenance = changed["material"].pop("provenance")
    assert provenance == base["material"]["provenance"] | dict.fromkeys(
        ("youngs_modulus_mpa", "shear_modulus_mpa"), "assumed"
    )
    assert changed == base | {
        "probe": {k: v for k, v in base["probe"].items() if k != "tip_d_mm"},
        "material": {k: v for k, v in base["material"].items() if k not in ("provenance", "identified_tests")},
    }
    assert with_values(base, {"contact.friction": 0.4})["material"] == base["material"]
    space = DesignSpace.of(load_design(LARGE), ("cone",))
    assert space.design(1.1 * space.x_of(space.start)).youngs_modulus.provenance == "assumed"


def test_designs_that_are_invalid_buckle_or_overload_the_sensor_give_a_reason():
    """20 N near the base: the probe is stable, the range of 12 N is exceeded."""
    base = tables_of(load_design(LARGE))
    refused = evaluate_point(base, 0, {"probe.tip_d_mm": 13.0}, Task())
    limp = evaluate_point(base, 1, {"probe.base_d_mm": 2.0}, Task())
    rigid = base | {"contact": {"object_compliance_m_N": 0.0}}  # 20 N move any other far away
    heavy = evaluate_point(rigid, 2, {}, Task((20.0,), fractions=(0.1,)))
    assert refused["result"] == "refused" and "wider than base_d_mm" in refused["reason"]
    assert limp["result"] == "gives_way" and limp["error_mm"] is None and limp["mass_g"] > 0.0
    assert heavy["result"] == "out_of_range" and heavy["sensor_use"] > 1.0 and "range" in heavy["reason"]


def journal_of(path: Path, records: int) -> bytes:
    with Journal.open(path, REQUEST).appending() as appender:
        for i in range(records):
            appender.add({"point": i, "error_mm": float(i)})
    return path.read_bytes()


def test_an_incomplete_record_is_dropped_and_complete_ones_are_kept(tmp_path):
    path = tmp_path / "sweep.jsonl"
    whole = journal_of(path, 2)
    for cut in range(1, len(whole.splitlines(keepends=True)[-1])):
        path.write_bytes(whole[:-cut])
        journal = Journal.open(path, REQUEST)
        assert sorted(journal.results) == [0] and "incomplete" in journal.notes[0]
        with journal.appending() as appender:
            appender.add({"point": 1, "error_mm": 1.0})
        assert path.read_bytes() == whole


def test_results_of_another_sweep_and_corrupt_lines_are_refused_unchanged(tmp_path):
    path = tmp_path / "sweep.jsonl"
    content = journal_of(path, 3)
    with pytest.raises(InputError, match="another run"):
        Journal.open(path, REQUEST | {"vary": {"b": [1]}})
    lines = content.splitlines(keepends=True)
    for rubbish in (b"rubbish\n", b'{"point": "one"}\n'):
        broken = b"".join([lines[0], rubbish, *lines[2:]])
        path.write_bytes(broken)
        with pytest.raises(InputError, match="line 2 is not a record"):
            Journal.open(path, REQUEST)
        assert path.read_bytes() == broken


def test_a_sweep_resumes(tmp_path, capsys):
    """Two workers, one lost record, one design that cannot be: nothing is computed twice."""
    command = ["sweep", str(LARGE), "--vary", "probe.tip_d_mm=2,13", "--vary", "probe.base_d_mm=7:12:5",
               "--at", "0.8", "--workers", "1", "--out", str(tmp_path), "--json"]  # fmt: skip
    assert run(command) == 0
    first = json.loads(capsys.readouterr().out)
    path = tmp_path / "sweep.jsonl"
    path.write_bytes(path.read_bytes()[:-7])
    assert run(command) == 0
    out, err = capsys.readouterr()
    again = json.loads(out)
    assert first["computed"] == 4 and again["computed"] == 1 and "incomplete" in err
    assert again["points"] == first["points"]
    assert [p["result"] for p in again["points"]] == ["ok", "ok", "refused", "refused"]
    with (tmp_path / "sweep.csv").open() as table:
        errors = [row["error_mm"] for row in csv.DictReader(table)]
    assert errors == ["" if p["error_mm"] is None else str(p["error_mm"]) for p in first["points"]]


def test_without_the_extra_a_sweep_writes_its_csv_and_no_scheduler_is_reached(tmp_path, capsys, monkeypatch):
    for name in ("dask", "distributed"):
        monkeypatch.setitem(sys.modules, name, None)  # importing it fails
    command = ["sweep", str(LARGE), "--vary", "probe.tip_d_mm=13,14", "--workers", "1", "--out", str(tmp_path)]
    assert run(command) == 0
    assert (tmp_path / "sweep.csv").exists()
    assert run([*command[:-1], str(tmp_path / "other"), "--scheduler", "tcp://127.0.0.1:9"]) == 2
    assert "pip install" in capsys.readouterr().err


def test_a_worker_that_is_killed_is_one_line_and_loses_nothing(tmp_path, capsys, monkeypatch):
    def broken(*_, **__):
        yield 0, [sweep.evaluate_point({}, 0, {"probe.tip_d_mm": 13}, Task())]
        raise BrokenProcessPool

    monkeypatch.setattr(sweep, "process_map", broken)
    command = ["sweep", str(LARGE), "--vary", "probe.tip_d_mm=13,14", "--workers", "2", "--out", str(tmp_path)]
    assert run(command) == 2
    assert "fewer workers" in capsys.readouterr().err
    assert len((tmp_path / "sweep.jsonl").read_text().splitlines()) == 2  # the request and one result


def test_an_unreachable_scheduler_is_refused(tmp_path, capsys, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("probedesign.optimization.sweep.SCHEDULER_TIMEOUT_S", 1.0)
    command = ["sweep", str(LARGE), "--vary", "probe.tip_d_mm=2,3", "--out", str(tmp_path / "new"),
               "--scheduler", "tcp://127.0.0.1:9"]  # fmt: skip
    assert run(command) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "tcp://127.0.0.1:9: does not respond" in err
    assert not (tmp_path / "new").exists()


def test_another_resin_brings_its_numbers_to_a_sweep_and_to_the_studio():
    """The numbers that the file states are those of its own resin; a number varied beside the resin is kept."""
    design = load_design(LARGE)
    assert design.material.youngs_modulus_mpa and design.material.density_kg_m3
    tables, change = tables_of(design), {"material.resin": "flexible-80a"}
    swept = check_design(with_values(tables, change))
    session = Session(design)
    assert session.change(change, now=0.0) and session.design == swept
    resin = RESINS["flexible-80a"]
    for name in ("youngs_modulus", "shear_modulus", "density", "friction"):
        assert getattr(swept, name).value == pytest.approx(getattr(resin, name).value, rel=1e-8)
    stiffer = check_design(with_values(tables, {"material.youngs_modulus_mpa": 7.0, **change}))
    assert stiffer.material.youngs_modulus_mpa == 7.0 and stiffer.density == swept.density
    assert with_values(tables, {"material.resin": design.material.resin}) == tables


def test_what_was_measured_of_a_resin_does_not_hold_for_another():
    """Tests, spreads, tolerances of the material, coupon and calipers belong to the former resin and its print."""
    tables = tables_of(load_design(LARGE))
    tables["probe"]["measured"] = ["tip_d_mm"]
    tables["material"] |= {"identified_tests": ["01234567"], "stiffness_spread": 0.004, "creep_spread": 0.002}
    tables["print"] |= {"scale_xy": 1.01, "scale_z": 1.02, "rigid_scale_xy": 1.03}
    of_the_print = {"youngs_modulus": 0.004, "shear_modulus": 0.02, "youngs_modulus_by_diameter": -3.9,
                    "density": 0.001, "creep": 0.002, "stiffness_scatter": 0.002, "diameter_mm": 0.02}  # fmt: skip
    of_the_bench = {"gravity_deg": 0.1, "gain": 0.001, "root_radii": 0.05}
    tables["tolerances"] |= of_the_print | of_the_bench
    change = {"material.resin": "flexible-80a", "material.creep_spread": 0.03}
    session = Session(check_design(tables))
    assert session.change(change, now=0.0) and session.design == check_design(with_values(tables, change))
    material, print_ = session.design.material, session.design.print_
    assert (material.identified_tests, material.stiffness_spread, material.creep_spread) == ((), None, 0.03)
    assert (print_.scale_xy, print_.scale_z, print_.rigid_scale_xy) == (1.0, 1.0, 1.03)
    assert session.design.probe.measured == ()
    assert session.design.tolerances.model_dump(exclude_none=True) == of_the_bench
    assert build_probe(session.design).tolerances.youngs_modulus == RESINS["flexible-80a"].stiffness_spread.value


def test_measured_diameters_hold_for_their_print_only():
    """A changed dimension is that of another print, with the tolerances of its resin; a stated one is kept."""
    tables = tables_of(load_design(LARGE))
    tables["probe"]["measured"] = ["base_d_mm", "tip_d_mm"]
    tables["tolerances"] |= {"diameter_mm": 0.02, "diameter_scatter_mm": 0.03, "length_mm": 0.2}
    same = with_values(tables, {"probe.base_d_mm": tables["probe"]["base_d_mm"], "contact.friction": 0.3})
    assert same["probe"]["measured"] and same["tolerances"] == tables["tolerances"]
    other = with_values(tables, {"probe.base_d_mm": 11.0, "tolerances.diameter_mm": 0.05})
    assert "measured" not in other["probe"]
    kept = {k: v for k, v in tables["tolerances"].items() if not k.startswith("diameter")}
    assert other["tolerances"] == {**kept, "diameter_mm": 0.05}
    space = DesignSpace.of(check_design(tables), ("cone",))
    best = space.design(space.x_of(space.start))
    assert not best.probe.measured and best.tolerances.diameter_mm is None
