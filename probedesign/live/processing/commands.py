"""Commands of the user during a run: a queue to the processing thread, and where they come from beside the page.

That is keys in the terminal, and datagrams, which the services of ROS 2 use.
"""

import json
import os
import select
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any, Literal, NamedTuple, get_args

from probedesign.core.errors import InputError, ProbeDesignError, one_line
from probedesign.live import Log
from probedesign.live.datagrams import Listener, Parsed, decode_object, parse_listen_address

CommandName = Literal["tare", "mark", "start recording", "stop recording", "reset", "stop"]


#: Every command and its key in the terminal. The page, datagrams and services of ROS 2 offer these, too.
COMMANDS: dict[CommandName, str] = {
    "tare": "t", "mark": "m", "start recording": "r", "stop recording": "s", "reset": "x", "stop": "q",
}  # fmt: skip
MAX_NOTE = 200  #: Maximum number of characters of a mark.


class CommandResult(NamedTuple):
    """Whether a command was accepted, and the outcome or the reason of the refusal."""

    accepted: bool
    text: str


class Command(NamedTuple):
    """One command of the user, with the text of a mark, and a callback that receives the result."""

    name: CommandName
    text: str = ""
    reply: Callable[[CommandResult], None] = lambda result: None


class CommandQueue:
    """Passes commands from any thread to the processing thread, which executes them between two blocks of readings."""

    def __init__(self) -> None:
        self._queue: SimpleQueue[Command] = SimpleQueue()
        self._handlers: dict[CommandName, Callable[[Command], str | None]] = {}

    def register(self, name: CommandName, handler: Callable[[Command], str | None]) -> None:
        """Register the handler of a command, which is called in the processing thread.

        It returns the outcome, if it does not report that itself, and raises `ProbeDesignError` to refuse the command.
        """
        self._handlers[name] = handler

    def put(
        self, name: CommandName, text: str = "", reply: Callable[[CommandResult], None] = lambda result: None
    ) -> None:
        """Queue a command; the result is reported to every sink as an event, and to `reply`."""
        self._queue.put(Command(name, one_line(text, MAX_NOTE), reply))

    def execute(self, log: Log) -> bool:
        """Execute all commands since the last call in order and report their results; return whether to stop."""
        while True:
            try:
                command = self._queue.get_nowait()
            except Empty:
                return False
            handler = self._handlers.get(command.name)
            if command.name == "stop":
                result = CommandResult(True, "the run is ended by a command")
            elif handler is None:
                result = CommandResult(False, f"{command.name} is not available here")
            else:
                try:
                    result = CommandResult(True, handler(command) or "")
                except ProbeDesignError as error:
                    result = CommandResult(False, f"{command.name} refused: {error}")
            if result.text:
                log(result.text)
            command.reply(result)
            if command.name == "stop":
                return True


class SharedCommands(CommandQueue):
    """Passes each command to every probe of a run, and those that concern recordings to the first."""

    def __init__(self, queues: Sequence[CommandQueue]) -> None:
        self._queues = queues

    def register(self, name: CommandName, handler: Callable[[Command], str | None]) -> None:
        """Register the handler of a command of the whole run; see `CommandQueue`."""
        self._queues[0].register(name, handler)

    def put(
        self, name: CommandName, text: str = "", reply: Callable[[CommandResult], None] = lambda result: None
    ) -> None:
        """Queue a command; `reply` receives one result when every probe has executed it."""
        chosen = self._queues[:1] if "recording" in name else self._queues
        results: list[CommandResult] = []

        def collect(result: CommandResult) -> None:
            results.append(result)
            if len(results) == len(chosen):
                texts = dict.fromkeys(each.text for each in results if each.text)
                reply(CommandResult(all(each.accepted for each in results), "; ".join(texts)))

        for queue in chosen:
            queue.put(name, text, collect)


SCHEMA = 1
KEY_PERIOD = 0.1  #: Longest wait for a key before the end is noticed [s].
MAX_ID = 64  #: Maximum length of the identifier of a datagram, which the reply repeats.


