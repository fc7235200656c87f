import itertools

from hypothesis import given
from hypothesis import strategies as st

from rossec.gateway.rules import Thinning


def test_the_last_message_goes_when_the_rate_admits_it() -> None:
    thinning = Thinning(2)
    dues = [thinning.due]
    assert thinning.take(b"1", 10.0) == b"1"
    assert thinning.take(b"2", 10.1) is None
    assert thinning.take(b"3", 10.2) is None
    dues.append(thinning.due)
    assert thinning.release(10.4) is None
    assert thinning.release(10.5) == b"3"
    assert [*dues, thinning.due] == [None, 10.5, None]
    assert thinning.release(99) is None
    assert thinning.take(b"4", 100) == b"4"


@given(st.lists(st.floats(0, 3), max_size=40))
def test_the_last_is_always_delivered_and_the_rate_is_kept(gaps: list[float]) -> None:
    thinning, now, gone = Thinning(1), 0.0, list[tuple[float, bytes]]()
    for number, gap in enumerate(gaps):
        end = now + gap
        if thinning.due is not None and thinning.due <= end:
            now = thinning.due
            gone.append((now, thinning.release(now) or b""))
        now = end
        if (sent := thinning.take(b"%d" % number, now)) is not None:
            gone.append((now, sent))
    if thinning.due is not None:
        gone.append((thinning.due, thinning.release(thinning.due) or b""))
    assert [data for _, data in gone[-1:]] == [b"%d" % (len(gaps) - 1)] * bool(gaps)
    assert all(b - a >= 1 - 1e-9 for (a, _), (b, _) in itertools.pairwise(gone))
