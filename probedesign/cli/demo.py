"""`probedesign demo`: run the whole chain on a built-in example, from a few dimensions to located contacts."""

import contextlib
import io
import json
import subprocess
import sys
import webbrowser
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from probedesign.cli.console import print_json, print_step, write_files
from probedesign.cli.options import JsonOutput
from probedesign.cli.predict import prediction_files
from probedesign.core.errors import InputError, MissingDependencyError, require
from probedesign.core.files import exports_of
from probedesign.reports.html_page import REPORT_STYLE, labelled

if TYPE_CHECKING:
    from probedesign.estimation.estimator import Estimator
    from probedesign.live.run import RecordingEstimates
    from probedesign.probe import Probe

NAME = "demo"
#: Heading and command of each section of the page.
SECTIONS = {
    "whisker": ("A curved probe locates lighter touches",
                "probedesign compare {folder}/demo.toml {folder}/whisker.toml --touches 1"),
    "estimate": ("A simulated touch, located and replayed",
                 "probedesign estimate {folder}/demo.probe.json {folder}/recording.csv --page {folder}/touches.html"),
    "explore": ("A card house, found by touch",
                "probedesign explore {folder}/demo.probe.json --rehearse {folder}/rehearsal"),
}  # fmt: skip
#: Time without contact at the start of a rehearsal, as in docs/exploring.md, and samples of one reading: 49 a second.
TARE, AVERAGE = "0.5:3.5", 72
#: Simulated contact: 20 mN, swept along the probe and back, with the sensor's noise.
TOUCH = "force_mN=20&seconds=20&rate_hz=10&speed=max"

DEMO_STYLE = """code { overflow-wrap: anywhere; font-size: 13px; color: var(--soft) }
.links a { margin-right: 16px } .waiting { font-style: italic } .figures { margin: 32px 0 }
section img { max-width: 100%; background: #fff }
"""


def demo(
    *,
    out: Path | None = None,
    force: bool = False,
    open_: Annotated[bool, Parameter(name="--open", negative="--no-open")] = True,
    as_json: JsonOutput = False,
) -> None:
    """Run the whole chain on a built-in example: design, predict, export, deploy, simulate, estimate, explore.

    Args:
        out: output folder. Default: exports/demo.
        force: replace existing files, even those that the demo did not write.
        open_: open the page with the results in a browser, if the output is a terminal.
    """
    folder = exports_of() / NAME if out is None else out
    show = open_ and not as_json and sys.stdout.isatty()
    result = run_demo(folder, force, webbrowser.open if show else lambda _: None)
    if as_json:
        print_json(result)
        return
    for reason in result["skipped"]:
        print("skipped:", reason)
    print(
        f"{result['located']} of {result['touches']} touches located; contact error {result['error_mm']:.2f} mm RMS, "
        f"predicted {result['predicted_mm']:.2f} mm RMS"
    )
    print(f"wrote {len(result['made'])} files to {folder}; open {result['page']}")


