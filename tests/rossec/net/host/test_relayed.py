"""What comes by a relay of this host comes from loopback, and is not near."""

import pytest

from rossec.host.addresses import is_near, is_relayed, source_for


def test_each_remote_relay_has_an_address_of_its_own() -> None:
    found = {source_for(f"/remote/label{number}/relay") for number in range(50)}
    assert len(found) == 50
    assert all(is_relayed(address) and not is_near(address, "127.0.0.1") for address in found)
    assert source_for("/relay") == source_for("/relay")


@pytest.mark.parametrize("address", ["127.82.3.4", "::ffff:127.82.3.4"])
def test_it_is_recognized_in_both_families(address: str) -> None:
    assert is_relayed(address)
    assert not is_near(address, address)


@pytest.mark.parametrize("address", ["127.0.0.1", "::1", "127.81.3.4"])
def test_loopback_is_near(address: str) -> None:
    assert is_near(address, "10.0.0.1")
    assert not is_relayed(address)


@pytest.mark.parametrize("address", ["10.0.0.1", "fe80::1%eth0"])
def test_an_own_address_is_near_and_another_is_not(address: str) -> None:
    assert is_near(address, address)
    assert not is_near(address, "10.0.0.2")
    assert not is_relayed("unknown")
