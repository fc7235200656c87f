"""A thing that goes on after it was told."""

from rossec.border.conversations import Quota


def test_what_is_far_beyond_the_rate_is_not_looked_at() -> None:
    quota = Quota(10.0, 20.0)
    assert not quota.is_spent(0.0)
    assert [quota.take(0.0) for _ in range(39)] == [True] * 20 + [False] * 19
    assert not quota.is_spent(0.0)
    assert not quota.take(0.0)
    assert quota.is_spent(0.0)
    assert quota.dropped == 21
    assert not quota.is_spent(0.1)
    assert quota.take(0.1)
