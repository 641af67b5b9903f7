from builtin_interfaces.msg import Time
from stub_messages import message

Header = message("Header", stamp=Time, frame_id="")
String = message("String", data="")
ColorRGBA = message("ColorRGBA", r=0.0, g=0.0, b=0.0, a=0.0)
