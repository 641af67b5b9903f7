from stub_messages import message


class Trigger:
    Request = message("Trigger.Request")
    Response = message("Trigger.Response", success=False, message="")