def run_demo(folder: Path, force: bool, show: Callable[[str], object]) -> dict[str, Any]:
    """Run the chain in one folder; its page is there at once and filled in while the rest is made.

    Args:
        folder: output folder.
        force: whether files that the demo did not write may be replaced.
        show: receives the address of the page as soon as it exists.

    Returns:
        made: each file; page: the index page; skipped: reasons for files that could not be written;
        numbers of located contacts and of touches; error_mm: RMS distance between located and true contact points;
        predicted_mm: the same from the estimates' own covariances.

    Raises:
        InputError: the folder has an edited design or other files, and `force` is not set.
    """
    from probedesign.design.io import new, notes_of, render_design, write_design

    made, skipped = list[Path](), list[str]()
    sections = {name: demo_section(folder, name) for name in SECTIONS}
    print_step("designing a 150 mm cone, 12 mm at its base")
    design = folder / f"{NAME}.toml"
    drafted = new(NAME, length_mm=150.0, base_d_mm=12.0)
    text = render_design(drafted, notes_of(drafted))
    if not force:
        unchanged = design.is_file() and design.read_text("utf-8") == text
        if folder.is_dir() and any(folder.iterdir()) and not unchanged:
            raise InputError(
                f"{folder} has files that the demo did not write. --force replaces them; --out names another folder"
            )
    write_design(text, design, force=True)
    made.append(design)
    import numpy as np

    from probedesign.frozen_probe import deploy_model, load_estimator
    from probedesign.probe import build_probe
    from probedesign.reports.recording_page import STYLE, recording_page, replay_element
    from probedesign.web.home import write_home

    probe = build_probe(drafted)

    def write_page(working: str) -> Path:
        extra = f'<div class="figures">{"".join(sections.values())}</div>'
        extra += "".join(f"<p>skipped: {escape(reason)}</p>" for reason in skipped)
        style = REPORT_STYLE + DEMO_STYLE + STYLE
        page = write_home(folder, probe.model, str(design), extra=extra, style=style, working=working)
        if page is None:
            raise InputError(f"{folder}/index.html: is not a page of this program; name another folder with --out")
        return page

    def begin(step: str) -> None:
        print_step(step)
        write_page(step)

    def finish(name: str, text: str, shown: str = "", links: Sequence[tuple[str, str]] = ()) -> None:
        sections[name] = demo_section(folder, name, text, shown, links)

    page = write_page("the prediction")
    show(page.absolute().as_uri())
    exporting = _begin_parts(design, folder, skipped)
    begin("predicting (the first run compiles the rod and the estimator, half a minute)")
    prediction = probe.predict()
    made += write_files(folder, prediction_files(probe, prediction))
    begin("bending the probe to a whisker")
    made.append(_whisker(probe, folder, finish))
    begin("freezing the estimator and its geometry")
    bundle = deploy_model(probe.model, folder / f"{NAME}.probe.json")
    begin("simulating a recording and locating its contacts")
    estimator = load_estimator(bundle)
    recording, contacts = folder / "recording.csv", folder / "contacts.csv"
    estimates = _simulate(estimator, recording)
    pages = [(contacts.name, estimates.csv().encode()), ("touches.html", recording_page(estimates))]
    made += [bundle, recording, *write_files(folder, pages)]
    names = [f"{kind}p_surface_base_{a}_mm" for kind in ("", "true_") for a in "xyz"]
    names += [f"cov_surface_base_{a}{a}_mm2" for a in "xyz"]
    located, true, variances = np.hsplit(np.array([[row[name] for name in names] for row in estimates.rows], float), 3)
    squares = np.sum((located - true) ** 2, axis=1)
    ok = np.isfinite(squares)
    result = {
        "located": int(ok.sum()),
        "touches": int(np.isfinite(true[:, 0]).sum()),
        "error_mm": float(np.sqrt(squares[ok].mean())),
        "predicted_mm": float(np.sqrt(variances[ok].sum(axis=1).mean())),
    }
    finish(
        "estimate",
        f"A touch of 20 mN sweeps along the probe: {result['located']} of {result['touches']} readings located, "
        f"{result['error_mm']:.2f} mm RMS, predicted {result['predicted_mm']:.2f} mm.",
        replay_element(estimator, estimates.rows, estimates.gravities, SECTIONS["estimate"][0]),
        [("touches.html", "charts"), (contacts.name, "located contacts"), (recording.name, "the recording")],
    )
    begin("touching a simulated card house")
    files, score = _explore(bundle, folder, skipped)
    made += files
    if (folder / "found/points.svg").exists():
        picture = f'<img src="found/points.svg" alt="{escape(SECTIONS["explore"][0])}">'
        finish("explore", f"A base touches a simulated card house with friction: {score}.", picture,
               [("found/points.html", "the points in three dimensions")])  # fmt: skip
    else:
        finish("explore", skipped[-1])
    if exporting is not None:
        begin("building the parts")
        made += _end_parts(exporting, folder, skipped)
    write_page("")
    return {"made": [*map(str, [*made, page])], "page": str(page), "skipped": skipped, **result}


