from enum import Enum

qos_profile_sensor_data = "sensor data"


class DurabilityPolicy(Enum):
    TRANSIENT_LOCAL = 1


class QoSProfile:
    def __init__(self, depth, durability):
        self.depth, self.durability = depth, durability
