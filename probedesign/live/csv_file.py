"""Recording raw readings as CSV while they come."""

from pathlib import Path

from probedesign.live.answer import Answer
from probedesign.live.block import Block
from probedesign.live.pieces import Pieces
from probedesign.live.pose.timed import TimedPose
from probedesign.live.recording_columns import GRAVITY_HEADER, HEADER


class CsvFile:
    """A recording that grows by whole lines. A `File`: called from one thread.

    It holds raw readings and nothing else; those with a fault are left out and make a gap.
    """

    def __init__(self, path: Path, force: bool = False) -> None:
        """Make the file and write its header.

        Args:
            path: where; its folder is made if missing.
            force: replace a file that stands there.

        Raises:
            InputError: the file exists and `force` is not said, or it cannot be written.
        """
        self._pieces = Pieces(path, force)
        self._pieces.write(f"# frame: sensor\n{HEADER},{GRAVITY_HEADER}\n".encode())
        try:
            self._pieces.flush()
        except OSError:
            self._pieces.abandon()
            raise

    def read(self, block: Block) -> None:
        """A line a reading."""
        if block.fault:
            return
        gravity = "".join(f",{value!r}" for value in block.gravity_base.tolist())
        rows = zip(block.time.tolist(), block.wrench_sensor.tolist(), strict=True)
        lines = [",".join(map(repr, (time, *wrench))) + gravity for time, wrench in rows]
        self._pieces.write("".join(f"{line}\n" for line in lines).encode())
        self._pieces.flush()  # so little that it need not wait for more

    def answered(self, answer: Answer) -> None:
        """Only what is raw stands in CSV."""

    def posed(self, pose: TimedPose) -> None:
        """Only what is raw stands in CSV."""

    def told(self, time: float, line: str) -> None:
        """Only what is raw stands in CSV."""

    def left_out(self, readings: int, others: int) -> None:
        """A comment."""
        self._pieces.write(f"# the disk was too slow: {readings} readings left out here\n".encode())

    def flush(self) -> None:
        """Hand what waits to the operating system."""
        self._pieces.flush()

    def close(self) -> None:
        """Write what waits, and close."""
        try:
            self._pieces.flush()
        finally:
            self._pieces.close()
