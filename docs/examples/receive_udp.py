"""Receives what `probedesign live … --publish udp://127.0.0.1:9000` sends: python receive_udp.py [PORT]"""

import json
import socket
import sys

STALE = 0.5  # s without a datagram; several times the period of the estimates that you asked for


def receive(port: int):
    """Messages as they come; None after each silence of `STALE`."""
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
            if message["number"] > newest or message["number"] == 1:  # a late datagram is no news
                newest = message["number"]
                yield message


if __name__ == "__main__":
    for message in receive(int(sys.argv[1]) if len(sys.argv) > 1 else 9000):
        if message is None:
            print("stale: nothing came")
        elif message["kind"] == "event":
            print("event:", message["event"])
        elif message["result"] == "ok":
            print(f"touched at s = {message['s_contact_mm']:.1f} ± {message['std_s_mm']:.1f} mm")
        else:
            print(message["result"])  # no position, whatever the other fields hold
        sys.stdout.flush()
