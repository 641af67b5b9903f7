"""Print jobs: the exported files of a design, checked, and their preparation in PreForm.

PreForm reads and writes files on its own machine, so each path exists in two forms: local, and on the server.
"""

import hashlib
import json
import os
import re
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePath, PurePosixPath, PureWindowsPath
from typing import Any, Literal

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.files import check_overwrite
from probedesign.core.stl import stl_corners
from probedesign.design import Design
from probedesign.design.diagnostics import quoted
from probedesign.geometry import build_geometry
from probedesign.printing.check import print_scale
from probedesign.printing.preform_client import NoResponseError, PreForm, PreFormError, RefusedError
from probedesign.printing.preform_settings import (
    Extent,
    PrintScene,
    PrintSelection,
    PrintValidation,
    SceneModel,
    select_settings,
)

Parts = Literal["probe", "adapters"]
PLAIN = re.compile(r"[A-Za-z0-9_-]+\.stl")


@dataclass(frozen=True)
class PrintJob:
    """One build platform of one resin."""

    name: str  #: as the printer shows it.
    product: str  #: name of the printer that the design asks for.
    resin: str  #: of the design, or "rigid".
    folder: Path  #: of the export, absolute.
    #: extent of each part's mesh along x, y and z [mm]; the file is the part's name with .stl.
    sizes: dict[str, Extent]
    upside_down: frozenset[str] = frozenset()  #: parts that are printed upside down.
    on_platform: frozenset[str] = frozenset()  #: parts that stand on the platform without supports.

    def stands(self, part: str) -> str:
        """Return how a part stands on the platform."""
        side = "upside down" if part in self.upside_down else "upright"
        return f"{side}, {'on the platform' if part in self.on_platform else 'on supports'}"

    def file(self, part: str) -> Path:
        """Return the path of a part's file."""
        return self.folder / f"{part}.stl"


def load_job(design: Design, folder: Path, parts: Parts) -> PrintJob:
    """Return the job of the probe, or that of all rigid parts.

    Args:
        design: the exported design.
        folder: of the export.
        parts: the probe in soft resin, or the rigid parts: two resins, two jobs.

    Raises:
        InputError: the folder holds no export, one of another design, or files that were changed since; or the rigid
            parts are milled.
    """
    if parts == "adapters" and design.mount.adapters == "milled":
        raise InputError(
            "--parts adapters: mount.adapters is 'milled', so sensor adapter, clamp ring and flange adapter are made "
            "from their drawings; --parts probe prints the probe"
        )
    folder = Path(os.path.abspath(folder))
    manifest = _manifest(folder / "manifest.json")
    _check_same(design, manifest, folder)
    names = [
        name for name in manifest["files"] if PLAIN.fullmatch(name) and (name == "probe.stl") == (parts == "probe")
    ]
    if not names:
        raise InputError(f"{folder}: its manifest lists no STL files for --parts {parts}; export the design again")
    sizes = {name[:-4]: _size(folder / name, manifest["files"][name]) for name in names}
    resin = design.resin.name if parts == "probe" else "rigid"
    name = f"{design.name}-{build_geometry(design).fingerprint}-{parts}"
    upside_down, on_platform = _orientations(manifest, sizes)
    return PrintJob(name, design.printer.product, resin, folder, sizes, upside_down, on_platform)


def _orientations(manifest: dict[str, Any], sizes: dict[str, Extent]) -> tuple[frozenset[str], frozenset[str]]:
    """Return the parts that are printed upside down, and those without supports; all others stand upright on supports.

    Exports of earlier versions do not state them.
    """
    check = manifest.get("print_check")
    stated = check.get("orientation") if isinstance(check, dict) else None
    stated = stated if isinstance(stated, dict) else {}
    records = {part: stated[part] for part in sizes if isinstance(stated.get(part), dict)}
    return (
        frozenset(part for part, record in records.items() if record.get("side") == "upside down"),
        frozenset(part for part, record in records.items() if record.get("supports") is False),
    )


def _manifest(path: Path) -> dict[str, Any]:
    try:
        manifest = json.loads(path.read_bytes())
    except FileNotFoundError:
        raise InputError(f"{path}: not found; make the parts first: probedesign export") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError):
        manifest = None
    if not isinstance(manifest, dict) or not isinstance(manifest.get("files"), dict):
        raise InputError(f"{path}: is no manifest of an export; export the design again")
    return manifest


def _check_same(design: Design, manifest: dict[str, Any], folder: Path) -> None:
    """Refuse parts of another geometry, resin or scale than the design's."""
    exported = manifest.get("design")
    resin = exported.get("material", {}).get("resin") if isinstance(exported, dict) else None
    scales = manifest.get("print_scale")
    same = (
        manifest.get("fingerprint") == build_geometry(design).fingerprint
        and resin == design.resin.name
        and isinstance(scales, dict)
        and all(scale == list(print_scale(design, part)) for part, scale in scales.items())
    )
    if not same:
        raise InputError(
            f"{folder}: its parts have another geometry, resin or scale than the design; export the design again"
        )


