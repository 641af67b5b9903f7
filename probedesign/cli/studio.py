"""`probedesign studio`: design a probe by moving sliders and looking."""

import webbrowser
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.console import print_note, show_progress
from probedesign.cli.options import design_file
from probedesign.core.errors import InputError, require


def studio(
    design: str = "large",
    /,
    *,
    port: int = 8085,
    open_: Annotated[bool, Parameter(name="--open", negative="--no-open")] = True,
) -> None:
    """Design a probe in the browser: sliders, the bent probe, predicted errors. Needs the extra 'view'.

    Only this machine can open it; Ctrl-C ends it. Nothing is written before a button is pressed. More: docs/studio.md.

    Args:
        design: the design file, or its name, or one of the paper's probes: large, medium or small.
        port: TCP port; the next free port is used.
        open_: open the page in a browser.
    """
    require("viser", "studio", "view")
    if not 0 < port < 65536:
        raise InputError(f"--port {port} must lie in 1 ... 65535")
    with show_progress() as on_progress:
        on_progress("loading the design", None)
        from probedesign.design import load_design
        from probedesign.studio.session import Session

        session = Session(load_design(design_file(Path(design))))
        on_progress("predicting (the first run compiles the rod and the estimator, half a minute)", None)
        from probedesign.studio.page import StudioPage

        page = StudioPage(session, port)
    try:
        print(f"studio: {page.url}  (Ctrl-C ends it)", flush=True)
        if open_ and not webbrowser.open(page.url):
            print_note("no browser was found; open the address by hand")
        page.wait()
    except KeyboardInterrupt:
        pass
    finally:
        page.stop()
