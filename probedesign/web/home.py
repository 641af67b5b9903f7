"""The home page of a design's folder: the probe in three dimensions, its main figures, and the state of each step.

Every command that writes into the folder refreshes the page, and with it the links at the head of the pages that it
leads to. It reads what the other commands wrote, and computes nothing.
"""

import base64
import json
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import date
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from probedesign.core.errors import InputError
from probedesign.core.files import exports_of, write_atomically
from probedesign.core.frames import Array, inverse
from probedesign.design.catalog import assumed_text
from probedesign.design.io import load_design
from probedesign.design.schema import Design
from probedesign.estimation.model import ProbeModel
from probedesign.frozen_probe import stale_parts
from probedesign.geometry.axis import Axis
from probedesign.geometry.tube import BentShape, TubeMesh
from probedesign.mount.mount import Mount
from probedesign.reports.html_page import DOCTYPE, NAVIGATION, html_document
from probedesign.reports.html_page import STYLE as PAGE_STYLE
from probedesign.web.scene import (
    PART_COLOURS,
    PROBE,
    STALE_COLOUR,
    RigidPart,
    colour_bar,
    cylinder,
    error_colours,
    level_rotation,
    revolved,
    rigid_parts,
)

PAGE = "index.html"
MAX_RECORD = 64_000_000  #: Size from which the file of a step is not read [bytes].
SHOWN_N = 0.01  #: Force of the touches that colour the probe [N].


@dataclass(frozen=True)
class Step:
    """A step from the design to a located touch, whose state a card of the page states."""

    title: str  #: of the card.
    gives: str  #: what it gives, shown until it is made.
    command: str  #: that makes it.
    page: str = ""  #: page, record, picture: files in the folder; a pattern may have a star for a folder.
    record: str = ""
    picture: str = ""
    state: Callable[[dict[str, Any]], str] = lambda record: ""  #: the result in one line, from the record.


STEPS = (
    Step("Prediction", "the contact error to expect, before printing", "probedesign predict {design}",
         "prediction.html", "prediction.json", state=lambda record: str(record["verdict"])),
    Step("Parts", "files to print, inspection sheets and assembly instructions", "probedesign export {design}",
         "assembly.html", "manifest.json", "exploded.svg",
         lambda record: f"{len(record['files'])} files of {len(record['parts'])} parts, "
         f"{sum(check['ok'] for check in record['verification'].values())} of {len(record['verification'])} checks "
         f"passed"),
    Step("Frozen estimator", "one file for the robot's computer", "probedesign deploy {design}",
         record="{name}.probe.json", state=lambda record: f"{{name}}.probe.json, for {record['sensor']['model']}"),
    Step("Calibration", "bias, payload, mount and stiffness, from free motion on the robot",
         "probedesign calibrate {name} --source SPEC --pose POSES", record="{name}.calibrated.probe.json"),
    Step("Touches", "located touches of a recording",
         "probedesign estimate {name} RECORDING --page {folder}/touches.html", "touches.html"),
    Step("Map", "points of an object, found by touch",
         "probedesign explore {name} RECORDING --pose POSES --out {folder}/map", "*/points.html",
         picture="*/points.svg"),
    Step("Comparison", "several designs side by side", "probedesign compare {design} OTHER.toml", "comparison.html"),
    Step("Identification", "E, G and other parameters of the print, from tests",
         "probedesign identify {design} DATA", "identification/identification.html",
         "identification/identification.json", state=lambda record: _identified(record)),
    Step("Validation", "stated regions against a stereo reference", "probedesign validate {name} DATA",
         "validation/validation.html", "validation/validation.json",
         state=lambda record: str(record["coverage"]["sentence"])),
    Step("Twin", "the probe for simulators", "probedesign twin {design}", record="twin/{name}.xml"),
    Step("Live", "touches as they happen; sim: needs no sensor", "probedesign live {name} --source sim: --view"),
)  # fmt: skip

