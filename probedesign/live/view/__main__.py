"""The process that serves the page, so that drawing and browsers never delay the estimator.

Its standard input receives a pickled `SceneSetup`, then one `Snapshot` after another; its standard output returns
lines of JSON: the URL of the page, commands of the user, or an error. It ends with its input.
"""

import json
import logging
import os
import pickle
import sys
from threading import Lock


def main() -> None:
    """Show snapshots until the input ends."""
    back = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # viser prints a banner
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    lock = Lock()

    def send(**message: str) -> None:
        with lock:
            back.write(json.dumps(message) + "\n")
            back.flush()

    try:
        from probedesign.live.view.page import SCRIPT, STYLE, ViewerPage
        from probedesign.web.guard import protect

        setup = pickle.load(sys.stdin.buffer)
        protect(setup.title, setup.token, f"<style>{STYLE}</style><script>{SCRIPT}</script>")
        page = ViewerPage(setup, lambda name, text: send(command=name, text=text))
        send(url=page.url)
        while True:
            page.show(pickle.load(sys.stdin.buffer))
    except (EOFError, BrokenPipeError):
        pass  # the run has ended
    except Exception as error:
        send(error=f"{error} ({type(error).__name__})")
    os._exit(0)  # do not wait for threads of an open browser


if __name__ == "__main__":
    main()