def _size(path: Path, record: Any) -> Extent:
    """Return the extent of the mesh in a file, after checking the file against its manifest record."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; export the design again") from None
    if not isinstance(record, dict) or hashlib.sha256(content).hexdigest() != record.get("sha256"):
        raise InputError(f"{path}: is not the file of its manifest; export the design again")
    x, y, z = (float(v) for v in np.ptp(stl_corners(content).reshape(-1, 3), axis=0))
    return (x, y, z)


@dataclass(frozen=True)
class PathMapping:
    """Map the export folder to its path on PreForm's machine."""

    folder: Path  #: local path, absolute.
    server_folder: PurePath | None = None  #: the same folder on PreForm's machine; None if PreForm runs locally.

    def server_path(self, path: Path) -> str:
        """Return the path of an exported file on PreForm's machine."""
        return str(path if self.server_folder is None else self.server_folder / path.name)

    @contextmanager
    def output(self, target: str) -> Iterator[str]:
        """Yield the path that PreForm writes to; a local file is written under another name and moved when complete.

        Raises:
            PreFormError: PreForm reports the file as written, and it does not exist.
        """
        if self.server_folder is not None:
            yield str(self.server_folder / target)
            return
        path = Path(os.path.abspath(self.folder / target))
        partial = path.with_name(f".{path.stem}.{uuid.uuid4().hex[:8]}{path.suffix}")
        try:
            yield str(partial)
            if not partial.is_file() or partial.stat().st_size == 0:
                raise PreFormError(
                    f"{path}: PreForm reports it as written, but it does not exist; if PreForm runs elsewhere, "
                    "--server-folder names the export folder there"
                )
            os.replace(partial, path)
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from None
        finally:
            partial.unlink(missing_ok=True)

    def display(self, target: str) -> str:
        """Return the path for messages to the user."""
        return str(self.folder / target) if self.server_folder is None else str(self.server_folder / target)


def path_mapping(folder: Path, server_folder: str | None, local: bool, url: str) -> PathMapping:
    """Return the path mapping of an export folder.

    Args:
        folder: of the export, local.
        server_folder: the same folder on PreForm's machine.
        local: whether PreForm runs on this machine.
        url: of PreForm, for error messages.

    Raises:
        InputError: PreForm runs elsewhere and the folder there is missing or not absolute.
    """
    folder = Path(os.path.abspath(folder))
    if server_folder is None:
        if local:
            return PathMapping(folder)
        raise InputError(
            f"--preform {url}: PreForm reads files on its own machine; --server-folder names the folder there "
            f"that contains the files of {folder} (shared or copied)"
        )
    for kind in (PureWindowsPath, PurePosixPath):
        if kind(server_folder).is_absolute():
            return PathMapping(folder, kind(server_folder))
    raise InputError(f"--server-folder {quoted(server_folder)} is not a full path, such as C:\\probes\\large")


def check_form_file(file: str, paths: PathMapping, force: bool) -> str:
    """Return the target of `--save-form` after checking that it can be written.

    Returns:
        The path that `PathMapping.output` takes.

    Raises:
        InputError: it does not end in .form, its folder does not exist, or it exists and `force` is not set.
    """
    if not file.endswith(".form") or not file.isprintable():
        raise InputError(f"--save-form {quoted(file)}: PreForm's files end in .form")
    if paths.server_folder is not None:
        return file
    path = Path(os.path.abspath(file))
    if not path.parent.is_dir():
        raise InputError(f"--save-form {path}: there is no folder {path.parent}")
    check_overwrite(path, force and path.is_file())
    return str(path)


SIZE_TOLERANCE = 0.2
"""Tolerance on a model's size in PreForm [mm]: two layers; wrong units or a tilt exceed it by far (assumed)."""


@dataclass(frozen=True)
class PrintOrder:
    """The user's options for a print job."""

    parts: Parts = "probe"  #: the probe, or the adapters.
    folder: Path | None = None  #: of the export; None for that of the design's name.
    server_folder: str | None = None  #: the same folder as PreForm's machine names it.
    material: str | None = None  #: PreForm's label or code, instead of the resin's default.
    form_file: str | None = None  #: to which the job is saved.
    printer: str | None = None  #: to which the job is sent; None sends nothing.
    force: bool = False  #: replace the form file, and send the job although validation found problems.


@dataclass(frozen=True)
class PreparedJob:
    """The outcome of a print job's preparation."""

    api: str  #: version.
    selection: PrintSelection  #: printer, material, setting.
    parts: tuple[str, ...]  #: in the scene.
    orientation: dict[str, str]  #: of each part, and whether it stands on supports or on the platform.
    layer_count: int | None  #: layer_count, volume_ml: of the whole job; None where PreForm gives no value.
    volume_ml: float | None
    print_time_s: float  #: estimated.
    problems: tuple[str, ...]  #: found by validation; empty if there are none.
    screenshot: str  #: screenshot, form_file: files written.
    form_file: str | None
    sent_to: str | None  #: sent_to, job_id: destination of the job; None if it was not sent.
    job_id: str | None


