"""A bucket fills at its rate, up to its capacity."""

from grants.limits import TokenBucket


def test_a_bucket_fills_at_its_rate_up_to_its_capacity() -> None:
    bucket = TokenBucket(10, 10)
    assert bucket.refill(1.0) == 10
    bucket.tokens -= 10
    assert bucket.refill(1.5) == 5
    assert bucket.refill(1.75) == 7.5
    assert bucket.refill(99) == 10


def test_a_clock_set_back_adds_nothing() -> None:
    bucket = TokenBucket(1, 5, 2)
    assert [bucket.refill(now) for now in (100, 0, 1)] == [2, 2, 3]


def test_a_bucket_never_has_more_than_its_capacity() -> None:
    assert TokenBucket(1, 5, 7).tokens == 5
    assert TokenBucket(0, 0).refill(9) == 0
