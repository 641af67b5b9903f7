"""Receives the datagrams of `probedesign live … --publish udp://127.0.0.1:9000`: python receive_udp.py [PORT]"""

import json
import socket
import sys

STALE = 0.5  # s without a datagram; several times the period of the estimates that you asked for


def receive(port: int):
    """Yield messages as they arrive; None after each silence of `STALE`."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", port))
        receiver.settimeout(STALE)
        newest = 0
        while True:
            try:
                message = json.loads(receiver.recv(65535))
            except TimeoutError:
                yield None
                continue
            except ValueError:  # not of probedesign
                continue
            if not isinstance(message, dict) or not isinstance(message.get("number"), int):
                continue
            if message["number"] > newest or message["number"] == 1:  # a late datagram has nothing new
                newest = message["number"]
                yield message


def show(message) -> None:
    """Print one message."""
    if message is None:
        print("stale: no datagram arrived")
    elif message["kind"] == "event":
        print("event:", message["event"])
    elif message["result"] == "ok":
        print(f"touched at s = {message['s_contact_mm']:.1f} ± {message['std_s_mm']:.1f} mm")
    else:
        print(message["result"])  # no position, whatever the other fields contain
    sys.stdout.flush()


if __name__ == "__main__":
    try:
        for each in receive(int(sys.argv[1]) if len(sys.argv) > 1 else 9000):
            show(each)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
