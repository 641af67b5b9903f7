from launch.actions import _Action


class Node(_Action):
    pass
