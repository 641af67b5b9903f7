"""What the page needs to know before anything is read."""

from dataclasses import dataclass

from probedesign.frames import Array
from probedesign.live.view.moment import Shape
from probedesign.live.view.parts import Part
from probedesign.live.view.tube import Tube


@dataclass(frozen=True)
class Setup:
    """Everything that does not change.

    Attributes:
        title: of the page.
        host, port: where it listens; the next free port is taken.
        tube: the probe's skin.
        free: the untouched probe.
        parts: what it hangs on.
        gravity_base: [m/s²], (3,).
        note: on what is drawn, if there is something to say.
    """

    title: str
    host: str
    port: int
    tube: Tube
    free: Shape
    parts: tuple[Part, ...]
    gravity_base: Array
    note: str = ""
