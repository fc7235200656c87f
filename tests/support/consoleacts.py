"""An authority's service as its console uses it, without sockets: played phones and master.

`console.approve(phone, "enroll", ...)` prepares, touches and approves; what its clocks say and
whether the master answers is for the test to say.
"""

import copy
import secrets
import shutil
import tempfile
from collections.abc import Callable
from contextlib import closing
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

from ca.encoding import Value
from ca.store.record import Store
from ca.svid import build_request
from grants.model import Right
from grants.request import GrantRequest, RequestedRight, sign_request
from rossec.authority.console.access import ConsoleAccess
from rossec.authority.console.approved_acts import acts_of
from rossec.authority.console.approving import ApprovalDependencies, Approving
from rossec.authority.console.grant_requests import Removals
from rossec.authority.console.messages import ApprovalOutcome, Prepared, from_value
from rossec.authority.grant_queue import GrantRequestQueue
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.operations import KeyOperations
from rossec.authority.keyservice.process import operations_of
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.policyfile import PolicyFile
from rossec.authority.session import StatementCall
from rossec.errors import KeyServiceRefused, NotDelivered
from rossec.ros.names import MASTER
from tests.support.approving import registered
from tests.support.passkeys import Passkey
from tests.support.pki import new_signer

NOW, DAY, SECRET = 1_800_000_000, 86_400, "four random words here"
JOIN_ADDRESS = "127.0.0.1:7413"
POLICY = """rossec: 1
robot: r
types: {/pose: geometry_msgs/PoseStamped}
rules:
  - {id: a, who: "/fleet/*", allow: {subscribe: [/pose]}}
  - {id: b, who: /map, prompt: {subscribe: [/pose]}}
"""


@lru_cache(1)
def _authority() -> Path:
    """One that is copied: to make its key takes a second."""
    root = Path(tempfile.mkdtemp(prefix="rossec-console"))
    AuthorityHome.create(root, "home", SECRET, NOW)
    return root


class Acts:
    """The service of a new authority below `root`, unlocked, with one phone."""

    def __init__(self, root: Path) -> None:
        shutil.copytree(_authority(), root, dirs_exist_ok=True)
        self.root, self.now, self.elapsed = root, NOW, 0.0
        self.home = AuthorityHome.at(root)
        self.audit: list[str] = []
        self.calls: list[StatementCall] = []
        self.woken = 0
        self.reachable = True
        self.disk_is_full = False
        self.before_audit: Callable[[], object] = str
        self.operations = operations_of(self.home, self.write_audit)
        self.start()
        self.unlock()
        self.phone = Passkey()
        with self.store() as store:
            store.passkeys.add(registered(self.phone, at=self.now))
        (self.home.path / "policy.yaml").write_text(POLICY)

    def start(self) -> None:
        """As a service that was restarted: what was in memory is gone."""
        self.work = AuthorityWork(self.root, self.operations, self.deliver, None, lambda: self.now)
        self.access = ConsoleAccess(self.work, self.write_audit, lambda: self.elapsed)
        needs = ApprovalDependencies(self.work, self.write_audit, self.wake, self.access.counter)
        acts = acts_of(self.work, self.access, lambda: JOIN_ADDRESS, lambda: self.elapsed)
        self.approving = Approving(needs, acts, lambda: self.elapsed)
        self.removals = Removals(self.work, self.wake)

    def moved(self, root: Path, operations: KeyOperations | None = None) -> Self:
        """The service of the same authority, copied to `root`, as if it had just started."""
        shutil.copytree(self.root, root)
        other = copy.copy(self)
        other.root, other.home, other.calls = root, AuthorityHome.at(root), []
        other.operations = operations or self.operations
        other.start()
        return other

    def write_audit(self, text: str) -> None:
        self.before_audit()
        if self.disk_is_full:
            raise KeyServiceRefused("the audit cannot be written", "make room")
        self.audit.append(text)

    def wake(self) -> None:
        self.woken += 1

    def unlock(self) -> None:
        self.operations.unlock(SECRET, 0, "a test")

    def lock(self) -> None:
        self.operations.held.lock()

    def pass_time(self, seconds: int) -> None:
        """On both clocks."""
        self.now += seconds
        self.elapsed += seconds

    def store(self) -> "closing[Store]":
        return closing(self.home.store())

    def deliver(self, call: StatementCall) -> object:
        if not self.reachable:
            raise NotDelivered("no master", call.hint)
        self.calls.append(call)
        (items,) = call.statement[:1]
        return [""] * len(items) if isinstance(items, list) else 1

    def prepare(self, kind: str, *arguments: Value) -> Prepared:
        return from_value(Prepared, self.approving.prepare(kind, [*arguments]))

    def touch(self, prepared: Prepared, phone: Passkey | None = None, **flaws: Any) -> ApprovalOutcome:
        """Approve what was prepared; flaws as of `Passkey.sign`."""
        signed = (phone or self.phone).sign(prepared.challenge, **flaws)
        return from_value(ApprovalOutcome, self.approving.approve(prepared.id, *signed))

    def approve(self, kind: str, *arguments: Value) -> ApprovalOutcome:
        return self.touch(self.prepare(kind, *arguments))

    def outcome(self, number: bytes) -> ApprovalOutcome:
        return from_value(ApprovalOutcome, self.approving.outcome(number))

    def csr(self, name: str = "/lamp") -> bytes:
        return build_request(new_signer(), "home", name)

    def enroll(self, name: str = "/lamp", **changes: Any) -> ApprovalOutcome:
        return self.touch(self.asks(name, **changes))

    def asks(
        self, name: str = "/lamp", *, csr: bytes | None = None, wildcard: bool = False, replaces: bool = False
    ) -> Prepared:
        """A node asks for an identity, and the page shows it."""
        given = self.csr(name) if csr is None else csr
        return self.prepare("enroll", given, "code", wildcard, 30 * DAY, replaces)

    def ask(self, name: str = "/map", *topics: str) -> bytes:
        """A node is enrolled and asks to subscribe; returns the id of its question."""
        signer = new_signer()
        assert self.enroll(name, csr=build_request(signer, "home", name)).state == "done"
        rights = tuple(RequestedRight(Right.SUBSCRIBE, topic) for topic in topics or ("/pose",))
        asked = GrantRequest("home", name, self.now, secrets.token_bytes(16), rights, "to draw")
        policy = PolicyFile.read(self.work.policy_path())
        with closing(GrantRequestQueue(self.home, policy, self.now)) as queue:
            queue.add_request(sign_request(signer, asked))
        return asked.id

    def enroll_master(self) -> None:
        assert self.enroll(MASTER).state == "done"

    def grants(self, name: str) -> int:
        with self.store() as store:
            return sum(row.name == name for row in store.grants())

    def audit_record(self) -> None:
        """The record is whole, approvals included."""
        with self.store() as store:
            store.log.audit(self.home.own_key())
