"""Datagrams of a box and their arrival: one call for all that wait, and one by one."""

import socket
import sys
import time

import numpy as np
import pytest

from probedesign.live.sources.netft import MAX_RECORDS, BatchReceiver, SingleReceiver, open_receiver
from probedesign.live.sources.netft_rdt import RECORD

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="only Linux reads many datagrams in one call")


@pytest.fixture
def wire():
    """A sender and the connected socket of its receiver, which does not block."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link,
    ):
        sender.bind(("127.0.0.1", 0))
        link.bind(("127.0.0.1", 0))
        sender.connect(link.getsockname())
        link.connect(sender.getsockname())
        link.setblocking(False)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        yield sender, link


def receivers(link):
    """Every kind of receiver that this system has."""
    yield SingleReceiver(link)
    if isinstance(batched := open_receiver(link), BatchReceiver):
        yield batched


def record(number):
    return RECORD.pack(number, 2**32 - 1 - number, 2**31, -number, number, -(2**31), 2**31 - 1, 0, 5)


def test_both_receivers_return_the_records_that_were_sent(wire):
    sender, link = wire
    hostile = (b"", b"x", bytes(35), bytes(37), bytes(64), bytes(1500))
    for receiver in receivers(link):
        for number in range(1, 20):
            for datagram in hostile if number % 5 == 0 else ():
                sender.send(datagram)
            sender.send(record(number))
            if number % 7 == 0:
                receiver.read()  # in several calls, with datagrams that are no record in between
        receiver.read()
        assert receiver.count == 19 and receiver.malformed == 3 * len(hostile)
        words, received, _ = receiver.take()
        expected = [[*RECORD.unpack(record(number))] for number in range(1, 20)]
        assert words.tolist() == expected
        assert (np.diff(received) >= 0.0).all() and received[-1] <= time.monotonic()
        assert receiver.count == 0


def test_a_receiver_is_used_again_and_reads_nothing_where_nothing_waits(wire):
    sender, link = wire
    for receiver in receivers(link):
        receiver.read()
        assert receiver.count == 0
        for number in (1, 2, 3):
            sender.send(record(number))
            receiver.read()
            assert receiver.take()[0][:, 0].tolist() == [number]


def test_what_exceeds_the_memory_waits_for_the_next_reading(wire):
    sender, link = wire
    for receiver in receivers(link):
        for number in range(MAX_RECORDS + 3):
            sender.send(record(number))
        receiver.read()
        receiver.read()
        first = receiver.take()[0][:, 0].tolist()
        receiver.read()
        assert first + receiver.take()[0][:, 0].tolist() == list(range(MAX_RECORDS + 3))


@LINUX
def test_dropped_datagrams_are_counted_by_the_system(wire):
    sender, link = wire
    receiver = open_receiver(link)
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)  # the least that the system grants
    for number in range(200):
        sender.send(record(number))
    receiver.read()
    kept = receiver.count
    receiver.take()
    sender.send(record(200))  # a datagram states how many were dropped before it
    receiver.read()
    assert 0 < kept < 200 and receiver.take()[2] == 200 - kept


@LINUX
def test_a_closed_sender_ends_no_reading(wire):
    """The system reports it as an error of the next call, which is no datagram."""
    sender, link = wire
    receiver = open_receiver(link)
    sender.send(record(1))
    sender.close()
    link.send(b"request")
    for _ in range(3):
        receiver.read()
    assert receiver.take()[0][:, 0].tolist() == [1]
