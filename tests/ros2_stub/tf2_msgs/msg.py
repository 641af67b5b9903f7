from stub_messages import message

TFMessage = message("TFMessage", transforms=[])
