"""CDR of the types in use, by the rosbags package, which knows their definitions."""

from importlib import import_module
from pathlib import Path

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
CONTACT = Path(__file__).parents[3] / "ros" / "probedesign_msgs" / "msg" / "Contact.msg"
STORE.register(get_types_from_msg(CONTACT.read_text(encoding="utf-8"), "probedesign_msgs/msg/Contact"))
PACKAGES = {"String": "std_msgs", "TFMessage": "tf2_msgs", "Contact": "probedesign_msgs"}


def deserialize_message(data, kind):
    package = PACKAGES.get(kind.__name__, "geometry_msgs")
    return _converted(STORE.deserialize_cdr(data, f"{package}/msg/{kind.__name__}"))


def _converted(value):
    """Return a message of rosbags as one of this stand-in, its arrays as lists."""
    if isinstance(value, list):
        return [_converted(each) for each in value]
    if not hasattr(value, "__msgtype__"):
        return value.tolist() if hasattr(value, "tolist") else value
    package, _, name = value.__msgtype__.split("/")
    kind = getattr(import_module(f"{package}.msg"), name)
    names = [each for each in value.__dataclass_fields__ if each.islower() and each != "__msgtype__"]  # no constants
    return kind(**{each: _converted(getattr(value, each)) for each in names})