STYLE = """
main { max-width: 1120px; margin: auto }
.hero { display: grid; grid-template-columns: minmax(0, 3fr) minmax(0, 2fr); gap: 24px;
  align-items: center; margin: 16px 0 }
#scene { width: 100%; height: 420px; touch-action: none; cursor: grab; display: block; color: var(--ink);
  filter: none }
.small { color: var(--soft); font-size: 14px; margin: 8px 0 }
.number { margin: 0 0 24px }
.number b { display: block; font-size: 40px; line-height: 1.1; font-weight: 600; color: var(--link) }
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(300px, 100%), 1fr)); gap: 16px }
.card { border: 1px solid var(--rule); border-radius: 8px; padding: 16px; display: flex; flex-direction: column;
  gap: 8px }
.card h2 { font-size: 18px; margin: 0; display: flex; justify-content: space-between; gap: 8px }
.card p { margin: 0; font-size: 14px }
.card img { width: 100%; height: 160px; object-fit: contain; background: #fff; border-radius: 4px }
.card .state { font-size: 14px; font-weight: 400; color: var(--soft) } .card .stale { color: var(--alarm) }
.card code { font-size: 13px; overflow-wrap: anywhere; color: var(--soft) }
.missing { border-style: dashed }
@media (max-width: 720px) {
  .hero { grid-template-columns: 1fr } #scene { height: 300px } .number b { font-size: 32px }
}
@media print { #scene { height: 80mm } }
"""
STYLE_START = PAGE_STYLE[:40].encode()  #: Of every page of this program, of any version.
REFRESH = '<meta http-equiv="refresh" content="2">'


def write_home(
    folder: Path, model: ProbeModel, design: str = "", *, extra: str = "", style: str = "", working: str = ""
) -> Path | None:
    """Write the home page of a folder, and the links at the head of its pages.

    Args:
        folder: of the design's files.
        model: of the probe.
        design: design file, for the commands of missing steps; the name of the design if empty.
        extra: HTML between the figures and the cards, for which `style` is added to the style sheet.
        working: what is being made; the page reloads itself until it is empty.

    Returns:
        The page; None where a file of this name was not written by this program, which stays.
    """
    page = folder / PAGE
    if page.exists():
        try:
            with page.open("rb") as file:
                head = file.read(4096)
        except OSError:
            head = b""
        if not (head.startswith(DOCTYPE.encode()) and STYLE_START in head):
            return None
    words = {"design": design or model.name, "name": model.name, "folder": str(folder)}
    made = [(step, *_files(folder, step, model.name)) for step in STEPS]
    prediction = next((record for step, _, record, _ in made if step.title == "Prediction" and record), {})
    if prediction.get("fingerprint") != model.fingerprint:
        prediction = {}
    cards = "".join(_card(step, words, file, record, picture, model) for step, file, record, picture in made)
    waiting = f'<p class="small" role="status">being made: {escape(working)} ...</p>' if working else ""
    try:
        numbers, errors = _numbers(prediction), _errors(prediction)
    except (KeyError, TypeError, ValueError):  # there is none, or one of another version
        numbers, errors = [], {}
    figures = "".join(f'<p class="number"><b>{value}</b>{escape(meaning)}</p>' for value, meaning in numbers)
    notes = f'<p class="small">Assumed until measured: {escape(assumed_text(model.assumptions))}.</p>'
    mount: list[RigidPart] = []
    with suppress(InputError):
        mount = adapters(load_design(design), model) if design else []
    scene = _scene(folder, model, errors, mount)
    body = (f'<div class="hero">{scene}<div>{figures}{notes}</div></div>{waiting}{extra}'
            f'<div class="cards">{cards}</div>')  # fmt: skip
    about = [f"Geometry {model.fingerprint} · {escape(model.resin or 'unknown resin')} · {escape(model.sensor)} · "
             f"{date.today().isoformat()}"]  # fmt: skip
    content = html_document(model.name, about, body, STYLE + style, REFRESH if working else "")
    write_atomically(page, content, durable=False)
    _link(folder, model, [(step.title, file) for step, file, _, _ in made if file.endswith(".html")])
    return page


def refresh_home(model: ProbeModel, design: Path | None = None) -> Path | None:
    """Refresh the home page in the default folder of a design's files, see `write_home`.

    Args:
        model: of the probe.
        design: its design file; None for a command that was called with a frozen probe, whose files may lie elsewhere:
            the page is written then only if the folder exists.
    """
    if design is None and not (exports_of() / model.name).is_dir():
        return None
    return write_home(exports_of(design) / model.name, model, "" if design is None else str(design))


def _files(folder: Path, step: Step, name: str) -> tuple[str, dict[str, Any] | None, str]:
    def newest(pattern: str) -> str:
        files = sorted(folder.glob(pattern.format(name=name)), key=lambda file: file.stat().st_mtime) if pattern else []
        return files[-1].relative_to(folder).as_posix() if files else ""

    record = newest(step.record)
    return newest(step.page) or record, _record(folder / record) if record else None, newest(step.picture)


