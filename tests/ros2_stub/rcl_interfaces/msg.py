from stub_messages import message

FloatingPointRange = message("FloatingPointRange", from_value=0.0, to_value=0.0, step=0.0)
IntegerRange = message("IntegerRange", from_value=0, to_value=0, step=0)
ParameterDescriptor = message(
    "ParameterDescriptor", description="", read_only=False, dynamic_typing=False, floating_point_range=[],
    integer_range=[],
)  # fmt: skip
