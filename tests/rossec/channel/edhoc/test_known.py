import pytest

from rossec.channel.edhoc import credentials
from rossec.channel.edhoc.credentials import KnownCertificates, reference
from rossec.errors import HandshakeFailed, PeerCredentialUnknown

CHAIN = (b"certificate", b"intermediate")


def test_a_reference_finds_a_cached_chain() -> None:
    memory = KnownCertificates()
    with pytest.raises(PeerCredentialUnknown):
        memory.find(reference(CHAIN[0]))
    memory.remember(CHAIN)
    memory.remember(CHAIN)
    assert memory.find(reference(CHAIN[0])) == CHAIN
    assert memory.find({33: b"by value"}) == (b"by value",)


@pytest.mark.parametrize("bad", [{34: [-16, bytes(32)]}, {34: b"x" * 8}, {34: [-15, b""], 1: 1}, {}])
def test_other_references_are_refused(bad: dict[int | str, object]) -> None:
    with pytest.raises(HandshakeFailed):
        KnownCertificates().find(bad)  # type: ignore[arg-type]  # a narrower map is a Value


def test_a_hash_that_two_certificates_share_finds_neither(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(credentials, "_short", lambda _: bytes(8))
    memory = KnownCertificates()
    for chain in (CHAIN, (b"other",), CHAIN):
        memory.remember(chain)
    with pytest.raises(PeerCredentialUnknown):
        memory.find(reference(CHAIN[0]))


def test_the_cache_is_bounded() -> None:
    memory = KnownCertificates(2)
    for certificate in (b"a", b"b", b"c"):
        memory.remember((certificate,))
        memory.introduced[certificate] = None
        memory.addresses["host", certificate[0]] = None
    assert len(memory) == 2
    with pytest.raises(PeerCredentialUnknown):
        memory.find(reference(b"a"))
    assert [c in memory.introduced for c in (b"a", b"b", b"c")] == [False, True, True]
    assert [("host", c) in memory.addresses for c in b"abc"] == [False, True, True]
    memory.introduced.clear()
    assert b"c" not in memory.introduced
