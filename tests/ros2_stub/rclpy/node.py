from typing import ClassVar


class Publisher:
    def __init__(self, kind, topic):
        self.kind, self.topic, self.sent = kind, topic, []

    def publish(self, message):
        if isinstance(message, bytes):
            from rclpy.serialization import deserialize_message

            message = deserialize_message(message, self.kind)
        assert isinstance(message, self.kind), (self.topic, type(message))
        self.sent.append(message)


class Logger:
    def __init__(self):
        self.lines = []

    def _log(self, line, **options):
        self.lines.append(line)

    info = warning = error = _log


class Clock:
    def now(self):
        from rclpy.time import Time

        return Time(seconds=1.0)


class Parameter:
    def __init__(self, value):
        self.value = value


class Node:
    overrides: ClassVar[dict] = {}

    def __init__(self, name):
        self.name, self.publishers_made, self.services_made = name, {}, {}
        self.subscriptions_made, self.timers_made, self._logger = [], [], Logger()
        self.parameters, self.descriptors, self.groups, self.subscription_profiles = {}, {}, {}, {}

    def create_publisher(self, kind, topic, qos):
        return self.publishers_made.setdefault(topic, Publisher(kind, topic))

    def create_subscription(self, kind, topic, callback, qos):
        self.subscriptions_made.append((kind, topic, callback))
        self.subscription_profiles[topic] = qos

    def create_service(self, kind, name, callback, callback_group=None):
        self.services_made[name] = (kind, callback)
        self.groups[name] = callback_group

    def create_timer(self, period, callback):
        self.timers_made.append((period, callback))

    def declare_parameter(self, name, default, descriptor=None):
        value = self.overrides.get(name, default)
        if descriptor is None or not descriptor.dynamic_typing:  # as rclpy does, whose type is that of the default
            assert type(value) is type(default), name
        self.parameters[name], self.descriptors[name] = value, descriptor
        return Parameter(value)

    def get_parameter(self, name):
        return Parameter(self.overrides.get(name, False) if name == "use_sim_time" else self.parameters[name])

    def get_logger(self):
        return self._logger

    def get_clock(self):
        return Clock()

    def destroy_node(self):
        pass