def _whisker(straight: "Probe", folder: Path, finish: Callable[..., None]) -> Path:
    from probedesign.design.io import new, notes_of, render_design, write_design
    from probedesign.prediction.fused import SHOWN_N
    from probedesign.prediction.predict import FRACTIONS, HEADLINE_FRACTION, errors_over_directions
    from probedesign.probe import build_probe
    from probedesign.reports.prediction_charts import error_band_chart

    drafted = new("whisker", length_mm=150.0, base_d_mm=12.0, axis="arc", axis_bend_deg=60.0, axis_azimuth_deg=-90.0)
    path = folder / "whisker.toml"
    write_design(render_design(drafted, notes_of(drafted)), path, force=True)
    over = {name: errors_over_directions(probe.estimator(), FRACTIONS, (SHOWN_N,))
            for name, probe in (("straight", straight), ("along an arc of 60°", build_probe(drafted)))}  # fmt: skip
    before, after = (rows[FRACTIONS.index(HEADLINE_FRACTION)].median_error_mm for rows in over.values())
    text = (f"One reading of {1e3 * SHOWN_N:g} mN at {HEADLINE_FRACTION:g} of the length: {before:.2g} mm straight, "
            f"{after:.2g} mm in the median direction along an arc. Line: median of all directions; band: from the best "
            "to the worst, in the plane of the arc.")  # fmt: skip
    chart = labelled(error_band_chart(over).svg(), SECTIONS["whisker"][0])
    finish("whisker", text, chart, [(path.name, "its design file")])
    return path


#: Program of the process that exports the parts, on a core of its own; it prints the names of their files.
_PARTS = """import json, pathlib, sys
from probedesign import cad, load_design
manifest = cad.export_parts(load_design(sys.argv[1]), pathlib.Path(sys.argv[2]))
print(json.dumps(list(manifest["files"])))"""


def _begin_parts(design: Path, folder: Path, skipped: list[str]) -> "subprocess.Popen[str] | None":
    try:
        require("cadquery", "export", "cad", "CadQuery")
    except MissingDependencyError as error:
        skipped.append(str(error))
        return None
    return subprocess.Popen([sys.executable, "-c", _PARTS, str(design), str(folder)], text=True,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE)  # fmt: skip


def _end_parts(exporting: "subprocess.Popen[str]", folder: Path, skipped: list[str]) -> list[Path]:
    printed, errors = exporting.communicate()
    if exporting.returncode:
        skipped.append(f"the parts were not exported: {(errors.splitlines() or ['the process was ended'])[-1]}")
        return []
    return [folder / name for name in [*json.loads(printed.splitlines()[-1]), "manifest.json"]]


def _explore(bundle: Path, folder: Path, skipped: list[str]) -> tuple[list[Path], str]:
    from probedesign.cli.explore import FILES, explore
    from probedesign.cli.options import BaseOptions, ReadingOptions, RehearsalOptions

    rehearsal, maps, printed = folder / "rehearsal", folder / "map", io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(io.StringIO()):
            explore(bundle, rehearsal=RehearsalOptions(rehearse=rehearsal), force=True)
            explore(
                bundle,
                rehearsal / "house.mcap",
                out=maps,
                force=True,
                reading=ReadingOptions(tare_s=TARE, average=AVERAGE),
                base=BaseOptions(pose=[str(rehearsal / "poses.csv")]),
            )
    except MissingDependencyError as error:
        skipped.append(str(error))
        return [], ""
    return [maps / name for name in FILES], printed.getvalue().splitlines()[-1]


def _simulate(estimator: "Estimator", recording: Path) -> "RecordingEstimates":
    import numpy as np

    from probedesign.live.blocks import iter_readings
    from probedesign.live.processing.estimates import true_values
    from probedesign.live.recordings.csv import write_recording
    from probedesign.live.run import estimate_recording
    from probedesign.live.sources.sim import SimulatedSource

    readings = list(iter_readings(SimulatedSource(estimator.model, TOUCH)))
    write_recording(recording, np.array([r.time for r in readings]), np.array([r.wrench_sensor for r in readings]))
    estimates = estimate_recording(estimator, recording)
    for row, reading in zip(estimates.rows, readings, strict=True):
        row |= true_values(reading)
    return estimates


def demo_section(
    folder: Path, name: str, text: str = "", shown: str = "", links: Sequence[tuple[str, str]] = ()
) -> str:
    """Return a section of the page; without a text it is being made. `shown` is its picture, as HTML."""
    heading, command = SECTIONS[name]
    body = '<p class="waiting">being made ...</p>'
    if text:
        files = "".join(f'<a href="{escape(file)}">{escape(what)}</a>' for file, what in links)
        body = f'{shown}<p>{escape(text)}</p><p class="links">{files}</p>'
    command = escape(command.format(folder=folder))
    return f"<section><h2>{escape(heading)}</h2>{body}<p><code>{command}</code></p></section>\n"
