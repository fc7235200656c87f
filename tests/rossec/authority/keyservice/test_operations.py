"""What the service does: audited before it is done, and not done where that fails."""

import pytest

from ca.authority import Authority, create_root
from ca.errors import PassphraseRefused
from ca.keys.signing import Signer
from ca.store.values import HEAD_PROFILE, Head, open_head, sign_head
from rossec.authority.keyservice import messages
from rossec.authority.keyservice.messages import MAX_UNLOCKED, ServiceRequest
from rossec.authority.keyservice.operations import HeldKey, KeyOperations, OwnSigner
from rossec.errors import AuthorityLocked, KeyServiceRefused, SigningRefused
from tests.support.pki import new_signer

NOW = 1_800_000_000
RIGHT = "four random words"
SIGNER = new_signer()
ROOT = Authority(SIGNER, create_root(SIGNER, "home", now=NOW, serial=7))
HEAD = Head(5, b"r" * 32, NOW)


class Served:
    """The operations on a key, its clock, and an audit whose disk can be full."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.lines: list[str] = []
        self.is_full = False
        owner = messages.ServedAuthority(ROOT.anchor.subject, "home")
        held = HeldKey(self.load, lambda: self.now)
        self.operations = KeyOperations(held, owner, self.audit, lambda: {"domain": "home"})

    def load(self, passphrase: str) -> Signer:
        if passphrase != RIGHT:
            raise PassphraseRefused("it does not open")
        return SIGNER

    def audit(self, text: str) -> None:
        if self.is_full:
            raise KeyServiceRefused("the audit cannot be written")
        self.lines.append(text)

    def ask(self, operation: str, *arguments: int | str | bytes) -> object:
        return self.operations.carry_out(ServiceRequest(operation, arguments), "user 7, process 8: x")


@pytest.fixture
def served() -> Served:
    return Served()


def to_sign() -> bytes:
    """What a signer gets for `HEAD`."""
    seen: list[bytes] = []

    class Recorder:
        public_key = SIGNER.public_key

        def sign(self, message: bytes) -> bytes:
            seen.append(message)
            return SIGNER.sign(message)

    sign_head(Recorder(), HEAD)
    return seen[0]


def test_status_says_whether_the_key_is_held(served: Served) -> None:
    assert served.ask("status") == {"domain": "home", "locked": True, "remaining": None}
    served.ask("unlock", 60, RIGHT)
    assert served.ask("status") == {"domain": "home", "locked": False, "remaining": 60}
    assert served.ask("lock") == {"domain": "home", "locked": True, "remaining": None}
    caller = "user 7, process 8: x"
    assert served.lines == [f"unlocked for 60 s by {caller}", f"locked by {caller}"]
    served.ask("lock")
    assert len(served.lines) == 2


def test_a_statement_is_signed_and_audited_with_who_asked(served: Served) -> None:
    served.ask("unlock", 0, RIGHT)
    assert served.lines == ["unlocked for as long as it runs by user 7, process 8: x"]
    signature = served.ask("sign", to_sign())
    assert isinstance(signature, bytes)
    assert served.lines[1].startswith("signs a head of the log, SHA-256 ")
    assert served.lines[1].endswith(", for user 7, process 8: x")


def test_unknown_bytes_are_refused_and_audited(served: Served) -> None:
    served.ask("unlock", 0, RIGHT)
    with pytest.raises(SigningRefused):
        served.ask("sign", b"a challenge")
    assert served.lines[1] == "refused to sign 11 unknown bytes for user 7, process 8: x"


def test_a_locked_key_signs_nothing(served: Served) -> None:
    with pytest.raises(AuthorityLocked):
        served.ask("sign", to_sign())
    served.ask("unlock", 60, RIGHT)
    served.now += 60
    with pytest.raises(AuthorityLocked):
        served.ask("sign", to_sign())


def test_without_an_audit_nothing_is_signed_or_unlocked(served: Served) -> None:
    served.ask("unlock", 0, RIGHT)
    served.is_full = True
    with pytest.raises(KeyServiceRefused):
        served.ask("sign", to_sign())
    served.operations.held.lock()
    with pytest.raises(KeyServiceRefused):
        served.ask("unlock", 0, RIGHT)
    assert served.operations.held.remaining() is None


def test_a_wrong_passphrase_is_audited(served: Served) -> None:
    with pytest.raises(PassphraseRefused):
        served.ask("unlock", 60, "wrong")
    assert served.lines == ["failed to unlock for user 7, process 8: x: it does not open"]
    with pytest.raises(KeyServiceRefused, match="may be tried in"):
        served.ask("unlock", 60, RIGHT)


@pytest.mark.parametrize("seconds", [-1, MAX_UNLOCKED + 1])
def test_a_time_out_of_range_is_refused(served: Served, seconds: int) -> None:
    with pytest.raises(KeyServiceRefused, match="where 0 to"):
        served.ask("unlock", seconds, RIGHT)
    with pytest.raises(KeyServiceRefused):
        served.ask("unlock", 60, "x" * 5000)
    assert served.lines == []


def test_it_locks_itself_when_the_time_is_over(served: Served) -> None:
    served.ask("unlock", 60, RIGHT)
    served.operations.lock_if_over()
    assert served.operations.held.remaining() == 60
    served.now += 61
    served.operations.lock_if_over()
    served.operations.lock_if_over()
    assert served.lines[1:] == ["locked: its time is over"]


def test_its_own_signatures_are_audited_with_their_purpose(served: Served) -> None:
    served.ask("unlock", 0, RIGHT)
    signer = OwnSigner(served.operations, SIGNER.public_key, "a join")
    assert signer.public_key == SIGNER.public_key
    assert open_head(sign_head(signer, HEAD), SIGNER.public_key) == HEAD
    assert served.lines[1].endswith(", for a join")
    assert HEAD_PROFILE.typ == "rossec-log+cwt"


def test_what_waited_for_the_key_is_told_when_it_is_there(served: Served) -> None:
    told: list[bool] = []
    served.operations.on_unlock = lambda: told.append(served.operations.held.remaining() == 60)
    with pytest.raises(PassphraseRefused):
        served.ask("unlock", 60, "wrong")
    served.now += 100
    assert told == []
    served.ask("unlock", 60, RIGHT)
    assert told == [True]


def test_other_acts_are_audited_too(served: Served) -> None:
    served.operations.audit("an approval")
    assert served.lines[-1] == "an approval"
    served.is_full = True
    with pytest.raises(KeyServiceRefused):
        served.operations.audit("another")
