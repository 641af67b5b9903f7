from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Pose, Vector3
from std_msgs.msg import ColorRGBA, Header
from stub_messages import message

Marker = message("Marker", header=Header, ns="", id=0, type=0, action=0, pose=Pose, scale=Vector3, color=ColorRGBA,
                 lifetime=Duration, points=[], text="")  # fmt: skip
Marker.ARROW, Marker.CUBE, Marker.SPHERE, Marker.CYLINDER = 0, 1, 2, 3
Marker.ADD, Marker.DELETE, Marker.DELETEALL = 0, 2, 3
MarkerArray = message("MarkerArray", markers=[])
