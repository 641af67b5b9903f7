"""Data folder of a plan: tables with the planned tests, which a laboratory fills, and a checklist for the bench."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.campaigns.campaign import MARKERS, TESTS, WRENCHES
from probedesign.campaigns.manifest import manifest_lines, number_list
from probedesign.campaigns.reading import IMAGES, PIXELS
from probedesign.core import csv_tables
from probedesign.core.errors import InputError
from probedesign.core.files import check_replaceable, check_writable, replaced_folder
from probedesign.core.units import MM
from probedesign.planning.candidates import READINGS, STD_MARK, CandidateTest
from probedesign.planning.plan import Plan
from probedesign.simulation.ground_truth import marker_arclengths

PLAN, PAGE, CHECKLIST = "plan.json", "plan.html", "README.md"
COLUMNS = ("test", "force_x_world_N", "force_y_world_N", "force_z_world_N", "s_contact_mm", "std_s_mm",
           "contact_x_world_mm", "contact_y_world_mm", "contact_z_world_mm", "std_contact_mm", "direction",
           "base_x_world_mm", "base_y_world_mm", "base_z_world_mm", "base_rx_world_deg", "base_ry_world_deg",
           "base_rz_world_deg", "use", "note")  # fmt: skip
WRENCH_HEADER = "# frame: sensor\ntest,time_s,Fx_N,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm\n"
MARKER_COLUMNS = "test,marker,x_world_mm,y_world_mm,z_world_mm"


def tables(plan: Plan) -> dict[str, str]:
    """Return the tables of the data folder by name, with a row for each planned test."""
    rows = [_row(candidate) for candidate in plan.candidates if candidate.test is not None]
    model, bench = plan.bench.model, plan.bench
    lines = manifest_lines(
        "Planned by `probedesign plan`. Correct what differs on your bench; README.md says how.",
        model, bench.T_world_base(model.gravity_base), bench.instruments.std_base, bench.gravity_world,
    )  # fmt: skip
    if bench.instruments.cameras is not None:
        s = np.array(marker_arclengths(model.rod.length)) / MM
        lines += ["", "[markers]                   # marker 1 is the nearest to the base", f"s_mm = {number_list(s)}",
                  "# side_deg = -110.0         # where the dots are on the surface; absent: on the axis",
                  f"std_mm = {bench.instruments.cameras / MM:g}"]  # fmt: skip
    if any(candidate.set_up == "weighing" for candidate in plan.candidates) and bench.instruments.balance is not None:
        lines += ["", "# [weighing]                # after weighing, remove the # of these lines",
                  "# mass_g =", f"# std_g = {1e3 * bench.instruments.balance:g}",
                  '# of = "probe"              # with its printed flange; "flexible": the soft part alone']  # fmt: skip
    manifest = "\n".join([*lines, "", "[source]", 'by = ""', ""])
    return {"campaign.toml": manifest, TESTS: csv_tables.write(COLUMNS, rows).decode(), WRENCHES: WRENCH_HEADER}


def _row(candidate: CandidateTest) -> dict[str, str]:
    """Return the row of a planned test: what is set beforehand; what is measured stays empty."""
    test = candidate.test
    assert test is not None
    row = {"test": test.name, "direction": test.direction, "use": test.use, "note": candidate.words}
    if test.force_world is not None:
        row |= {f"force_{axis}_world_N": f"{value + 0.0:.6g}"
                for axis, value in zip("xyz", test.force_world, strict=True)}  # fmt: skip
    if np.isfinite(test.s_contact):
        row |= {"s_contact_mm": f"{test.s_contact / MM:.2f}", "std_s_mm": f"{test.std_s / MM:.2g}"}
    if test.force_world is None:
        row["std_contact_mm"] = f"{test.std_contact / MM:g}"
    if candidate.set_up == "turned":
        T = test.T_world_base
        values = [*T[:3, 3] / MM, *np.degrees(Rotation.from_matrix(T[:3, :3]).as_rotvec())]
        row |= {name: f"{value + 0.0:.4f}" for name, value in zip(COLUMNS[11:17], values, strict=True)}
    return row


# the bench


def checklist(plan: Plan, folder: str) -> list[tuple[str, list[str]]]:
    """Return the steps at the bench: headings with their lines; `folder` is named by the commands at the end."""
    kinds = {candidate.set_up for candidate in plan.candidates}
    model = plan.bench.model
    marks = sorted({candidate.mark for candidate in plan.candidates if np.isfinite(candidate.mark)})
    before = [f"Check that the part bears the fingerprint {model.fingerprint}."]
    if marks:
        before.append(f"Draw marks around the probe at s = {', '.join(f'{s / MM:g}' for s in marks)} mm from the base, "
                      f"each to {STD_MARK / MM:g} mm, measured along the straight probe.")  # fmt: skip
    if "weighing" in kinds:
        before.append("Weigh the printed probe with its flange, and write [weighing] in campaign.toml.")
    if "calipers" in kinds:
        std = plan.bench.instruments.calipers or 0.0
        before.append("Measure the diameter at the base and at each mark twice, at a right angle, and write the "
                      "readings into calipers.csv with the columns s_mm, diameter_mm and std_mm. Then `probedesign "
                      f"measured DESIGN calipers.csv --calipers-std-mm {std / MM:g} --out MEASURED.toml`, which is "
                      "used below, and remove fingerprint from campaign.toml: the measured geometry has another "
                      "one.")  # fmt: skip
    mount = [
        "Zero the sensor before the probe is mounted. Switch it on half an hour before.",
        "Measure the pose of the base in the frame of the stage or cameras, and write [base] in campaign.toml. "
        "std_mm and std_deg are one standard deviation of this measurement; an error of 0.2° moves the tip of this "
        f"probe by {np.radians(0.2) * model.rod.length / MM:.1f} mm.",
        "The base's z axis points from the base to the tip, its x axis to the clocking mark of the flange.",
    ]
    each = [
        f"Wait until the reading is still (1 minute after a change), then take {READINGS} readings, each the mean of "
        f"{model.averaging_samples} samples, with their time_s, and append them to wrenches.csv.",
        "Write the reading as the sensor shows it and keep the line `# frame: sensor`. A wrench is what the probe does "
        "to its mount: with a probe that hangs free, the force has the direction of gravity.",
    ]
    if "weight" in kinds:
        each.append("Weight: write the mass on the balance times 9.81 m/s² with a minus sign into force_z_world_N. "
                    "The thread lies on the mark, and s_contact_mm is the mark.")  # fmt: skip
    if "touch" in kinds:
        each.append("Touch: push with an edge at the mark, read the place of the touched point on the surface from the "
                    "stage, and write contact_x/y/z_world_mm. The direction is where the object moves. s_contact_mm "
                    "is where the force's line meets the axis: nearer to the base than the mark by r·tan α, with "
                    "r the radius and α the half angle of the cone. It is written already.")  # fmt: skip
    if "turned" in kinds:
        each.append("Turned base: write the measured pose into the six base columns of the test.")
    if plan.bench.instruments.cameras is not None:
        each.append(f"Markers: write their places into {MARKERS} with the columns {MARKER_COLUMNS}; or photograph "
                    "them with calibrated cameras (docs/stereo.md).")  # fmt: skip
    held_out = [candidate.name for candidate in plan.candidates if candidate.held_out]
    if held_out:
        each.append(f"{', '.join(held_out)}: measure them like the others. identify leaves them out, and validate "
                    "judges the probe by them.")  # fmt: skip
    each.append("A test that failed or was not made: leave its row without readings; identify then ignores it.")
    names, design = ",".join(plan.identified), "MEASURED.toml" if "calipers" in kinds else "DESIGN"
    after = [
        f"probedesign identify {design} {folder} --for {names} --out IDENTIFIED.toml",
        "probedesign deploy IDENTIFIED.toml --out PROBE.probe.json",
        f"probedesign validate PROBE.probe.json {folder}",
    ]
    return [("Before mounting", before), ("Mounting", mount), ("Each test, in the order of tests.csv", each),
            ("Afterwards", after)]  # fmt: skip


def checklist_text(plan: Plan, folder: str) -> str:
    """Return the checklist as Markdown."""
    summary = f"{len(plan.tests)} measurements in {plan.tests[-1].minutes:.0f} minutes; {PAGE} shows each set-up."
    lines = [f"# Campaign of {plan.bench.model.name}", "", summary]
    for heading, steps in checklist(plan, folder):
        lines += ["", f"## {heading}", "", *(f"- [ ] {step}" for step in steps)]
    return "\n".join([*lines, ""])


# writing


def check_target(folder: Path, force: bool) -> None:
    """Refuse a folder that exists; with `force` replace a plan without measured values, and nothing else.

    Raises:
        InputError: the folder must not be replaced, or cannot be written.
    """
    check_writable(folder)
    check_replaceable(folder, PLAN, "plan", force)
    for name, empty in ((WRENCHES, WRENCH_HEADER), (MARKERS, ""), (PIXELS, ""), (IMAGES, "")):
        path = folder / name
        if path.exists() and (path.is_dir() or path.read_bytes().split() != empty.encode().split()):
            raise InputError(f"{folder}: {name} has measured values, which are not replaced; name another folder")


def write_folder(folder: Path, contents: Sequence[tuple[str, bytes]], force: bool) -> list[Path]:
    """Write the data folder, atomically, and return its files.

    Raises:
        InputError: as `check_target`.
    """
    check_target(folder, force)
    with replaced_folder(folder) as draft:
        for name, content in contents:
            (draft / name).write_bytes(content)
    return [folder / name for name, _ in contents]
