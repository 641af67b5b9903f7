"""From exported parts to a job that is ready to print: the one order in which PreForm is asked."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from probedesign.errors import InputError
from probedesign.printing.preform.connection import NoAnswerError, PreFormError, RefusedError
from probedesign.printing.preform.job import Parts, PrintJob
from probedesign.printing.preform.places import Places
from probedesign.printing.preform.replies import Model, Scene, Validation
from probedesign.printing.preform.server import PreForm
from probedesign.printing.preform.settings import Chosen, choose

SIZE_TOLERANCE = 0.2
"""Of a model as PreForm sees it [mm]: two layers; inches or a tilt are far off (assumed)."""


@dataclass(frozen=True)
class Order:
    """What a user asks for.

    Attributes:
        parts: the probe, or the adapters.
        folder: of the export; None for that of the design's name.
        server_folder: the same folder as PreForm's machine names it.
        material: PreForm's label or code, instead of the resin's own.
        form_file: to save the job to.
        printer: to send the job to; None sends nothing.
        force: replace the form file, and send the job although validation finds problems.
    """

    parts: Parts = "probe"
    folder: Path | None = None
    server_folder: str | None = None
    material: str | None = None
    form_file: str | None = None
    printer: str | None = None
    force: bool = False


@dataclass(frozen=True)
class Prepared:
    """What PreForm made of a job.

    Attributes:
        api: version.
        chosen: printer, material, setting.
        parts: in the scene.
        layer_count, volume_ml: of the whole; None where PreForm does not say.
        print_time_s: estimated.
        problems: that validation found; empty is good.
        screenshot, form_file: files written.
        sent_to, job_id: where the job was sent; None if nowhere.
    """

    api: str
    chosen: Chosen
    parts: tuple[str, ...]
    layer_count: int | None
    volume_ml: float | None
    print_time_s: float
    problems: tuple[str, ...]
    screenshot: str
    form_file: str | None
    sent_to: str | None
    job_id: str | None


def prepare(server: PreForm, job: PrintJob, places: Places, order: Order) -> Prepared:
    """Scene, import, supports, layout, validation, time, picture, form file, and only if ordered the printer.

    Raises:
        InputError: PreForm cannot be reached, refuses, or has no such printer or material; one line.
    """
    api = server.version()
    chosen = choose(server.materials(), job.product, job.resin, order.material)
    with _scene(server, chosen) as scene:
        names = _import(server, job, places, scene)
        server.support(scene)
        server.lay_out(scene)
        laid_out = server.scene(scene)
        problems = tuple(_problems(laid_out, server.validate(scene), names))
        print_time_s = server.print_time_s(scene)
        picture = f"preform-{job.name.rpartition('-')[2]}.png"
        with places.written(picture) as file:
            server.save_screenshot(scene, file)
        if order.form_file is not None:
            with places.written(order.form_file) as file:
                server.save_form(scene, file)
        sent = order.printer if order.force or not problems else None
        job_id = None if sent is None else _send(server, scene, sent, job.name)
    return Prepared(
        api=api,
        chosen=chosen,
        parts=tuple(names.values()),
        layer_count=laid_out.layer_count,
        volume_ml=laid_out.material_usage.volume_ml,
        print_time_s=print_time_s,
        problems=problems,
        screenshot=places.shown(picture),
        form_file=None if order.form_file is None else places.shown(order.form_file),
        sent_to=sent,
        job_id=job_id,
    )


@contextmanager
def _scene(server: PreForm, chosen: Chosen) -> Iterator[str]:
    """A scene that is forgotten in the end: the server keeps it in memory, and nobody could name it again."""
    scene = server.new_scene(chosen.scene_settings).id
    try:
        yield scene
    finally:
        with suppress(InputError):  # what went wrong before it is what matters
            server.delete(scene)


def _import(server: PreForm, job: PrintJob, places: Places, scene: str) -> dict[str, str]:
    """Put every part into the scene, and see that it is there, in its size and upright; names by id."""
    names: dict[str, str] = {}
    for part, size in job.sizes.items():
        server.import_model(scene, places.model(job.file(part)), part)
        new = [model for model in server.scene(scene).models if model.id not in names]
        if len(new) != 1:
            raise PreFormError(
                f"PreForm imported {part} as {len(new)} models, not one; open {places.model(job.file(part))} there"
            )
        _check_size(part, new[0], size)
        names[new[0].id] = part
    return names


def _check_size(part: str, model: Model, size: tuple[float, float, float]) -> None:
    if model.bounding_box is None:
        return
    seen = model.bounding_box.size
    if any(abs(a - b) > SIZE_TOLERANCE for a, b in zip(seen, size, strict=True)):
        told = [" x ".join(f"{v:.1f}" for v in lengths) for lengths in (seen, size)]
        raise PreFormError(
            f"PreForm sees {part} as {told[0]} mm, its file says {told[1]} mm: not its size, or not upright"
        )


def _problems(scene: Scene, validation: Validation, names: dict[str, str]) -> Iterator[str]:
    """What would spoil the print, a line each."""
    # PreForm wraps ids into braces in some answers and not in others.
    checked = {key.strip("{}"): value for key, value in validation.per_model_results.items()}
    for model in scene.models:
        part = names.get(model.id, model.id)
        if model.in_bounds is False:
            yield f"{part}: outside the build volume"
        if model.has_supports is False:
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
        raise NoAnswerError(f"{error}; whether {printer} has the job is not known: look there") from None
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted; whether {printer} has the job is not known: look there"
        ) from None
