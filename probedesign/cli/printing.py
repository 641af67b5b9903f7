"""`probedesign check` and `probedesign print`: the print check of a design, and its print job in PreForm."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from probedesign.cli.console import plural, print_json, print_table, show_progress
from probedesign.cli.options import DesignFile, JsonOutput
from probedesign.core.errors import InputError
from probedesign.core.files import exports_of

if TYPE_CHECKING:
    from probedesign.printing.check import PrintCheck
    from probedesign.printing.preform_job import PreparedJob


def check(design: DesignFile, /, *, as_json: JsonOutput = False) -> int:
    """Check a design against the rules of its printer and its resins, before any CAD.

    Exit status 1 if a rule finds an error; warnings do not change it. The rules, their sources and their confidence:
    docs/printing.md.

    Args:
        design: the design file, or its name.
        as_json: print one JSON document.
    """
    from probedesign import pipeline
    from probedesign.design import load_design
    from probedesign.mount import root_contradiction

    checked = load_design(design)
    found, root = pipeline.check(checked), root_contradiction(checked)
    if as_json:
        passed = [finding.as_record() for finding in found.passed]
        record = {"name": found.name, "fingerprint": found.fingerprint, **found.as_record(), "passed": passed}
        print_json(record | {"root_warning": root or None})
    else:
        _print_check(found)
        if root:
            print(f"\nwarning: {root}")
    return 1 if found.errors else 0


def _print_check(found: "PrintCheck") -> None:
    print(f"{found.name}  geometry {found.fingerprint}  {found.resin} on a {found.printer}")
    for finding in (*found.errors, *found.warnings):
        print(f"  {finding.severity:<7}  {finding.message}")
        print(f"           {finding.rule}, {finding.confidence} confidence: {finding.source}")
    print(
        f"{plural(len(found.errors), 'error')}, {plural(len(found.warnings), 'warning')}; "
        f"{len(found.passed)} of {len(found.findings)} checks passed"
    )
    print("\nadvice for printing")
    for advice in found.advice:
        print(f"  {advice}")


def print_job(
    design: DesignFile,
    /,
    *,
    preform: str = "http://localhost:44388",
    parts: Literal["probe", "adapters"] = "probe",
    folder: Path | None = None,
    server_folder: str | None = None,
    material: str | None = None,
    save_form: str | None = None,
    send: str | None = None,
    timeout_s: float = 600.0,
    force: bool = False,
    as_json: JsonOutput = False,
) -> int:
    """Prepare the exported parts in PreForm: oriented as the print check chose, supported, laid out and validated.

    Reports print time and resin and saves a screenshot. Nothing is sent to a printer without --send, and then the job
    only enters the printer's queue; a person starts it there. Needs an export of the design and a running
    PreFormServer. Exit status 1 if the print check or PreForm's validation finds a problem. More: docs/printing.md.

    Args:
        design: the design file, or its name.
        preform: address of PreFormServer.
        parts: the probe in its soft resin, or the adapters in a rigid one.
        folder: folder of the export. Default: exports/NAME.
        server_folder: path of that folder on PreForm's host, if that is another machine.
        material: PreForm's label or code of the material. Default: the design's resin, or grey resin for adapters.
        save_form: save the job to this .form file.
        send: send the job to this printer, given by its serial name or IP address.
        timeout_s: time limit of one PreForm operation [s].
        force: continue in spite of problems, and replace an existing .form file.
        as_json: print one JSON document.
    """
    from probedesign import pipeline
    from probedesign.design import load_design
    from probedesign.printing import preform_job as job
    from probedesign.printing.preform_client import PreForm, connection_to

    if send is not None and not (send.strip() and send.isprintable()):
        raise InputError(f"--send {send!r} is not the name of a printer")
    if not 1.0 <= timeout_s <= 86400.0:
        raise InputError(f"--timeout-s {timeout_s:g} is out of range; allowed is 1 ... 86400")
    drawn = load_design(design)
    errors = [f.message for f in pipeline.check(drawn).errors if (f.part == "probe") == (parts == "probe")]
    if errors and not force:
        raise InputError(f"{design}: the print check found errors: {'; '.join(errors)}. --force continues")
    order = job.PrintOrder(parts, folder, server_folder, material, save_form, send, force)
    with show_progress() as on_progress:
        connection = connection_to(preform)
        exported = job.load_job(drawn, folder or exports_of(design) / drawn.name, parts)
        places = job.path_mapping(exported.folder, server_folder, connection.local, connection.url)
        if save_form is not None:
            order = replace(order, form_file=job.check_form_file(save_form, places, force))
        server = PreForm(connection, timeout_s, on_progress=on_progress)
        prepared = job.prepare_job(server, exported, places, order)
    if as_json:
        print_json(_document(prepared, send))
    else:
        _print_job(prepared, preform, send)
    return 1 if prepared.problems and not force else 0


def _document(prepared: "PreparedJob", printer: str | None) -> dict[str, Any]:
    return {
        "ok": not prepared.problems,
        "preform_api": prepared.api,
        "printer": prepared.selection.printer,
        "material": prepared.selection.material,
        "setting": prepared.selection.setting,
        "scene_settings": prepared.selection.scene_settings,
        "parts": prepared.parts,
        "orientation": prepared.orientation,
        "layer_count": prepared.layer_count,
        "volume_ml": prepared.volume_ml,
        "print_time_s": prepared.print_time_s,
        "problems": prepared.problems,
        "screenshot": prepared.screenshot,
        "form_file": prepared.form_file,
        "asked_to_send_to": printer,
        "sent_to": prepared.sent_to,
        "job_id": prepared.job_id,
    }


def _print_job(prepared: "PreparedJob", preform: str, printer: str | None) -> None:
    selection, minutes = prepared.selection, round(prepared.print_time_s / 60.0)
    rows = {
        "job": f"{selection.material} on a {selection.printer}, {selection.setting}",
        "parts": "; ".join(f"{part} {way}" for part, way in prepared.orientation.items()),
        "resin": "unknown" if prepared.volume_ml is None else f"{prepared.volume_ml:.1f} ml with supports",
        "layers": "unknown" if prepared.layer_count is None else f"{prepared.layer_count}",
        "time": f"{minutes // 60} h {minutes % 60:02d} min, estimated",
        "screenshot": prepared.screenshot,
        "form file": prepared.form_file or "none; save it with --save-form FILE",
        "validation": "; ".join(prepared.problems) or "no problems",
        "sent": _sent(prepared, printer),
    }
    print(f"PreForm (API {prepared.api}) at {preform}")
    print_table(rows)


def _sent(prepared: "PreparedJob", printer: str | None) -> str:
    if prepared.sent_to is not None:
        job = f" as job {prepared.job_id}" if prepared.job_id else ""
        return f"to the queue of {prepared.sent_to}{job}; start it at the printer"
    if printer is not None:
        return "no, validation found problems; --force sends it anyway"
    return "no; send it with --send PRINTER"
