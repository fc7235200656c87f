import pytest

from ca.encoding import Value, encode
from rossec.channel.edhoc.credentials import MAX_CHAIN, Credentials, LiveCredentials, encode_id_cred, x5chain
from rossec.errors import HandshakeFailed, PeerCredentialUnknown
from tests.support.wire import ALICE, BOB


@pytest.mark.parametrize("length", range(1, MAX_CHAIN + 1))
def test_a_chain_there_and_back(length: int) -> None:
    chain = tuple(b"certificate %d" % number for number in range(length))
    credentials = Credentials(ALICE.signer, chain)
    assert x5chain(credentials.id_cred) == chain
    assert credentials.certificate == chain[0]


@pytest.mark.parametrize(
    "id_cred",
    [
        {},
        {4: b"kid"},
        {33: b"a", 4: b"kid"},
        {33: []},
        {33: [b"a"]},  # one alone is a byte string
        {33: [b"a"] * (MAX_CHAIN + 1)},
        {33: [b"a", 1]},
        {33: [b"a", b""]},
        {33: b""},
        {33: b"x" * 8000},
        {33: "text"},
        b"kid",
        7,
    ],
)
def test_an_invalid_chain_is_refused(id_cred: Value) -> None:
    with pytest.raises(HandshakeFailed):
        x5chain(id_cred)


@pytest.mark.parametrize(
    "id_cred", [{33: b"a"}, {33: bytes(300)}, {33: [b"a", b"b"]}, {33: b"a", 4: b"kid"}, {4: b"kid"}, {}, 7]
)
def test_the_fast_path_of_id_cred(id_cred: Value) -> None:
    assert encode_id_cred(id_cred) == encode(id_cred)


def test_a_reference_is_unknown_without_a_cache() -> None:
    with pytest.raises(PeerCredentialUnknown):
        x5chain({34: [-15, b"12345678"]})


def test_live_credentials_are_the_newest() -> None:
    live = LiveCredentials(ALICE)
    assert live.current is ALICE.current is ALICE
    live.current = Credentials(BOB.signer, BOB.chain, shared=True)
    assert live.current.certificate == BOB.certificate
    assert live.current.id_cred == BOB.id_cred
    assert live.current.shared
