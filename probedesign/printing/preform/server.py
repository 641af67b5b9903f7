"""PreForm's local API, call by call."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar
from urllib.parse import quote

from pydantic import ValidationError

from probedesign.design_problems import one_line
from probedesign.printing.limits import HEIGHT_ABOVE_RAFT, RAFT_THICKNESS
from probedesign.printing.preform.connection import (
    Connection,
    NoAnswerError,
    PreFormError,
    RefusedError,
    told_error,
)
from probedesign.printing.preform.replies import (
    Accepted,
    Estimate,
    Materials,
    Operation,
    Reply,
    Scene,
    Uploaded,
    Validation,
    Version,
)

R = TypeVar("R", bound=Reply)
Tell = Callable[[str, float | None], None]

UPRIGHT = {"z_direction": [0.0, 0.0, 1.0], "x_direction": [1.0, 0.0, 0.0]}
"""Up in the part is up in the scene. PreForm would tilt it."""
SUPPORTS = {
    "raft_type": "FULL_RAFT",
    "raft_thickness_mm": RAFT_THICKNESS,
    "height_above_raft_mm": HEIGHT_ABOVE_RAFT,
    "internal_supports_enabled": False,
}
"""As the print check counted them: below the part, none that stands on it. Density and touchpoints are PreForm's."""


FORGET_S = 5.0
FIRST_POLL_S = 0.05


def quiet(_step: str, _share: float | None) -> None:
    """Tell nobody."""


@dataclass(frozen=True)
class PreForm:
    """A PreFormServer.

    Attributes:
        connection: to it.
        operation_s: what one long operation may take; the server itself gives up after ten minutes.
        poll_s: longest time between questions how far it is.
        tell: is told each step, with the share done where PreForm says it.
    """

    connection: Connection
    operation_s: float = 600.0
    poll_s: float = 1.0
    tell: Tell = quiet

    def version(self) -> str:
        """Of its API."""
        return self._ask(Version, "the version", "GET", "/").version

    def materials(self) -> Materials:
        """Printers, resins and settings that it knows."""
        return self._ask(Materials, "the list of materials", "GET", "/list-materials/")

    def new_scene(self, settings: dict[str, Any]) -> Scene:
        """An empty scene for one printer, resin and layer."""
        return self._ask(Scene, "a new scene", "POST", "/scene/", settings)

    def scene(self, scene: str) -> Scene:
        """What the scene holds now."""
        return self._ask(Scene, "the scene", "GET", _at(scene))

    def delete(self, scene: str) -> None:
        """Forget a scene; soon, since somebody may be waiting for the prompt."""
        replace(self.connection, timeout_s=FORGET_S).ask("the end of the scene", "DELETE", _at(scene))

    def import_model(self, scene: str, file: str, name: str) -> None:
        """Put a part into the scene, upright. Left alone, PreForm guesses units and refuses flaws."""
        body = {
            "file": file, "name": name, "repair_behavior": "REPAIR", "units": "MILLIMETERS", "orientation": UPRIGHT,
        }  # fmt: skip
        self._operate(Reply, f"the import of {name}", "POST", f"{_at(scene)}import-model/", body)

    def support(self, scene: str) -> None:
        """Raft and supports below all parts."""
        self._operate(Reply, "supports", "POST", f"{_at(scene)}auto-support/", {"models": "ALL", **SUPPORTS})

    def lay_out(self, scene: str) -> None:
        """All parts onto the platform."""
        self._operate(Reply, "the layout", "POST", f"{_at(scene)}auto-layout/", {"models": "ALL"})

    def validate(self, scene: str) -> Validation:
        """Cups, islands, too few supports."""
        return self._operate(Validation, "print validation", "GET", f"{_at(scene)}print-validation/")

    def print_time_s(self, scene: str) -> float:
        """Estimated [s]."""
        path = f"{_at(scene)}estimate-print-time/"
        return self._operate(Estimate, "the print time", "POST", path, {}).total_print_time_s

    def save_screenshot(self, scene: str, file: str) -> None:
        """A picture, to a path on the server's machine."""
        self._operate(Reply, "a picture", "POST", f"{_at(scene)}save-screenshot/", {"file": file})

    def save_form(self, scene: str, file: str) -> None:
        """The job as PreForm's own file, to a path on the server's machine."""
        self._operate(Reply, "the form file", "POST", f"{_at(scene)}save-form/", {"file": file})

    def send(self, scene: str, printer: str, job_name: str) -> str:
        """Upload the job to a printer's queue, where a person starts it; returns its id."""
        body = {"printer": printer, "job_name": job_name, "print_now": False}
        return self._operate(Uploaded, "the upload", "POST", f"{_at(scene)}print/", body).job_id

    def _ask(self, kind: type[R], what: str, method: str, path: str, body: dict[str, Any] | None = None) -> R:
        self.tell(what, None)
        return self._checked(kind, what, self.connection.ask(what, method, path, body))

    def _operate(
        self, kind: type[R], what: str, method: str, path: str, body: dict[str, Any] | None = None
    ) -> R:
        """Start a long operation and wait for its end."""
        self.tell(what, None)
        answer = self.connection.ask(what, method, f"{path}?async=true", body)
        operation = self._checked(Accepted, what, answer).operationId
        if operation is None:  # it was short
            return self._checked(kind, what, answer)
        return self._checked(kind, what, self._wait(what, operation))

    def _wait(self, what: str, operation: str) -> dict[str, Any]:
        deadline = time.monotonic() + self.operation_s
        pause_s = FIRST_POLL_S
        while True:
            state = self._checked(Operation, what, self._progress(what, operation))
            if state.status == "SUCCEEDED":
                return state.result or {}
            if state.status == "FAILED":
                raise RefusedError(
                    one_line(f"PreForm fails at {what}: {told_error(state.result) or 'it does not say why'}")
                )
            if time.monotonic() > deadline:
                raise NoAnswerError(
                    f"PreForm is not done with {what} after {self.operation_s:g} s ({_percent(state.progress)} done); "
                    "--timeout-s gives it more"
                )
            self.tell(what, min(max(state.progress, 0.0), 1.0))
            time.sleep(min(pause_s, self.poll_s))
            pause_s *= 1.5  # most are done soon, supports may take minutes

    def _progress(self, what: str, operation: str) -> dict[str, Any]:
        try:
            return self.connection.ask(what, "GET", f"/operations/{quote(operation, safe='')}/")
        except RefusedError as error:  # it refuses to tell, which says nothing of the operation
            raise NoAnswerError(str(error)) from None

    def _checked(self, kind: type[R], what: str, answer: dict[str, Any]) -> R:
        try:
            return kind.model_validate(answer)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(map(str, first["loc"]))
            raise PreFormError(
                one_line(
                    f"{self.connection.url} is not PreForm: its answer to {what}: {where}: {first['msg']}"
                )
            ) from None


def _at(scene: str) -> str:
    return f"/scene/{quote(scene, safe='')}/"


def _percent(share: float) -> str:
    return f"{min(max(share, 0.0), 1.0):.0%}"
