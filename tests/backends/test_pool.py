"""Pools: things are used again by kind, at most so many bytes are kept, and what is lent comes back."""

import pytest

from shpy.backend.device import pool as pools
from shpy.backend.device.pool import Kind, Pool, rounded


def never():
    pytest.fail("there is one to be used again")


def test_things_are_used_again_by_kind():
    pool = Pool()
    small, large = Kind(64), Kind(128)
    first = pool.take(small, object)
    pool.give_back(small, first)
    assert pool.take(large, object) is not first
    assert pool.take(Kind(64, "other form"), object) is not first
    assert pool.take(small, never) is first
    assert pool.take(small, object) is not first


def test_no_more_bytes_are_kept_than_the_bound(monkeypatch):
    monkeypatch.setattr(pools, "_MOST", 200)
    released = []
    pool = Pool(released.append)
    for thing in "abc":
        pool.give_back(Kind(100), thing)
    assert released == ["c"]
    assert pool.take(Kind(100), never) == "b"
    pool.give_back(Kind(101), "d")
    assert released == ["c", "d"]
    assert len(pool) == 1


def test_what_is_lent_comes_back_with_the_end_of_the_loan():
    pool, kind = Pool(), Kind(8)
    loan = pool.lend(kind, "thing")
    assert pool.take(kind, lambda: "another") == "another"
    del loan
    assert len(pool) == 1
    assert pool.take(kind, never) == "thing"


def test_what_was_left_to_others_does_not_come_back():
    pool, kind = Pool(), Kind(8)
    loan = pool.lend(kind, "thing")
    assert loan.detach()
    assert not loan.detach()
    del loan
    assert len(pool) == 0


@pytest.mark.parametrize(("extent", "size"), [(0, 1), (1, 1), (2, 2), (3, 4), (64, 64), (65, 128)])
def test_sizes_are_powers_of_two(extent, size):
    assert rounded(extent) == size
