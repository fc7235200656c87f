from rossec.channel.records import Limits
from tests.support.wire import NOW, alice, bob, joined


def test_nothing_is_renewed_before_its_time() -> None:
    w = joined(left=alice(limits=Limits(seconds=100)), right=bob())
    session = w.left.core._open_session()
    session.seal_small(b"used")
    assert session.renew(NOW + 99) == b""
    assert session.renew(NOW + 100) != b""


def test_large_records_may_share_one_buffer() -> None:
    w = joined()
    unit = bytes(range(256)) * 3000
    for _ in range(2):
        for record in w.left.core.seal_unit(unit, reuse=True):
            w.right.give(bytes(record))
    assert w.right.units == [unit, unit]
    session = w.left.core._open_session()
    assert session._shared_buffer() is session._shared_buffer()
