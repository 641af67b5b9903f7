from builtin_interfaces.msg import Time as Stamp


class Time:
    def __init__(self, seconds=0, nanoseconds=0):
        self.nanoseconds = int(1e9 * seconds) + nanoseconds

    def to_msg(self):
        return Stamp(sec=self.nanoseconds // 10**9, nanosec=self.nanoseconds % 10**9)
