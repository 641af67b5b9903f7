"""Writes the guard's state to a register of a robot of Universal Robots, by RTDE: python ur_guard.py ROBOT [PORT]

The register is 0 while the robot may move and 1 where it must stop; it is written every 4 ms. The program of the robot:

    rtde_set_watchdog("input_int_register_24", 50, "stop")   # this computer or its network has failed
    thread guard():
      while True:
        if read_input_integer_register(24) != 0:
          stopl(5.0)                                         # deceleration, m/s²
          halt
        end
        sync()
      end
    end

Source: Universal Robots, Real-Time Data Exchange (RTDE) guide, protocol version 2, and the script manual.
"""

import socket
import struct
import sys
import time

from receive_guard import GuardEvents

PORT = 30004
PERIOD = 0.004  # s
REGISTER = "input_int_register_24"  # 24 to 47 are for clients like this one


class Rtde:
    """A connection that writes one register. A package is its length, its type (a letter), and its content."""

    def __init__(self, host: str, port: int = PORT):
        self._link = socket.create_connection((host, port), timeout=1.0)
        self._link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._request("V", struct.pack(">H", 2)) != b"\x01":
            raise ConnectionError("the controller does not know version 2 of the protocol")
        self._request("O", struct.pack(">d", 1.0) + b"timestamp")  # it starts only if something is sent to this side
        reply = self._request("I", REGISTER.encode())
        self._recipe, types = reply[0], reply[1:]
        if types != b"INT32":
            raise ConnectionError(f"{REGISTER}: {types.decode(errors='replace')}")  # IN_USE by another client
        if self._request("S") != b"\x01":
            raise ConnectionError("the controller does not start the exchange")
        self._link.setblocking(False)

    def write(self, value: int) -> None:
        """Write the register, and discard what the controller has sent."""
        self._link.sendall(struct.pack(">HBBi", 8, ord("U"), self._recipe, value))
        try:
            if not self._link.recv(4096):
                raise ConnectionError("the controller has closed the connection")
        except BlockingIOError:
            pass

    def _request(self, kind: str, content: bytes = b"") -> bytes:
        self._link.sendall(struct.pack(">HB", 3 + len(content), ord(kind)) + content)
        while True:
            length, answered = struct.unpack(">HB", self._read(3))
            answer = self._read(length - 3)
            if answered == ord(kind):  # the controller may send a text message in between
                return answer

    def _read(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            data += (part := self._link.recv(size - len(data)))
            if not part:
                raise ConnectionError("the controller has closed the connection")
        return data


def forward(guard: GuardEvents, robot: Rtde, ended=lambda: False) -> None:
    """Write the state of the guard until the end; a stop stays until the guard is reset."""
    shown = None
    while not ended():
        reason = guard.reason()
        robot.write(1 if reason else 0)
        if reason != shown:
            shown = reason
            print("stop:" if reason else "go", reason, flush=True)
        time.sleep(PERIOD)


if __name__ == "__main__":
    try:
        forward(GuardEvents(int(sys.argv[2]) if len(sys.argv) > 2 else 9003), Rtde(sys.argv[1]))
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