def prepare_job(server: PreForm, job: PrintJob, paths: PathMapping, order: PrintOrder) -> PreparedJob:
    """Create a scene, import, support, lay out and validate the parts, save picture and form file, send if requested.

    Raises:
        InputError: PreForm cannot be reached, refuses, or has no such printer or material; one line.
    """
    api = server.version()
    selection = select_settings(server.materials(), job.product, job.resin, order.material)
    with _scene(server, selection) as scene:
        names = _import(server, job, paths, scene)
        supported = [key for key, part in names.items() if part not in job.on_platform]
        if supported:
            server.support(scene, None if len(supported) == len(names) else supported)
        server.lay_out(scene)
        laid_out = server.scene(scene)
        problems = tuple(_problems(laid_out, server.validate(scene), names, job.on_platform))
        print_time_s = server.print_time_s(scene)
        picture = f"preform-{job.name.rpartition('-')[2]}.png"
        with paths.output(picture) as file:
            server.save_screenshot(scene, file)
        if order.form_file is not None:
            with paths.output(order.form_file) as file:
                server.save_form(scene, file)
        sent = order.printer if order.force or not problems else None
        job_id = None if sent is None else _send(server, scene, sent, job.name)
    return PreparedJob(
        api=api,
        selection=selection,
        parts=tuple(names.values()),
        orientation={part: job.stands(part) for part in names.values()},
        layer_count=laid_out.layer_count,
        volume_ml=laid_out.material_usage.volume_ml,
        print_time_s=print_time_s,
        problems=problems,
        screenshot=paths.display(picture),
        form_file=None if order.form_file is None else paths.display(order.form_file),
        sent_to=sent,
        job_id=job_id,
    )


@contextmanager
def _scene(server: PreForm, selection: PrintSelection) -> Iterator[str]:
    """Yield a new scene and delete it in the end: the server keeps scenes in memory, and its id is known only here."""
    scene = server.new_scene(selection.scene_settings).id
    try:
        yield scene
    finally:
        with suppress(InputError):  # what went wrong before it is what matters
            server.delete(scene)


def _import(server: PreForm, job: PrintJob, paths: PathMapping, scene: str) -> dict[str, str]:
    """Import every part, and check that it is present, in its size and upright; return names by id."""
    names: dict[str, str] = {}
    for part, size in job.sizes.items():
        server.import_model(scene, paths.server_path(job.file(part)), part, part in job.upside_down)
        new = [model for model in server.scene(scene).models if model.id not in names]
        if len(new) != 1:
            raise PreFormError(
                f"PreForm imported {part} as {len(new)} models, not one; open {paths.server_path(job.file(part))} there"
            )
        _check_size(part, new[0], size)
        names[new[0].id] = part
    return names


def _check_size(part: str, model: SceneModel, size: tuple[float, float, float]) -> None:
    if model.bounding_box is None:
        return
    seen = model.bounding_box.size
    if any(abs(a - b) > SIZE_TOLERANCE for a, b in zip(seen, size, strict=True)):
        shown = [" x ".join(f"{v:.1f}" for v in lengths) for lengths in (seen, size)]
        raise PreFormError(
            f"PreForm reads {part} as {shown[0]} mm; its file has {shown[1]} mm: wrong units, or not upright"
        )


def _problems(
    scene: PrintScene, validation: PrintValidation, names: dict[str, str], on_platform: frozenset[str]
) -> Iterator[str]:
    """Yield one line per problem that would spoil the print."""
    # PreForm wraps ids into braces in some responses and not in others.
    checked = {key.strip("{}"): value for key, value in validation.per_model_results.items()}
    for model in scene.models:
        part = names.get(model.id, model.id)
        if model.in_bounds is False:
            yield f"{part}: outside the build volume"
        if model.has_supports is False and part not in on_platform:
            yield f"{part}: without supports"
        found = checked.get(model.id.strip("{}"))
        if found is None:
            yield f"{part}: PreForm did not validate it"
            continue
        if found.cups:
            yield f"{part}: {found.cups} cup(s) that trap resin"
        if found.unsupported_minima:
            yield f"{part}: {found.unsupported_minima} place(s) that begin in mid-air"
        if found.undersupported:
            yield f"{part}: too few supports"
    for lost in names.keys() - {model.id for model in scene.models}:
        yield f"{names[lost]}: no longer in the scene"


def _send(server: PreForm, scene: str, printer: str, name: str) -> str:
    try:
        return server.send(scene, printer, name)
    except RefusedError:
        raise
    except PreFormError as error:
        raise NoResponseError(f"{error}; whether {printer} has received the job is unknown; check its queue") from None
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted; whether {printer} has received the job is unknown; check its queue"
        ) from None
