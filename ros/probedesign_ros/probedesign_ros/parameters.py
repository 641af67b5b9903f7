"""Parameters of the node, which the launch file offers as arguments too; needs neither ROS 2 nor probedesign."""

from typing import NamedTuple


class Parameter(NamedTuple):
    """A parameter: its default value, which has its type, its meaning, and its range if it is a number."""

    default: object
    text: str
    low: float = 0.0
    high: float = 0.0


PARAMETERS = {
    "host": Parameter("127.0.0.1", "address on which the messages of the run arrive"),
    "port": Parameter(9001, "UDP port of the messages of the run; 0 is any free one", 0, 65535),
    "control_host": Parameter("127.0.0.1", "address of the run's --control"),
    "control_port": Parameter(9002, "UDP port of the run's --control", 1, 65535),
    "control_timeout_s": Parameter(1.0, "wait for the reply to a command [s]", 0.01, 60.0),
    "frame_prefix": Parameter("", "prefix before the frames of the probes, NAME/base, NAME/sensor and NAME/contact"),
    "world_frame": Parameter("world", "name of the frame in which the poses of the base are"),
    "publish_tf": Parameter(True, "publish world to base; false if the robot publishes this pose"),
    "publish_sensor_tf": Parameter(True, "publish base to sensor"),
    "publish_contact_tf": Parameter(True, "publish base to contact while a contact is located"),
    "poll_period_s": Parameter(0.005, "interval at which datagrams are read [s]", 0.0005, 1.0),
}


def checked(name: str, value: object) -> object:
    """Return the value of a parameter with the type of its default; an integer is a float, too.

    Raises:
        ValueError: it has another type, or is out of range.
    """
    parameter = PARAMETERS[name]
    kind = type(parameter.default)
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        raise ValueError(f"parameter {name}: {value!r} is not a {kind.__name__}")
    if kind in (int, float) and not parameter.low <= value <= parameter.high:
        raise ValueError(f"parameter {name}: {value!r} is not in {parameter.low:g} ... {parameter.high:g}")
    return value
