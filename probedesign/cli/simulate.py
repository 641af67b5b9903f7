"""`probedesign simulate`: simulate a Net F/T box with a probe."""

import time
from contextlib import ExitStack, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from probedesign.cli.console import show_progress
from probedesign.cli.options import FrozenProbe
from probedesign.core.errors import InputError

if TYPE_CHECKING:
    from probedesign.estimation.model import ProbeModel
    from probedesign.live.sources.netft_configuration import NetFTConfiguration

MAX_SECONDS = 1e8  #: Duration without --seconds: three years [s].


def simulate(
    bundle: FrozenProbe,
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
    object_compliance: Annotated[float, Parameter(name="--object-compliance-m-N")] = 0.0,
) -> None:
    """Simulate a Net F/T box with a probe, for `live` and other clients.

    The base is at rest until a client starts the stream. It then presses the objects of the scene in turn, round after
    round. The box is served on this machine only unless --host is given, and ends with --seconds or Ctrl-C. Faults and
    scenes: docs/live.md.

    Args:
        host: address on which the box is served. 0.0.0.0 is every network of this machine.
        port: UDP port of RDT; 0 lets the system choose.
        http_port: TCP port of netftapi2.xml; 0 lets the system choose.
        scene: edges, points, card-house or free.
        fault: fraction of all packets with loss=0.01, reorder=, duplicate=, garbage= or short=; or an event stall@10,
            restart@10, stolen@10, units@10 or saturate@10, seconds after the start of the stream. Repeat the option
            for several.
        torque_unit: unit of the box's torque counts; the Nano17's is N-mm.
        rate_hz: records per second: 7000 divided by a whole number.
        records: records per packet of buffered streaming, at most 40.
        seed: seed of noise, drift and faults.
        seconds: end this many seconds after the start.
        pose_to: HOST:PORT to which the base's poses are sent, for live --pose udp://.
        friction: median friction coefficient of the objects; contacts stick and slip. 0 is without friction.
        friction_spread: standard deviation of the friction coefficient's logarithm from object to object.
        object_compliance: how far every object yields by the force on it [m/N]. 0 is rigid; a card house yields by 0.02
            to 0.2 m/N.
    """
    from probedesign.frozen_probe import load_estimator
    from probedesign.simulation.netft_box import (
        BaseMotion,
        SimulatedNetFT,
        SimulatedRobot,
        SimulatedTransducer,
        parse_faults,
    )
    from probedesign.simulation.scenes import press_scene

    faults, model = parse_faults(fault or [], seed), load_estimator(bundle).model
    configuration = _configuration(model, torque_unit, rate_hz, records, seconds)
    with show_progress(f"solving the contacts of --scene {scene}"):
        objects = press_scene(model, scene, friction, friction_spread, seed, object_compliance)
    motion = BaseMotion(model, objects)
    transducer = SimulatedTransducer(model, motion.wrench_sensor, seed)
    with ExitStack() as stack:
        box = stack.enter_context(
            SimulatedNetFT(transducer, configuration, host=host, port=port, http_port=http_port, faults=faults)
        )
        if pose_to is not None:
            stack.enter_context(SimulatedRobot(motion, lambda: box.motion_time, pose_to))
        for pressed in objects:
            print(pressed.summary)
        if not host.startswith("127."):
            print(f"warning: with --host {host}, anyone on that network can read and disturb this box")
        print(f"listening on {box.source.removeprefix('netft://')}; read it with")
        print(f'  probedesign live {bundle} --source "{box.source}" --tare-s 0:3 --average 36', flush=True)
        with suppress(KeyboardInterrupt):
            time.sleep(seconds if seconds is not None else MAX_SECONDS)


def _configuration(
    model: "ProbeModel", torque_unit: str, rate_hz: float, records: int, seconds: float | None
) -> "NetFTConfiguration":
    from probedesign.live.sources.netft_rdt import MAX_RECORDS, SAMPLES_PER_SECOND
    from probedesign.simulation.netft_box import NATIVE

    divisor = SAMPLES_PER_SECOND / rate_hz if rate_hz > 0.0 else 0.0
    if not divisor >= 1.0 or abs(divisor - round(divisor)) > 1e-3 * divisor:
        raise InputError(f"--rate-hz {rate_hz:g} must be {SAMPLES_PER_SECOND} divided by a whole number")
    if not 1 <= records <= MAX_RECORDS:
        raise InputError(f"--records {records} must lie in 1 ... {MAX_RECORDS}")
    if seconds is not None and not seconds > 0.0:
        raise InputError(f"--seconds {seconds} must be positive")
    force, moment = model.wrench_range[0], model.wrench_range[3]
    ranges = (force, force, model.wrench_range[2], *[moment * (1.0 if torque_unit == "N-m" else 1e3)] * 3)
    rate = SAMPLES_PER_SECOND / round(divisor)
    return replace(NATIVE, torque_unit=torque_unit, rate=rate, records=float(records), ranges=ranges)
