"""SVG by elements."""

from xml.etree import ElementTree as ET

from probedesign.core.svg import Canvas, element, number


def test_hostile_words_stay_words_and_numbers_are_short():
    canvas = Canvas(100.0, 50.0, "mm", title='<b> & "quoted"')
    canvas.text((1.0 / 3.0, -0.0), "a < b & c", 3.0, data_note='"><script>')
    canvas.polylines([[(0.0, 0.0), (12345.678, 1e-9)]], 0.25, dashes="2 1")
    root = ET.fromstring(bytes(canvas))
    words = root.find("{*}text")
    assert words is not None and words.text == "a < b & c" and words.get("data-note") == '"><script>'
    assert (words.get("x"), words.get("y")) == ("0.33", "0")
    assert root.findtext("{*}title") == '<b> & "quoted"' and root.get("width") == "100mm"
    assert root.find("{*}path").get("d") == "M0 0L12345.68 0"
    assert number(-0.001) == "0" and element("g", stroke=None) == "<g/>"
