"""`probedesign doctor`: report installed and missing packages, without importing any of them."""

import os
import platform
import re
from contextlib import suppress
from importlib import metadata
from typing import Any

from probedesign.cli.console import print_json, print_table
from probedesign.cli.options import JsonOutput

#: Features that each extra of `all`, and `notebook`, enables; "" is for the required packages.
ENABLES = {
    "": "everything",
    "notebook": "plots and data frames of results in a notebook",
    "sweep": "sweep --scheduler: grids of designs on several machines",
    "cad": "export: STL, STEP and 3MF of the parts to print",
    "live": "live with a Net F/T box, MCAP recordings, ROS 2 bags",
    "msgpack": "live with datagrams in MessagePack",
    "daq": "live with a sensor at a National Instruments card",
    "view": "studio and live --view: the probe in the browser",
    "foxglove": "live --foxglove: the server for Foxglove and PlotJuggler",
    "vision": "markers: photographs, calibration files",
}


def doctor(*, as_json: JsonOutput = False) -> int:
    """Report installed and missing packages, and the features that need them.

    Exit status 1 if a required package is missing.
    """
    findings = examine()
    if as_json:
        print_json(findings)
    else:
        _print(findings)
    return 0 if findings["ok"] else 1


def examine() -> dict[str, Any]:
    """Return the versions of all packages, the missing ones, and the state of the compiled kernels."""
    packages = []
    for line in metadata.requires("probedesign") or []:
        requirement, _, marker = line.partition(";")
        of_extra = re.search(r"extra\s*==\s*['\"](.+?)['\"]", marker)
        extra, requirement = of_extra.group(1) if of_extra else "", requirement.strip()
        if extra in ENABLES:
            name = re.split(r"[^A-Za-z0-9._-]", requirement, maxsplit=1)[0]
            installed = None
            with suppress(metadata.PackageNotFoundError):
                installed = metadata.version(name)
            packages.append({"name": name, "version": installed, "requirement": requirement, "extra": extra})
    missing = [package for package in packages if package["version"] is None]
    return {
        "ok": all(package["extra"] for package in missing),
        "probedesign": metadata.version("probedesign"),
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
        "packages": packages,
        "missing": [_remedy(extra, missing) for extra in sorted({str(p["extra"]) for p in missing})],
        "numba_cache": _numba_cache(),
    }


def _remedy(extra: str, missing: list[dict[str, str | None]]) -> dict[str, Any]:
    """Return the disabled feature and the command that installs its packages.

    The command names the packages, not the extra, so it works without an index that has this package.
    """
    wanted = [f'"{package["requirement"]}"' for package in missing if package["extra"] == extra]
    return {"extra": extra, "needed_for": ENABLES[extra], "install": f"pip install {' '.join(wanted)}"}


def _numba_cache() -> dict[str, Any]:
    """Return where compiled kernels are saved, whether that is writable, and how many are ready for this processor."""
    try:
        from probedesign.rod.kernels import cache
    except ImportError:  # numba is missing or does not run here
        return {"folder": "", "writable": True, "processor": "no processor", "kernels": 0}
    roots, folder = cache.folders(), cache.writable_folder.__wrapped__()
    kernels = {
        tuple(file.stem.split("-")[::2])  # function and types, whatever the version and the processor
        for root in roots
        for processor in cache.runs()
        for file in (root / cache.version(processor)).glob(f"*{cache.SUFFIX}")
    }
    return {
        "folder": str(folder or ""),
        "writable": folder == roots[0] if os.environ.get("NUMBA_CACHE_DIR") else folder is not None,
        "processor": cache.runs()[-1],
        "kernels": len(kernels),
    }


def _print(findings: dict[str, Any]) -> None:
    print(f"probedesign {findings['probedesign']}, Python {findings['python']}, {findings['platform']}")
    rows = {}
    for package in findings["packages"]:
        extra = f"  ({package['extra']})" if package["extra"] else ""
        rows[package["name"]] = (package["version"] or "missing") + extra
    print_table(rows)
    cache = findings["numba_cache"]
    folder = f"new ones in {cache['folder']}" if cache["folder"] else "new ones cannot be saved"
    remedy = "" if cache["writable"] else "; set NUMBA_CACHE_DIR to a folder that can be written"
    print(f"compiled kernels: {cache['kernels']} for {cache['processor']}; {folder}{remedy}")
    for missing in findings["missing"]:
        print(f"missing for {missing['needed_for']}:\n  {missing['install']}")
    if not findings["missing"]:
        print("nothing is missing")
