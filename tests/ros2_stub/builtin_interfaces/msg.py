from stub_messages import message

Time = message("Time", sec=0, nanosec=0)
Duration = message("Duration", sec=0, nanosec=0)