def _record(path: Path) -> dict[str, Any]:
    if path.suffix != ".json" or path.stat().st_size > MAX_RECORD:
        return {}
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def _card(
    step: Step, words: dict[str, str], file: str, record: dict[str, Any] | None, picture: str, model: ProbeModel
) -> str:
    """Return the card of a step as HTML: its result, or the command that makes it."""
    command = f"<code>{escape(step.command.format(**words))}</code>"
    if not file:
        return f'<section class="card missing"><h2>{step.title}</h2><p>{escape(step.gives)}</p>{command}</section>\n'
    day = date.fromtimestamp((Path(words["folder"]) / file).stat().st_mtime).isoformat()
    state, stale = f'<span class="state">{day}</span>', ""
    try:
        text = step.state(record).format(**words) if record else step.gives
        if record and record.get("fingerprint", model.fingerprint) != model.fingerprint:
            stale = f"made for geometry {record['fingerprint']}"
        elif record and step.title == "Parts":  # those of the mount have fingerprints of their own
            stale = stale_parts(model.parts or {"probe": model.fingerprint}, record)
    except (KeyError, TypeError, AttributeError, ValueError):
        text = "the file cannot be read; run it again"
    if stale:
        stale = f'<p class="stale">{escape(stale)}; run it again:</p>{command}'
    title = f'<a href="{escape(file)}">{step.title}</a>'
    image = f'<a href="{escape(file)}"><img src="{escape(picture)}" alt="{step.title}"></a>' if picture else ""
    return f'<section class="card"><h2>{title}{state}</h2>{image}<p>{escape(text)}</p>{stale}</section>\n'


def _identified(record: dict[str, Any]) -> str:
    """Return the identified numbers of `identification.json` with their 95 % intervals."""
    values = [f"{number['name']} {number['value']:.4g} {number['unit']} ({number['low']:.4g} ... {number['high']:.4g})"
              for number in record["found"] if number.get("identified")]  # fmt: skip
    return ", ".join(values) or str(record["result"])


