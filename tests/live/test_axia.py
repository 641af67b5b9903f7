"""An Axia speaks the protocol of the Net Box with another table of status codes, and may count at another rate."""

from dataclasses import replace

import pytest

from probedesign.live.sources.netft_rdt import AXIA, NET_BOX, RATE_PERIOD, RateMonitor, fault_of
from probedesign.live.sources.source import open_source
from probedesign.simulation.netft_box import NATIVE
from tests.live.peers import Reader, box

#: Patterns of one condition each: ATI, manual 9610-05-Ethernet Axia-09, table 4.9, page 37.
PATTERNS = {
    0x80000001: "temperature", 0x80000002: "supply voltage", 0x80000004: "broken gauge", 0x80000008: "busy",
    0x80000020: "other error", 0x88000000: "gauge out of range", 0x10000000: "simulated", 0xA0000000: "checksum",
    0xC0000000: "force or torque out of range",
}  # fmt: skip


@pytest.mark.parametrize(("status", "text"), PATTERNS.items())
def test_the_patterns_of_the_manual(status, text):
    fault = fault_of(status, AXIA)
    assert text in fault and f"0x{status:08x}" in fault and ", " not in fault


def test_other_words_of_an_axia_and_of_a_net_box():
    """The manual's example 80000005: temperature, broken gauge and any error."""
    fault = fault_of(0x80000005, AXIA)
    assert "temperature" in fault and "broken gauge" in fault
    assert fault_of(0x00000000, AXIA) == fault_of(0x00010000, AXIA) == ""
    assert "unknown" in fault_of(0x80000000, AXIA)
    assert "temperature" not in fault_of(0x80000002, AXIA) and "HTTP" in fault_of(0x80000002, NET_BOX)


@pytest.mark.parametrize(
    ("product", "query", "kind"),
    [("Ethernet Axia", "", "Axia"), ("Net F/T", "", "Net Box"), ("Net F/T", "&sensor=axia", "Axia"),
     ("Ethernet Axia", "&sensor=netbox", "Net Box")],
)  # fmt: skip
def test_the_table_follows_the_product_and_is_stated(estimator, product, query, kind):
    with box(estimator, replace(NATIVE, product=product)) as peer:
        source = open_source(peer.source + query, estimator.model)
    assert any(note.endswith(f"of type {kind}") for note in source.notes)


def test_faults_of_the_stream_are_decoded_by_the_table(estimator):
    """The simulated box sets the bits of a Net Box at its limit, 31 and 17; an Axia has no condition at bit 17."""
    with box(estimator, replace(NATIVE, product="Axia80"), load=1e3) as peer, Reader(peer, estimator) as reader:
        reader.has_logged("unknown fault (status 0x80020000)")
    assert all(r.fault for r in reader.readings)


# the rate of the counter


def rates_of(rate, assumed, seconds=4 * RATE_PERIOD):
    monitor = RateMonitor(assumed)
    found = [monitor.measured(0.01 * i * rate / assumed, 100.0 + 0.01 * i) for i in range(round(100 * seconds))]
    return [each for each in found if each is not None]


@pytest.mark.parametrize("rate", [488.0, 976.0, 1953.0, 3906.0, 6800.0, 7000.0, 7300.0, 7912.0])
def test_another_rate_is_measured_and_reported_once(rate):
    """Rates of the manual, 9620-05-C-Ethernet Axia-02, table 5.5; two intervals suffice. 1e-9 for rounding."""
    near = abs(rate / 7000.0 - 1.0) < 0.05
    assert rates_of(rate, 7000.0) == ([] if near else [pytest.approx(rate, rel=1e-9)])


def test_a_stated_rate_scales_the_time(estimator):
    """Stated as half of what it is, time runs twice as fast as the host's clock; readings queue for 0.1 s at most."""
    with box(estimator) as peer, Reader(peer, estimator, "&clock_hz=3500") as reader:
        reader.more(700)
    first, last = reader.readings[0], reader.readings[-1]
    assert last.time - first.time == pytest.approx(2.0 * (last.received - first.received), abs=0.2)
