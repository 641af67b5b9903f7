"""A PreFormServer on the loopback that follows the published API, keeps a diary, and fails when message to.

Source: Formlabs Local API 0.9.7 (formlabs-api-local-openapi.yaml): paths, bodies, required keys, replies.
"""

import json
import threading
import uuid
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np

PNG = b"\x89PNG\r\n\x1a\n" + bytes(16)
STL_RECORD = np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])


def settings(machine: str, code: str, layer: Any, name: str = "DEFAULT", label: str = "Default") -> dict[str, Any]:
    shown = layer if isinstance(layer, str) else f"{layer:.3f} mm"
    return {
        "label": f"{shown} ({label} settings)",
        "scene_settings": {
            "machine_type": machine, "material_code": code, "layer_thickness_mm": layer, "print_setting": name,
        },
    }  # fmt: skip


MATERIALS = {
    "printer_types": [
        {
            "label": "Form 3/3+",
            "build_volume_dimensions_mm": [145, 145, 185],
            "supported_machine_type_ids": ["FORM-3-0", "FORM-3-1", "FORM-3-2"],
            "supported_product_names": ["Form 3", "Form 3+"],
            "materials": [
                {
                    "label": "Elastic 50A V1",
                    "description": "For parts that must bend, stretch, and compress",
                    "material_settings": [
                        settings("FORM-3-1", "FLELCL01", 0.1, "LEGACY", "Legacy"),
                        settings("FORM-3-1", "FLELCL01", 0.1, "STAGE3_DEFAULT"),
                    ],
                },
                {"label": "Elastic 50A V2", "material_settings": [settings("FORM-3-1", "FLELCL02", 0.1)]},
                {"label": "Flexible 80A V2", "material_settings": [settings("FORM-3-1", "FLFL8002", 0.1)]},
                {
                    "label": "Grey V4",
                    "material_settings": [
                        settings("FORM-3-1", "FLGPGR04", "ADAPTIVE"),
                        settings("FORM-3-1", "FLGPGR04", 0.05, "STAGE3_DEFAULT"),
                        settings("FORM-3-1", "FLGPGR04", 0.1, "STAGE3_DEFAULT"),
                    ],
                },
                {"label": "Draft V1", "material_settings": [settings("FORM-3-1", "FLDRBL01", 0.3)]},
            ],
        },
        {
            "label": "Form 3L",
            "build_volume_dimensions_mm": [336, 200, 300],
            "supported_machine_type_ids": ["DGSR-1-0", "FRML-3-0"],
            "supported_product_names": ["Form 3L"],
            "materials": [{"label": "Elastic 50A V1", "material_settings": [settings("DGSR-1-0", "FLELCL01", 0.1)]}],
        },
    ]
}


class Refusal(Exception):
    """Response of one call, with the wording of PreForm."""

    def __init__(self, status: int, code: str, message: str) -> None:
        super().__init__(message)
        self.status, self.answer = status, {"error": {"code": code, "message": message}}


