"""A node whose topics, services and timers are lists; `spin` plays a scene until the process ends."""

from time import monotonic, sleep

from rclpy.node import Node

started, nodes = [], []


def init(args=None):
    started.append(args)


def create_node(name):
    return Node(name)


def ok():
    return True


def try_shutdown():
    started.clear()


def spin(node, seconds=60.0):
    """Publish a wrench and a transform that advance with time, and call the timers, a hundred times a second."""
    from geometry_msgs.msg import WrenchStamped

    start = monotonic()
    while (now := monotonic()) - start < seconds:
        for kind, _, callback in node.subscriptions_made:
            message = kind()
            if isinstance(message, WrenchStamped):
                stamp = 100.0 + now - start
                message.header.stamp.sec = int(stamp)
                message.header.stamp.nanosec = int(1e9 * (stamp - int(stamp)))
                message.header.frame_id = "tool0"
                message.wrench.force.x, message.wrench.torque.z = 0.25, 0.004
            callback(message)
        for _, callback in node.timers_made:
            callback()
        sleep(0.01)
