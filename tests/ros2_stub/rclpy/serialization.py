"""CDR of the few types in use, by the rosbags package, which knows their definitions."""

from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)


def deserialize_message(data, kind):
    package = (
        kind.package
        if hasattr(kind, "package")
        else {"String": "std_msgs"}.get(kind.__name__, "geometry_msgs")
    )
    return _copied(STORE.deserialize_cdr(data, f"{package}/msg/{kind.__name__}"), kind())


def _copied(source, target):
    for name in source.__dataclass_fields__:
        value = getattr(source, name)
        if hasattr(value, "__dataclass_fields__"):
            _copied(value, getattr(target, name))
        else:
            setattr(target, name, value.tolist() if hasattr(value, "tolist") else value)
    return target
