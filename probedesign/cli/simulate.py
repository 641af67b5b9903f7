"""`probedesign simulate`: simulate a Net F/T box with a probe."""

import time
from contextlib import ExitStack, suppress
from dataclasses import replace
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.console import show_progress
from probedesign.cli.options import FrozenProbe
from probedesign.core.errors import InputError

MAX_SECONDS = 1e8  #: Duration without --seconds: three years [s].


def simulate(
    bundle: FrozenProbe,
    /,
    *,
    host: str = "127.0.0.1",
    port: int = 49152,
    http_port: int = 8080,
    scene: str = "edges",
    seed: int = 1,
    seconds: float | None = None,
    pose_to: str | None = None,
    friction: float = 0.5,
    object_compliance: Annotated[float, Parameter(name="--object-compliance-m-N")] = 0.0,
) -> None:
    """Simulate a Net F/T box with a probe, for `live` and other clients.

    The base is at rest until a client starts the stream. It then presses the objects of the scene in turn, round after
    round. The box is served on this machine only unless --host is given, and ends with --seconds or Ctrl-C. Scenes:
    docs/live.md.

    Args:
        host: address on which the box is served. 0.0.0.0 is every network of this machine.
        port: UDP port of RDT; 0 lets the system choose.
        http_port: TCP port of netftapi2.xml; 0 lets the system choose.
        scene: edges, points, card-house or free.
        seed: seed of noise, drift and friction.
        seconds: end this many seconds after the start.
        pose_to: HOST:PORT to which the base's poses are sent, for live --pose udp://.
        friction: median friction coefficient of the objects; contacts stick and slip. 0 is without friction.
        object_compliance: how far every object yields by the force on it [m/N]. 0 is rigid; a card house yields by 0.02
            to 0.2 m/N.
    """
    from probedesign.core.units import MM
    from probedesign.frozen_probe import load_estimator
    from probedesign.simulation.netft_box import NATIVE, BaseMotion, SimulatedNetFT, SimulatedRobot, SimulatedTransducer
    from probedesign.simulation.scenes import press_scene

    if seconds is not None and not seconds > 0.0:
        raise InputError(f"--seconds {seconds} must be positive")
    model = load_estimator(bundle).model
    with show_progress(f"solving the contacts of --scene {scene}"):
        objects = press_scene(model, scene, friction, seed=seed, compliance=object_compliance)
    motion = BaseMotion(model, objects)
    transducer = SimulatedTransducer(model, motion.wrench_sensor, seed)
    ranges = model.wrench_range / ([1.0] * 3 + [MM] * 3)
    configuration = replace(NATIVE, ranges=tuple(ranges.tolist()))
    with ExitStack() as stack:
        box = stack.enter_context(SimulatedNetFT(transducer, configuration, host=host, port=port, http_port=http_port))
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
