from std_msgs.msg import Header
from stub_messages import message

Vector3 = message("Vector3", x=0.0, y=0.0, z=0.0)
Point = message("Point", x=0.0, y=0.0, z=0.0)
Quaternion = message("Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
Pose = message("Pose", position=Point, orientation=Quaternion)
PoseStamped = message("PoseStamped", header=Header, pose=Pose)
PoseWithCovariance = message("PoseWithCovariance", pose=Pose, covariance=[0.0] * 36)
PoseWithCovarianceStamped = message("PoseWithCovarianceStamped", header=Header, pose=PoseWithCovariance)
Wrench = message("Wrench", force=Vector3, torque=Vector3)
WrenchStamped = message("WrenchStamped", header=Header, wrench=Wrench)
Transform = message("Transform", translation=Vector3, rotation=Quaternion)
TransformStamped = message("TransformStamped", header=Header, child_frame_id="", transform=Transform)
