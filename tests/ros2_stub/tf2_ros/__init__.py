"""A buffer with one transform that moves along x, and broadcasters that keep what they send."""

import time

from geometry_msgs.msg import TransformStamped

START = time.monotonic()


class TransformException(Exception):
    pass


class Buffer:
    def lookup_transform(self, world, base, at):
        if (world, base) != ("world", "robot/base"):
            raise TransformException(base)
        elapsed = time.monotonic() - START
        found = TransformStamped()
        found.header.stamp.sec, found.header.stamp.nanosec = 200 + int(elapsed), int(1e9 * (elapsed % 1.0))
        found.transform.translation.x = 0.1 * elapsed
        found.transform.rotation.z, found.transform.rotation.w = 0.6, 0.8
        return found


class TransformListener:
    def __init__(self, buffer, node):
        self.buffer = buffer


class TransformBroadcaster:
    def __init__(self, node):
        self.sent = []

    def sendTransform(self, transform):
        self.sent.append(transform)


class StaticTransformBroadcaster(TransformBroadcaster):
    pass
