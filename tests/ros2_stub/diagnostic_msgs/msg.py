from std_msgs.msg import Header
from stub_messages import message

KeyValue = message("KeyValue", key="", value="")
DiagnosticStatus = message("DiagnosticStatus", level=b"\x00", name="", message="", hardware_id="", values=[])
DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.STALE = b"\x00", b"\x01", b"\x03"
DiagnosticArray = message("DiagnosticArray", header=Header, status=[])
