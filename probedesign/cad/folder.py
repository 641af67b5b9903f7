"""The folder of an export: written whole or not at all."""

import hashlib
import json
import os
import re
import shutil
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from probedesign.core.errors import InputError
from probedesign.core.parallel import defer_sigint

MANIFEST = "manifest.json"


def listed_digests(folder: Path) -> dict[str, str]:
    """Return the digests of the files that the folder's manifest lists; none if it cannot be read."""
    try:
        files = json.loads((folder / MANIFEST).read_text("utf-8"))["files"]
        return {str(name): str(record.get("sha256", "")) for name, record in files.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def check_target(folder: Path, kind: str = "export") -> None:
    """Check, before any work, that a folder can be written or created and does not hold files of another kind.

    Args:
        folder: to write to.
        kind: `kind` of its manifest; one without it is of an export.
    """
    nearest = next(path for path in (folder, *folder.parents) if path.exists())
    if not nearest.is_dir():
        inside = "" if nearest == folder else f"{folder}: "
        raise InputError(f"{inside}{nearest} is a file; name a folder to export into")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError(f"{folder}: cannot be written: no permission in {nearest}")
    present = kind
    with suppress(OSError, ValueError, AttributeError):
        present = json.loads((folder / MANIFEST).read_text("utf-8")).get("kind", "export")
    if present != kind:
        raise InputError(f"{folder}: has files of another kind, '{present}'; name another folder")


def digests(contents: Mapping[str, bytes]) -> dict[str, dict[str, Any]]:
    """Return digest and size of each file for the manifest."""
    return {
        name: {"sha256": hashlib.sha256(content).hexdigest(), "size_bytes": len(content)}
        for name, content in sorted(contents.items())
    }


def write_export(folder: Path, contents: Mapping[str, bytes], manifest: dict[str, Any]) -> dict[str, Any]:
    """Write files and their manifest, all or none, and return the manifest with the folder."""
    with staged(folder) as staging:
        for name, content in contents.items():
            (staging / name).write_bytes(content)
        (staging / MANIFEST).write_text(manifest_json(manifest), "utf-8")
    return {**manifest, "folder": str(folder)}


def manifest_json(manifest: dict[str, Any]) -> str:
    """Return readable JSON: each row of numbers on one line."""
    text = json.dumps(manifest, indent=2, ensure_ascii=False, allow_nan=False)
    row = re.compile(r"\[\n\s+([^\[\]{}\"]*?)\n\s+\]")
    return row.sub(lambda m: "[" + re.sub(r",\n\s+", ", ", m[1]) + "]", text) + "\n"


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """Yield a temporary sibling of `folder`; its files move there on success and are deleted otherwise."""
    staging = folder.parent / f".{folder.name}.{uuid.uuid4().hex[:8]}.partial"
    try:
        staging.mkdir(parents=True)
        yield staging
        with defer_sigint():
            _put_in_place(staging, folder)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _put_in_place(staging: Path, folder: Path) -> None:
    """Move the files into place. Files of the folder's last export that this one lacks are removed; all others stay.

    The old manifest is removed first and the new one moved last, so a folder with a manifest is a complete export.
    """
    if not folder.exists():
        staging.rename(folder)
        return
    listed = listed_digests(folder)
    made_before = {path.name for path in folder.iterdir() if path.name in listed and path.is_file()}
    outdated = made_before - {path.name for path in staging.iterdir()}
    (folder / MANIFEST).unlink(missing_ok=True)
    for name in outdated:
        (folder / name).unlink(missing_ok=True)
    for path in sorted(staging.iterdir(), key=lambda path: path.name == MANIFEST):
        path.replace(folder / path.name)
