from enum import Enum


class DurabilityPolicy(Enum):
    TRANSIENT_LOCAL = 1


class ReliabilityPolicy(Enum):
    BEST_EFFORT = 2


class QoSProfile:
    def __init__(self, depth, durability=None, reliability=None):
        self.depth, self.durability, self.reliability = depth, durability, reliability
