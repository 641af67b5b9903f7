from stub_messages import message


class Command:
    Request = message("Command.Request", command="", text="")
    Response = message("Command.Response", accepted=False, text="")
