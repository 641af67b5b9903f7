"""Message classes with fixed fields, which refuse unknown names and wrong types as those of rosidl do."""


def message(name, /, **fields):
    """Return a class with these fields; a field is a class whose call gives the default, or a default value."""

    def make(default):
        return default() if isinstance(default, type) else type(default)(default)

    def __init__(self, **given):
        unknown = set(given) - set(fields)
        assert not unknown, f"{name} has no {unknown}"
        for key, default in fields.items():
            object.__setattr__(self, key, make(default))
        for key, value in given.items():
            setattr(self, key, value)

    def __setattr__(self, key, value):
        if key not in fields:
            raise AttributeError(f"{name} has no field {key}")
        wanted = fields[key] if isinstance(fields[key], type) else type(fields[key])
        assert isinstance(value, wanted), f"{name}.{key} must be {wanted.__name__}, not {type(value).__name__}"
        if isinstance(fields[key], list) and fields[key]:
            assert len(value) == len(fields[key]), f"{name}.{key} has {len(value)} values"
        object.__setattr__(self, key, value)

    def __repr__(self):
        return f"{name}({', '.join(f'{key}={getattr(self, key)!r}' for key in fields)})"

    return type(name, (), {"__init__": __init__, "__setattr__": __setattr__, "__repr__": __repr__})
