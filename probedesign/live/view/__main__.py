"""The process that shows the page, so that drawing and browsers never hold up who estimates.

Its standard input brings a pickled `Setup`, then a `Moment` after the other, from the process that started it; its
standard output brings back lines of JSON: where the page is, what people ask, why it failed. It ends with its input.
"""

import json
import logging
import os
import pickle
import sys
from threading import Lock


def main() -> None:
    """Show what comes until nothing comes any more."""
    back = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(
        os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno()
    )  # viser says hello, but not to our terminal
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    lock = Lock()

    def tell(**message: str) -> None:
        with lock:
            back.write(json.dumps(message) + "\n")
            back.flush()

    try:
        from probedesign.live.view.page import Page, own_page_only

        setup = pickle.load(sys.stdin.buffer)
        own_page_only(setup.host)
        page = Page(setup, lambda wish, text: tell(wish=wish, text=text))
        tell(url=page.url)
        while True:
            page.show(pickle.load(sys.stdin.buffer))
    except (EOFError, BrokenPipeError):
        pass  # the run is over
    except Exception as error:
        tell(error=f"{error} ({type(error).__name__})")
    os._exit(0)  # threads of a browser that does not close are not waited for


if __name__ == "__main__":
    main()
