"""`probedesign simulate`: a Net F/T box that is not there."""

import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from probedesign.estimation.model import ProbeModel
    from probedesign.live.netft_box.scene import PressedObject
    from probedesign.live.sources.netft.configuration import NetFTConfiguration

FOREVER = 1e8
"""Three years [s]."""


def simulate(
    bundle: Path,
    /,
    *,
    host: str = "127.0.0.1",
    port: int = 49152,
    http_port: int = 8080,
    scene: str = "edges",
    fault: list[str] | None = None,
    torque_unit: str = "N-mm",
    rate_hz: float = 7000.0,
    records: int = 1,
    seed: int = 1,
    seconds: float | None = None,
    pose_to: str | None = None,
    friction: float = 0.5,
    friction_spread: float = 0.2,
) -> None:
    """Play a Net F/T box with the probe on it, for `live` and any other client.

    The base rests until a client asks for the stream, then presses the objects of the scene one after the
    other, round after round. It listens on this machine alone unless --host says otherwise, and ends with
    --seconds or Ctrl-C. Faults and scenes: docs/live.md.

    Args:
        bundle: the frozen probe, NAME.probe.json.
        host: address to listen on; 0.0.0.0 is every network of this machine.
        port: of RDT, UDP; 0 lets the system choose.
        http_port: of netftapi2.xml, TCP; 0 lets the system choose.
        scene: edges, points, card-house or free.
        fault: loss=0.01, reorder=, duplicate=, garbage=, short= of all packets; stall@10, restart@10,
            stolen@10, units@10, saturate@10 seconds after the stream began; repeat it for several.
        torque_unit: that the box counts in; the Nano17's own is N-mm.
        rate_hz: records a second: 7000 over a whole number.
        records: in a packet of buffered streaming, at most 40.
        seed: of noise, drift and faults.
        seconds: end so long after the start.
        pose_to: HOST:PORT to send the base's poses to, as live --pose udp:// hears them.
        friction: median friction coefficient of the objects; contacts stick and slip. 0 is without friction.
        friction_spread: standard deviation of its logarithm from object to object.
    """
    from contextlib import ExitStack

    from probedesign.deployment import load_estimator
    from probedesign.live.netft_box.box import SimulatedNetFT, parse_faults
    from probedesign.live.netft_box.robot import SimulatedRobot
    from probedesign.live.netft_box.scene import BaseMotion
    from probedesign.live.netft_box.transducer import SimulatedTransducer

    faults, model = parse_faults(fault or [], seed), load_estimator(bundle).model
    configuration = _configuration(model, torque_unit, rate_hz, records, seconds)
    things = _pressed(model, scene, friction, friction_spread, seed)
    motion = BaseMotion(model, things)
    transducer = SimulatedTransducer(model, motion.wrench_sensor, seed)
    with ExitStack() as on:
        box = on.enter_context(
            SimulatedNetFT(
                transducer, configuration, host=host, port=port, http_port=http_port, faults=faults
            )
        )
        if pose_to is not None:
            on.enter_context(SimulatedRobot(motion, lambda: box.motion_time, pose_to))
        for line in (*(thing.summary for thing in things), *_listening(host, box.source, bundle)):
            print(line, flush=True)
        with suppress(KeyboardInterrupt):
            time.sleep(seconds if seconds is not None else FOREVER)


def _configuration(
    model: "ProbeModel", torque_unit: str, rate_hz: float, records: int, seconds: float | None
) -> "NetFTConfiguration":
    """Of the box, as the options say.

    Raises:
        InputError: one makes no sense.
    """
    from probedesign.errors import InputError
    from probedesign.live.netft_box.box import NATIVE
    from probedesign.live.sources.netft.wire import MAX_RECORDS, SAMPLES_PER_SECOND

    parts = SAMPLES_PER_SECOND / rate_hz if rate_hz > 0.0 else 0.0
    if not parts >= 1.0 or abs(parts - round(parts)) > 1e-3 * parts:
        raise InputError(f"--rate-hz {rate_hz:g} must be {SAMPLES_PER_SECOND} over a whole number")
    if not 1 <= records <= MAX_RECORDS:
        raise InputError(f"--records {records} must be 1 ... {MAX_RECORDS}")
    if seconds is not None and not seconds > 0.0:
        raise InputError(f"--seconds {seconds} must be positive")
    force, moment = model.wrench_range[0], model.wrench_range[3]
    ranges = (force, force, model.wrench_range[2], *[moment * (1.0 if torque_unit == "N-m" else 1e3)] * 3)
    rate = SAMPLES_PER_SECOND / round(parts)
    return replace(NATIVE, torque_unit=torque_unit, rate=rate, records=float(records), ranges=ranges)


def _pressed(
    model: "ProbeModel", scene: str, friction: float, spread: float, seed: int
) -> "tuple[PressedObject, ...]":
    """The scene's objects, with what the probe reads of each; on a terminal whoever waits is told for what."""
    from probedesign.cli.console import working
    from probedesign.live.netft_box.scene import press_scene

    with working(f"solving the presses of --scene {scene}"):
        return press_scene(model, scene, friction, spread, seed)


def _listening(host: str, source: str, bundle: Path) -> list[str]:
    lines = [f"listening on {source.removeprefix('netft://')}; read it with",
             f'  probedesign live {bundle} --source "{source}" --tare-s 0:3 --average 36']  # fmt: skip
    if not host.startswith("127."):
        lines.insert(0, f"--host {host}: anyone on that network can read and disturb this box")
    return lines
