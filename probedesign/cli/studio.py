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
    host: str = "127.0.0.1",
    port: int = 8085,
    open_: Annotated[bool, Parameter(name="--open", negative="--no-open")] = True,
) -> None:
    """Design a probe in the browser: sliders, the bent probe, predicted errors. Needs the extra 'view'.

    Ctrl-C ends it. Nothing is written before a button is pressed. More: docs/studio.md.

    Args:
        design: the design file, or its name, or one of the paper's probes: large, medium or small.
        host: address of the page; only this machine can open it.
        port: TCP port; the next free port is used.
        open_: open the page in a browser.
    """
    require("viser", "studio", "view")
    if not 0 < port < 65536:
        raise InputError(f"--port {port} must lie in 1 ... 65535")
    from probedesign.web import LOOPBACK

    if host not in LOOPBACK:
        raise InputError(f"--host {host}: the studio is open to this machine only; use one of {', '.join(LOOPBACK)}")
    with show_progress() as on_progress:
        on_progress("loading the design", None)
        from probedesign.design import load_design
        from probedesign.studio.session import Session

        session = Session(load_design(design_file(Path(design))))
        on_progress("predicting (the first run compiles the rod and the estimator, half a minute)", None)
        from probedesign.studio.page import StudioPage

        page = StudioPage(session, host, port)
    try:
        print(f"studio: {page.url}  (Ctrl-C ends it)", flush=True)
        if open_ and not webbrowser.open(page.url):
            print_note("no browser was found; open the address by hand")
        page.wait()
    except KeyboardInterrupt:
        pass
    finally:
        page.stop()
