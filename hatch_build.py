"""Build hook: compile the kernels with the wheel, so that its first use compiles nothing.

`PROBEDESIGN_PRECOMPILE=1` switches it on: the build then needs numba and takes about a minute, and the wheel belongs to
one Python and one platform. Without it, the wheel is for any, and compiles at its first use, as does an installation
whose numba is another than that of the build.
"""

import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from packaging.tags import sys_tags

BUILT = "probedesign/_compiled"
IS_ON = os.environ.get("PROBEDESIGN_PRECOMPILE", "0") == "1"


class PrecompileHook(BuildHookInterface[Any]):
    """Add the compiled kernels to a wheel; an editable installation gets them beside its sources."""

    def dependencies(self) -> list[str]:
        """Return what the build needs: what the kernels import."""
        return list(self.metadata.core.dependencies) if IS_ON else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and name the files and the platform of the wheel: this Python, this platform.

        On Linux with glibc, llvmlite links the kernels when they are loaded, and to no library of the system: they run
        where its own wheels do.
        """
        if not IS_ON:
            return
        self._folder = tempfile.TemporaryDirectory(prefix="probedesign-kernels-")
        folder = Path(self.root, BUILT) if version == "editable" else Path(self._folder.name)
        self.app.display_info("compiling the kernels of rod and estimator")
        command = [sys.executable, "-m", "probedesign.precompile", str(folder)]
        subprocess.run(command, cwd=self.root, check=True, env={**os.environ, "PYTHONPATH": self.root})
        if version == "editable":
            return
        for file in folder.glob("*/*.kernel"):
            build_data["force_include"][str(file)] = f"{BUILT}/{file.relative_to(folder).as_posix()}"
        python = f"cp{sys.version_info.major}{sys.version_info.minor}"
        on_glibc = sys.platform == "linux" and platform.libc_ver()[0] == "glibc"
        manylinux = f"{python}-{python}-manylinux_2_27_{platform.machine()}"
        build_data |= {"pure_python": False, "tag": manylinux if on_glibc else str(next(sys_tags()))}

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the files that the wheel now contains."""
        if IS_ON:
            self._folder.cleanup()
