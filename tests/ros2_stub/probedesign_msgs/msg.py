"""`Contact` with the fields and constants of its file, as rosidl generates them."""

from pathlib import Path

from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import Header
from stub_messages import message

FILE = Path(__file__).parents[3] / "ros" / "probedesign_msgs" / "msg" / "Contact.msg"
LINES = [line.split("#")[0].split() for line in FILE.read_text(encoding="utf-8").splitlines()]
TYPES = {
    "std_msgs/Header": Header,
    "geometry_msgs/Point": Point,
    "geometry_msgs/Vector3": Vector3,
    "float64": 0.0,
    "uint8": 0,
}
FIELDS = {line[1]: TYPES[line[0]] for line in LINES if len(line) == 2 and "=" not in line[1]}
Contact = message("Contact", **FIELDS)
for line in LINES:
    text = "".join(line[1:])
    if "=" in text:
        name, value = text.split("=")
        setattr(Contact, name, int(value))
