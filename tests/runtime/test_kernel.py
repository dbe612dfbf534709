"""What the loop's thread has used."""

import threading
import time

import numpy as np

from runtime.kernel import own_use

ENOUGH_NS = 20_000_000


def compute_for(ns: int) -> None:
    end_ns = time.thread_time_ns() + ns
    while time.thread_time_ns() < end_ns:
        pass


def test_what_another_thread_computes_is_not_the_calling_ones() -> None:
    before_ns, _ = own_use()
    other = threading.Thread(target=compute_for, args=(ENOUGH_NS,))
    other.start()
    other.join()
    assert own_use()[0] - before_ns < ENOUGH_NS / 2
    compute_for(ENOUGH_NS)
    assert own_use()[0] - before_ns >= ENOUGH_NS


def test_the_first_touch_of_memory_is_a_page_fault() -> None:
    _, before = own_use()
    np.ones(10_000_000)
    assert own_use()[1] > before
