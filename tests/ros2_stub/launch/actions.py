class _Action:
    def __init__(self, *arguments, **options):
        self.arguments, self.options = arguments, options


class DeclareLaunchArgument(_Action):
    pass


class ExecuteProcess(_Action):
    pass


class OpaqueFunction(_Action):
    pass


class Shutdown(_Action):
    pass
