"""Batches: the datagrams of many calls in one, whole and in order, and the kernel's count of what it dropped."""

import socket
import time

import pytest

from runtime.batch_receive import BATCH, DATAGRAM_MAX_BYTES, SO_RXQ_OVFL, SO_TIMESTAMPNS, SingleReceiver, receiver_of


@pytest.fixture
def pair():
    receiving, sending = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    receiving.bind(("127.0.0.1", 0))
    receiving.setblocking(False)
    sending.connect(receiving.getsockname())
    yield receiving, sending
    receiving.close()
    sending.close()


def test_datagrams_come_whole_and_in_order_whatever_their_length(pair) -> None:
    receiving, sending = pair
    sent = [bytes([index % 251]) * (index * 29 % 1200) for index in range(BATCH + 10)]
    for datagram in sent:
        sending.send(datagram)
    receiver = receiver_of(receiving)
    first, second, third = (receiver.receive(1000) for _ in range(3))
    assert first.datagrams + second.datagrams == sent
    assert (first.full, second.full, third.datagrams) == (True, False, [])


def test_a_limit_is_kept_and_the_rest_waits(pair) -> None:
    receiving, sending = pair
    for index in range(5):
        sending.send(bytes([index]))
    receiver = receiver_of(receiving)
    assert receiver.receive(2).datagrams == [b"\0", b"\1"]
    assert receiver.receive(9).datagrams == [b"\2", b"\3", b"\4"]


def test_a_datagram_that_is_too_long_is_cut(pair) -> None:
    receiving, sending = pair
    sending.send(b"x" * 3000)
    sending.send(b"after")
    assert [len(one) for one in receiver_of(receiving).receive(4).datagrams] == [DATAGRAM_MAX_BYTES, 5]


def test_stamps_are_of_the_arrival(pair) -> None:
    receiving, sending = pair
    receiving.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    receiver = receiver_of(receiving)
    for _ in range(50):  # the kernel begins to stamp a little after it was asked
        before_ns = time.time_ns()
        sending.send(b"one")
        after_ns = time.time_ns()
        time.sleep(0.01)
        (stamp_ns,) = receiver.receive(4).stamps_ns
        if stamp_ns <= after_ns:
            break
    assert before_ns <= stamp_ns <= after_ns
    receiving.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 0)
    sending.send(b"two")
    assert receiver.receive(4).stamps_ns == [0], "the stamp of an earlier datagram does not remain"


@pytest.mark.parametrize("stamped", [0, 1])
def test_the_kernels_count_of_dropped_datagrams_is_read(pair, stamped: int) -> None:
    receiving, sending = pair
    receiving.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    receiving.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
    receiving.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, stamped)
    receiver = receiver_of(receiving)
    for _ in range(200):
        sending.send(bytes(500))
    queued = len(receiver.receive(1000).datagrams)
    sending.send(b"the next one carries the count")
    receiver.receive(4)
    assert 0 < queued < 200
    assert receiver.dropped == 200 - queued


def test_a_system_without_the_call_gets_one_datagram_at_a_time(pair) -> None:
    receiving, sending = pair
    sending.send(b"one")
    sending.send(b"two")
    receiver = SingleReceiver(receiving)
    assert receiver.receive(9) == ([b"one"], [0], True)
    assert receiver.receive(9) == ([b"two"], [0], True)
    assert receiver.receive(9) == ([], [0][:0], False)