class KeyInput:
    """Reads keys of the terminal in a thread, without Enter; the terminal is restored at the end.

    It reads nothing where standard input is no terminal, belongs to another foreground process, or cannot be switched.
    """

    def __init__(self, commands: CommandQueue, log: Log, fd: int | None = None) -> None:
        """Switch the terminal of a file descriptor, that of standard input by default, and start to read."""
        self._commands, self._ended = commands, threading.Event()
        self._fd, self._saved = -1, None
        with suppress(Exception):  # no terminal, no descriptor, or no termios on this system
            import termios
            import tty

            fd = sys.stdin.fileno() if fd is None else fd
            if os.tcgetpgrp(fd) == os.getpgrp():  # a background job that switches the terminal would be stopped
                saved: Any = termios.tcgetattr(fd)
                tty.setcbreak(fd)
                self._fd, self._saved = fd, saved
        if self._saved is None:
            return
        self._thread = threading.Thread(target=self._read, name="keys", daemon=True)
        self._thread.start()
        log("keys: " + ", ".join(f"{key} {name}" for name, key in COMMANDS.items()))

    def close(self) -> None:
        """Restore the terminal."""
        self._ended.set()
        if self._saved is not None:
            import termios

            self._thread.join()
            with suppress(termios.error):  # the terminal has been closed
                termios.tcsetattr(self._fd, termios.TCSADRAIN, self._saved)

    def _read(self) -> None:
        names = {key: name for name, key in COMMANDS.items()}
        while not self._ended.is_set():
            if not select.select([self._fd], [], [], KEY_PERIOD)[0]:
                continue
            try:
                keys = os.read(self._fd, 64)
            except OSError:
                return
            if not keys:
                return
            for key in keys.decode("ascii", errors="replace"):
                if key in names:
                    self._commands.put(names[key], "force")  # a person looks at the probe


class DatagramInput(Listener[None]):
    """Receives commands by UDP: `{"command": "tare"}`, with an optional `text` and `id`, in JSON or MessagePack.

    Each is answered to its sender with a JSON object: `schema`, `kind` "reply", `command`, `id` as given, `accepted`,
    and `text`, the outcome or the reason of the refusal.
    """

    def __init__(self, address: str, commands: CommandQueue, log: Log) -> None:
        """Listen on `udp://[HOST]:PORT`; without a host only this machine can send.

        Raises:
            InputError: the address is invalid, or the port is in use.
        """
        option = f"--control {address}"
        super().__init__(option, "commands", parse_listen_address(option), lambda values: Parsed(None))
        self._commands, self._log = commands, log
        log(*self.notes)
        self.start()

    def receive(self, datagram: bytes, sender: tuple[str, int], now: float) -> None:
        """Queue a command, of any sender; see `Listener`."""
        values = decode_object(datagram)
        name, text, identifier = values.get("command"), values.get("text", ""), values.get("id")
        if not isinstance(text, str):
            raise InputError("has a text that is not a string")
        if type(identifier) not in (int, str, type(None)) or len(str(identifier)) > MAX_ID:
            raise InputError(f"has an id that is not a number or a string of up to {MAX_ID} characters")

        def reply(result: CommandResult) -> None:
            content = {"schema": SCHEMA, "kind": "reply", "command": str(name)[:MAX_ID], "id": identifier}
            answer = json.dumps(content | result._asdict())
            with suppress(OSError):  # the sender has gone, or the run has ended
                self._socket.sendto(answer.encode(), sender)

        known: dict[Any, CommandName] = {each: each for each in get_args(CommandName)}
        if not isinstance(name, str) or name not in known:
            self.counts["unknown"] += 1
            return reply(CommandResult(False, f"unknown command; known: {', '.join(known)}"))
        self.counts["taken"] += 1
        self._commands.put(known[name], text, reply)

    def reject(self, kind: str, line: str) -> None:
        """Count a rejected datagram, and report the first of its kind at once."""
        super().reject(kind, line)
        for message in self.pop_messages():
            self._log(message)
