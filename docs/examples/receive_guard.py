"""Receives the events of `probedesign live … --guard udp://127.0.0.1:9003`: python receive_guard.py [PORT]"""

import json
import socket
import sys
import time

SILENCE = 0.03  # s without an event, after which motion must stop: three heartbeats


class GuardEvents:
    """The newest event of a guard, without waiting for one."""

    def __init__(self, port: int = 9003, stop_at_contact: bool = True):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self._socket.setblocking(False)
        self._stop_at_contact, self._newest, self._arrived = stop_at_contact, {}, -float("inf")
        self.port = self._socket.getsockname()[1]

    def reason(self) -> str:
        """Return why motion must stop; empty if it need not."""
        while True:
            try:
                event = json.loads(self._socket.recv(4096))
            except BlockingIOError:
                break
            except (OSError, ValueError):  # not of probedesign
                continue
            if isinstance(event, dict) and event.get("kind") in ("contact", "limit", "heartbeat"):
                self._newest, self._arrived = event, time.monotonic()
        if time.monotonic() - self._arrived > SILENCE:
            return "no event of the guard"
        if not self._newest.get("armed"):
            return "the guard is not armed"
        if self._newest.get("stop"):
            return str(self._newest["stop"])
        return "contact" if self._stop_at_contact and self._newest.get("contact") else ""


if __name__ == "__main__":
    guard, shown = GuardEvents(int(sys.argv[1]) if len(sys.argv) > 1 else 9003), None
    try:
        while True:
            if (reason := guard.reason()) != shown:
                shown = reason
                print("stop:", reason) if reason else print("go")
                sys.stdout.flush()
            time.sleep(0.001)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
