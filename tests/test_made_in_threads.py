"""Results that threads make: each once, errors kept, waiters and the session woken."""

import queue
import threading

import pytest
from patience import HANGING

from shpy.run.background import Background


def test_many_threads_begin_a_key_and_it_is_made_once():
    results, calls, open_gate = Background(), [], threading.Event()

    def make():
        calls.append(threading.current_thread())
        assert open_gate.wait(HANGING)
        return 7

    threads = [threading.Thread(target=results.begin, args=("k", make)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (results.is_awaited("k"), results.is_done("k"), results.is_awaited("other")) == (True, False, False)
    open_gate.set()
    assert (results.result("k"), len(calls)) == (7, 1)
    assert calls[0] is not threading.current_thread()
    assert not results.is_awaited("k")


def test_an_error_is_kept_until_it_is_forgotten_and_others_go_on():
    wakes = queue.SimpleQueue()
    results = Background(lambda: wakes.put(None))
    results.begin("bad", lambda: 1 // 0)
    results.begin("good", lambda: 3)
    assert results.result("good") == 3
    results.wait("bad")
    assert isinstance(results.error("bad"), ZeroDivisionError)
    assert not results.is_done("bad")
    with pytest.raises(ZeroDivisionError):
        results.result("bad")
    for _ in range(2):
        wakes.get(timeout=HANGING)
    results.forget("bad")
    assert results.error("bad") is None
    results.begin("bad", lambda: 4)
    assert results.result("bad") == 4


def test_a_later_beginning_is_awaited_and_a_second_call_ends_the_wait():
    results = Background()
    results.begin_after(3600, "k", lambda: 5)
    assert results.is_awaited("k")
    assert not results.has_ended("k")
    results.begin_after(3600, "k", lambda: 5)
    assert results.result("k") == 5
    results.begin_after(0.001, "soon", lambda: 6)
    results.begin("soon", lambda: 6)
    assert results.result("soon") == 6
