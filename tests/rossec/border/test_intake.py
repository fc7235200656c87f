"""Datagrams of strangers: nobody's many keep out another's one."""

from rossec.border.conversations import BURST, OF_ALL, OF_HOST, OF_PORT, RATE, DatagramQueue

THING = ("::7", 5683, 0, 0)


def address(host: int, port: int = 1) -> tuple[str, int]:
    return f"10.{host >> 16}.{host >> 8 & 255}.{host & 255}", port


def test_hosts_take_turns_and_of_a_host_its_ports() -> None:
    intake = DatagramQueue()
    for number in range(3):
        intake.put(b"a%d" % number, address(1))
    intake.put(b"b", address(2))
    intake.put(b"other port", address(1, 2))
    taken = [found[0] for found in iter(intake.take, None)]
    assert taken == [b"a0", b"b", b"other port", b"a1", b"a2"]
    assert len(intake) == 0


def test_a_network_of_ipv6_is_one_host() -> None:
    intake = DatagramQueue()
    for number in range(OF_HOST * 2):
        intake.put(b"x", (f"2001:db8::{number:x}", 1, 0, 0))
    intake.put(b"y", ("2001:db8:0:1::1", 1, 0, 0))
    assert len(intake) == OF_HOST + 1
    assert [intake.take() for _ in range(2)][1] == (b"y", ("2001:db8:0:1::1", 1, 0, 0))


def test_what_waits_is_bounded_for_a_port_a_host_and_in_all() -> None:
    intake = DatagramQueue()
    for _ in range(OF_PORT * 2):
        intake.put(b"x", address(1))
    assert (len(intake), intake.lost) == (OF_PORT, OF_PORT)
    for number in range(OF_ALL * 2):
        intake.put(b"x", address(2 + number))
    assert len(intake) == OF_ALL
    assert len(list(iter(intake.take, None))) == OF_ALL


def test_a_thing_is_first_within_its_rate() -> None:
    """A forged address is limited too."""
    intake = DatagramQueue()
    assert sum(intake.is_first(THING, 5.0) for _ in range(1000)) == BURST
    assert intake.is_first(address(1), 5.0)
    assert sum(intake.is_first(THING, 6.0) for _ in range(1000)) == RATE
