"""Options of `explore` that say what is read, and how."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cyclopts import Parameter

from probedesign.errors import InputError

if TYPE_CHECKING:
    from probedesign.estimation.model import ProbeModel
    from probedesign.live.poses.base_poses import BasePoses
    from probedesign.live.processing.scheduler import ProcessingOptions
    from probedesign.live.sources.source import Source


@Parameter(name="*")
@dataclass
class ReadingOptions:
    """What is read, and how."""

    tare_s: str | None = None
    """START:END in seconds from the first reading: the probe is free then, take the bias there."""
    average: int = 1
    """Take means of so many readings."""
    seconds: float | None = None
    """End so many seconds after the first reading."""
    source: str | None = None
    """Instead of a recording, as for `live`; ends with the source, at --seconds or with Ctrl-C."""
    mend: bool = False
    """Go on with a recording that lacks something: lines, or its end."""
    topic: str = ""
    """Of a bag's wrenches, if there are several."""
    moment_unit: Literal["Nm", "Nmm"] = "Nm"
    """Of a bag whose publisher does not keep to N·m."""
    other_probe: bool = False
    """Read a recording that was made with another probe."""

    def plan(self, recording: Path | None) -> "ProcessingOptions":
        """What to do with the readings.

        Raises:
            InputError: it is not said what is read, or no tare; or a value makes no sense.
        """
        from probedesign.live.processing.scheduler import ProcessingOptions
        from probedesign.live.processing.tare import parse_window

        if (recording is None) == (self.source is None):
            raise InputError("explore takes a recording, or --source for a run that is live: one of them")
        if self.tare_s is None:
            raise InputError(
                "a touch is told from the sensor's bias by a tare: say --tare-s START:END, when the probe is free"
            )
        return ProcessingOptions(
            parse_window(self.tare_s), self.average, seconds=self.seconds, estimates=False
        )

    def opened(
        self, recording: Path | None, model: "ProbeModel", poses: "BasePoses", say: Callable[[str], None]
    ) -> "Source":
        """The recording or the source, and that its time is that of the poses.

        Raises:
            InputError: it is not.
        """
        from probedesign.exploring.explore import check_poses, play
        from probedesign.live.sources.replay import RecordingOptions
        from probedesign.live.sources.source import open_source

        if recording is None:
            return open_source(str(self.source), model, say)
        choice = RecordingOptions(self.topic, moment_unit=self.moment_unit, other_probe=self.other_probe)
        played = play(recording, model, self.mend, choice)
        check_poses(poses, played.span)
        return played