def _numbers(prediction: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the three main figures of a prediction with their meaning; fewer where nothing is located."""
    felt = [row["detectable_force_mN"] for row in prediction["detection"] if row["detectable_force_mN"] is not None]
    fused, single, numbers = prediction["fused_headline"], _errors(prediction), list[tuple[str, str]]()
    fraction = fused["contact_fraction"]
    if felt:
        numbers.append((f"{min(felt):.2g} mN", "is the lightest touch that is felt, at the most sensitive place."))
    if fused["predicted_error_mm"] is not None:
        numbers.append((f"{fused['predicted_error_mm']:.2g} mm",
                        f"RMS error of {fused['touches']} fused touches of up to {1e3 * fused['force_N']:g} mN, at "
                        f"{fraction:g} of the length."))  # fmt: skip
    if single.get(fraction) is not None:
        numbers.append((f"{single[fraction]:.2g} mm",
                        f"RMS error of one reading of {1e3 * SHOWN_N:g} mN there, worst direction."))  # fmt: skip
    return numbers


def _errors(prediction: dict[str, Any]) -> dict[float, float | None]:
    """Return the largest predicted error [mm] of one reading of `SHOWN_N` by place; None where one is not located."""
    errors = dict[float, float | None]()
    for row in prediction["conditions"]:
        if row["force_N"] == SHOWN_N:
            error = row["predicted_error_mm"] if row["result"] == "ok" else None
            before = errors.get(row["contact_fraction"], 0.0)
            errors[row["contact_fraction"]] = None if error is None or before is None else max(error, before)
    return errors


# scene


def adapters(design: Design, model: ProbeModel) -> list[RigidPart]:
    """Return the adapters of a design as bodies of revolution, without holes; none where one cannot be made."""
    mount, T = Mount.of(design), inverse(model.T_sensor_base)
    try:
        a, plate = mount.sensor_adapter, mount.flange_adapter
    except InputError:
        return []
    foot, cone, rim, recess = (d / 2.0 for d in (a.foot_d, a.cone_d, a.body_d, a.recess_d))
    outline = [(0.0, 0.0), (foot, 0.0), (foot, a.foot_height), (cone, a.foot_height), (rim, a.cone_top),
               (rim, a.body_top), (recess, a.body_top), (recess, a.floor), (0.0, a.floor)]  # fmt: skip
    bore, top, high = a.ring_bore_d / 2.0, a.ring_bore_top_d / 2.0, a.ring_thickness
    ring = [(bore, 0.0), (rim, 0.0), (rim, high), (top, high), (bore, 0.0)]
    flange_adapter = cylinder("flange_adapter", plate.plate_d, 0.0, plate.plate_top, T @ plate.T_sensor_robotflange)
    return [revolved("sensor_adapter", outline, T), revolved("clamp_ring", ring, np.eye(4)), flange_adapter]


def _scene(folder: Path, model: ProbeModel, errors: dict[float, float | None], mount: Sequence[RigidPart]) -> str:
    """Return the element with the probe and its parts, as mounted and unloaded, coloured by the predicted errors.

    The adapters of `mount` are drawn until there are exported ones.
    """
    rod = model.rod
    tube = TubeMesh(rod.s, rod.radius, model.cross_section.flatness)
    axis = model.axis or Axis(np.array([0.0, rod.length]), np.zeros((2, 2)))
    s = np.linspace(0.0, rod.length, 200)
    T = axis.frames(s)
    upright = level_rotation(model.gravity_base)
    points = tube.vertices(BentShape(s, T[:, :3, 3], T[:, :3, :3])) @ upright.T
    parts, note = rigid_parts(model, folder, mount)
    colours = _colours(errors, tube) if errors else None
    meshes: list[tuple[Array, Any, tuple[int, int, int], Any]] = [(points, tube.faces, PROBE, colours)]
    meshes += [
        (part.vertices @ upright.T, part.faces, PART_COLOURS.get(part.name, STALE_COLOUR), None) for part in parts
    ]
    every = np.concatenate([mesh[0] for mesh in meshes])
    low, high = every.min(axis=0), every.max(axis=0)
    step = float((high - low).max()) / 65535.0
    data = {
        "azimuth": math.radians(32.0), "elevation": math.radians(18.0), "centre": (0.5 * (low + high)).tolist(),
        "radius": 0.5 * float(np.linalg.norm(high - low)), "low": low.tolist(), "step": step,
        "floor": float(low[2]) - 0.012, "grid": (0.01 * np.round(50.0 * (low + high)[:2])).tolist(),
        "parts": [
            {"points": _base64(np.round((vertices - low) / step).astype("<u2")), "faces": _base64(faces.astype("<u4")),
             "colour": list(colour), "colours": None if colours is None else _base64(colours)}
            for vertices, faces, colour, colours in meshes
        ],
    }  # fmt: skip
    caption = "Unloaded, as mounted; gravity points down, the grid is 10 mm. Drag or use the arrow keys to rotate."
    if note:
        caption += " The mount is drawn without its holes until the parts are exported."
    scale = colour_bar(f"error of one reading of {1e3 * SHOWN_N:g} mN at that place") if errors else ""
    script = Path(__file__).with_suffix(".js").read_text("utf-8")
    return (
        '<div><canvas id="scene" role="img" tabindex="0" aria-label="the probe on its mount"></canvas>'
        f'{scale}<p class="small" id="scene-note">{escape(caption)}</p>'
        f'<script type="application/json" id="scene-data">{json.dumps(data)}</script>'
        f'<script type="module">\n{script}</script></div>'
    )


def _base64(values: NDArray[np.generic]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()


def _colours(errors: dict[float, float | None], tube: TubeMesh) -> NDArray[np.uint8]:
    rings = error_colours(errors, tube.stations / tube.s[-1])
    caps = [np.repeat(rings[end : end + 1 or None], tube.sides + 1, axis=0) for end in (0, -1)]
    return np.concatenate([np.repeat(rings, tube.sides, axis=0), *caps])


# links


def _link(folder: Path, model: ProbeModel, pages: Sequence[tuple[str, str]]) -> None:
    """Write the links between the pages of a folder at the head of each; those that the export lists stay as they are.

    The digest of such a page is in the manifest, so that it links to the home page only, since it was written.
    """
    for title, file in pages:
        if file == "assembly.html":
            continue
        up = "../" * file.count("/")
        links = "".join(
            f"<span>{name}</span>" if name == title else f'<a href="{up}{escape(other)}">{name}</a>'
            for name, other in pages
        )
        about = f"{escape(model.name)} · geometry {model.fingerprint} · {date.today().isoformat()}"
        head = f'<nav><a href="{up}{PAGE}">{about}</a>{links}</nav>'
        path = folder / file
        try:
            content = path.read_bytes()
            changed = NAVIGATION.sub(head.replace("\\", "\\\\").encode(), content, count=1)
            if content.startswith(DOCTYPE.encode()) and changed != content:
                write_atomically(path, changed, durable=False)
        except (OSError, InputError):
            continue  # the page stays as it is; the home page leads to it all the same
