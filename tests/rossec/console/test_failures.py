"""Five failures a minute, by address."""

from rossec.console.sessions import MAX_ADDRESSES, MAX_FAILURES, FailureLimit


def failed(address: str, times: int = MAX_FAILURES, now: int = 100) -> FailureLimit:
    limit = FailureLimit()
    for _ in range(times):
        limit.note(address, now)
    return limit


def test_five_within_a_minute_block_for_a_minute() -> None:
    assert not failed("192.0.2.1", 4).is_blocked("192.0.2.1", 100)
    limit = failed("192.0.2.1")
    assert limit.is_blocked("192.0.2.1", 100)
    assert limit.is_blocked("192.0.2.1", 159)
    assert not limit.is_blocked("192.0.2.1", 160)


def test_a_device_does_not_lock_out_another() -> None:
    assert not failed("192.0.2.1").is_blocked("192.0.2.2", 100)


def test_an_ipv6_device_is_its_network() -> None:
    limit = failed("2001:db8::1%eth0")
    assert limit.is_blocked("2001:db8::2", 100)
    assert not limit.is_blocked("2001:db8:1::1", 100)


def test_a_mapped_address_is_the_ipv4_one() -> None:
    assert failed("::ffff:192.0.2.1").is_blocked("192.0.2.1", 100)


def test_behind_a_proxy_which_hides_addresses_nobody_locks_out_all() -> None:
    assert not failed("").is_blocked("", 100)


def test_addresses_are_bounded() -> None:
    limit = failed("192.0.2.1")
    for number in range(MAX_ADDRESSES):
        limit.note(f"10.0.{number // 256}.{number % 256}", 100)
    assert not limit.is_blocked("192.0.2.1", 100)