class FakePreForm:
    """The server's state.

    Attributes:
        diary: every request as (method, path without ids, body).
        scenes: that it holds.
        faults: by the last part of a path, what to do instead of answering: a function of the handler that returns
            whether it has answered.
        failing: by the last part of a path, an error with which its operation ends.
        validation: result of print validation for each model.
        polls: how often an operation is asked before it is done.
    """

    def __init__(self) -> None:
        self.diary: list[tuple[str, str, Any]] = []
        self.scenes: dict[str, dict[str, Any]] = {}
        self.operations: dict[str, dict[str, Any]] = {}
        self.faults: dict[str, Any] = {}
        self.failing: dict[str, dict[str, Any]] = {}
        self.validation: dict[str, Any] = {"cups": 0, "unsupported_minima": 0, "undersupported": False}
        self.model: dict[str, Any] = {}
        self.polls = 1
        self.writes = True
        self.root: tuple[str, Path] | None = None
        self.printed: list[dict[str, Any]] = []
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), self._handler())
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)

    def __enter__(self) -> "FakePreForm":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._server.server_address[1]}"

    @property
    def calls(self) -> list[str]:
        """The requests, without those for the progress of an operation."""
        return [f"{method} {path}" for method, path, _ in self.diary if not path.startswith("/operations")]

    def body(self, last: str) -> Any:
        """Return the body of the last request to a path with this ending."""
        return [body for _, path, body in self.diary if path.rstrip("/").endswith(last)][-1]

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        fake = self

        class Handler(BaseHTTPRequestHandler):
            fake: "FakePreForm"
            protocol_version = "HTTP/1.1"
            disable_nagle_algorithm = True  # else each answer waits 40 ms for an acknowledgement

            def log_message(self, *_: Any) -> None:
                """Say nothing."""

            def _any(self) -> None:
                path, _, query = self.path.partition("?")
                raw = self.rfile.read(int(self.headers.get("Content-Length") or 0))
                body = json.loads(raw) if raw else None
                parts = [part for part in path.split("/") if part]
                message = "/".join("*" if part in fake.scenes or part in fake.operations else part for part in parts)
                fake.diary.append((self.command, f"/{message}/" if message else "/", body))
                fault = fake.faults.get(parts[-1] if parts and parts[0] != "operations" else parts[0] if parts else "/")
                if fault is not None and fault(self):
                    return
                try:
                    self.answer(*fake.answer(self.command, parts, body, query == "async=true"))
                except Refusal as refusal:
                    self.answer(refusal.status, refusal.answer)

            do_GET = do_POST = do_DELETE = _any

            def answer(self, status: int, answer: Any) -> None:
                self.raw(status, json.dumps(answer).encode())

            def raw(self, status: int, content: bytes, kind: str = "application/json") -> None:
                self.send_response(status)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(content)))
                self.end_headers()
                self.wfile.write(content)

        Handler.fake = fake
        return Handler

    def answer(self, method: str, parts: list[str], body: Any, later: bool) -> tuple[int, Any]:
        match method, parts:
            case "GET", []:
                return 200, {"version": "0.9.7"}
            case "GET", ["list-materials"]:
                return 200, MATERIALS
            case "POST", ["scene"]:
                return 200, self._new_scene(body)
            case "GET", ["operations", operation]:
                return 200, self._progress(operation)
            case _, ["scene", scene, *rest] if scene in self.scenes:
                return self._of_scene(method, self.scenes[scene], rest, body, later)
        raise Refusal(404, "NOT_FOUND", "no such resource")

    def _of_scene(self, method: str, scene: dict[str, Any], rest: list[str], body: Any, later: bool) -> tuple[int, Any]:
        match method, rest:
            case "GET", []:
                return 200, scene
            case "DELETE", []:
                return 200, self.scenes.pop(scene["id"])
            case (("POST" | "GET"), [name]):
                if not later:
                    return 200, self._do(name, scene, body)
                return 202, {"operationId": self._start(name, scene, body)}
        raise Refusal(404, "NOT_FOUND", "no such resource")

    def _start(self, name: str, scene: dict[str, Any], body: Any) -> str:
        operation = str(uuid.uuid4())
        try:
            done = {"status": "SUCCEEDED", "result": self._do(name, scene, body)}
        except Refusal as refusal:
            done = {"status": "FAILED", "result": refusal.answer}
        if name in self.failing:
            done = {"status": "FAILED", "result": self.failing[name]}
        self.operations[operation] = {"left": self.polls, "done": {"id": operation, "progress": 1.0, **done}}
        return operation

    def _progress(self, operation: str) -> dict[str, Any]:
        state = self.operations.get(operation)
        if state is None:
            raise Refusal(404, "OPERATION_NOT_FOUND", "Operation not found")
        state["left"] -= 1
        if state["left"] < 0:
            return dict(state["done"])
        return {"id": operation, "status": "IN_PROGRESS", "progress": 1.0 - (state["left"] + 1) / (self.polls + 1)}

    def _new_scene(self, body: Any) -> dict[str, Any]:
        known = [
            setting["scene_settings"]
            for printer in MATERIALS["printer_types"]
            for material in printer["materials"]
            for setting in material["material_settings"]
        ]
        if body not in known:
            raise Refusal(400, "INPUT_ERROR", "Scene type not supported")
        scene = str(uuid.uuid4())
        self.scenes[scene] = {"id": scene, "models": [], "scene_settings": body, "layer_count": 0,
                              "material_usage": {"volume_ml": 0.0, "unsupported_volume_ml": 0.0}}  # fmt: skip
        return self.scenes[scene]

    def _do(self, name: str, scene: dict[str, Any], body: Any) -> Any:
        match name:
            case "import-model":
                return self._import(scene, body)
            case "auto-support":
                for model in scene["models"]:
                    if body["models"] == "ALL" or model["id"] in body["models"]:
                        model["has_supports"] = True
                scene |= {"layer_count": 1600, "material_usage": {"volume_ml": 12.34, "unsupported_volume_ml": 8.0}}
                return {}
            case "auto-layout":
                return scene
            case "print-validation":
                # As a PreFormServer was seen to answer: ids in braces here, without them in the scene.
                return {"per_model_results": {f"{{{m['id']}}}": self.validation for m in scene["models"]}}
            case "estimate-print-time":
                return {"total_print_time_s": 15120.0, "preprint_time_s": 120.0, "printing_time_s": 15000.0}
            case "save-screenshot" | "save-form":
                return self._write(body["file"], PNG if name == "save-screenshot" else b"form")
            case "print":
                self.printed.append({**body, "models": len(scene["models"])})
                return {"job_id": "4711"}
        raise Refusal(404, "NOT_FOUND", "no such resource")

    def _here(self, path: str) -> Path:
        """The file that the server's machine means; with `root`, its disk is elsewhere."""
        if self.root is None:
            return Path(path)
        there, here = self.root
        if not path.startswith(there):
            raise Refusal(400, "FILE_NOT_FOUND", f"{path} does not exist")
        return here / path[len(there) :].lstrip("\\/")

    def _import(self, scene: dict[str, Any], body: Any) -> dict[str, Any]:
        path = self._here(body["file"])
        if not path.is_file():
            raise Refusal(400, "FILE_NOT_FOUND", f"{body['file']} does not exist")
        if body.get("repair_behavior") != "REPAIR":
            raise Refusal(400, "MODEL_BROKEN", "The model needs repair")
        corners = np.frombuffer(path.read_bytes(), STL_RECORD, offset=84)["v"].reshape(-1, 3).astype(float)
        up, right = (np.array(body["orientation"][key]) for key in ("z_direction", "x_direction"))
        corners = corners @ np.array([right, np.cross(up, right), up]).T
        if body.get("units") != "MILLIMETERS":
            corners = corners * 25.4  # what DETECTED may come to
        low, high = (dict(zip("xyz", map(float, c), strict=True)) for c in (corners.min(0), corners.max(0)))
        model = {"id": str(uuid.uuid4()), "name": body.get("name", ""), "in_bounds": True, "has_supports": False,
                 "bounding_box": {"min_corner": low, "max_corner": high}, **self.model}  # fmt: skip
        scene["models"].append(model)
        return model

    def _write(self, file: str, content: bytes) -> dict[str, Any]:
        path = self._here(file)
        if not path.parent.is_dir():
            raise Refusal(400, "FILE_WRITE_ERROR", f"Could not write to {file}")
        if self.writes:
            path.write_bytes(content)
        return {}
