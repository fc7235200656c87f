from rossec.channel.records import Limits
from tests.support.wire import NOW, alice, bob, joined


def test_nothing_is_renewed_before_its_time() -> None:
    w = joined(left=alice(limits=Limits(seconds=100)), right=bob())
    session = w.left.core._open_session()
    session.seal_small(b"used")
    assert session.renew(NOW + 99) == b""
    assert session.renew(NOW + 100) != b""
