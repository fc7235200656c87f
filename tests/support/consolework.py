"""An authority whose console's operations are called in this process; its clock is the test's."""

import secrets
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol, TypeVar

from ca.encoding import Value
from grants.document import grant_id
from grants.model import Draft, Permission, Right
from grants.request import GrantRequest, RequestedRight, sign_request
from rossec.authority.console.messages import from_value
from rossec.authority.console.serving import handlers_of
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.process import operations_of
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.requests import put_in_inbox
from rossec.authority.session import StatementCall
from rossec.errors import NotDelivered
from rossec.home import NodeHome
from tests.support.commands import PASSPHRASE

NOW = 1_800_000_000
T = TypeVar("T")


class Part(Protocol):
    """As `rossec.authority.console.serving.Part`."""

    def handlers(self) -> Mapping[str, Callable[..., Value]]: ...


class ConsoleWork:
    """An authority below `root`, locked; its audit is a list, and it has no master."""

    def __init__(self, root: Path) -> None:
        self.root, self.now, self.seconds = root, NOW, 1000.0
        self.home = AuthorityHome.create(root, "home", PASSPHRASE, NOW)
        self.audit: list[str] = []
        self.called: list[StatementCall] = []
        self.answers: list[object] = []  # of a master; without any there is none
        self.operations = operations_of(self.home, self.audit.append)
        self.work = AuthorityWork(root, self.operations, self._deliver, now=lambda: self.now)

    def wait(self, seconds: int) -> None:
        """Time passes."""
        self.now += seconds
        self.seconds += seconds

    def elapsed(self) -> float:
        """A clock that cannot be set."""
        return self.seconds

    def unlock(self) -> None:
        """Hold the key while this runs."""
        self.operations.unlock(PASSPHRASE, 0, "a test")

    def enroll(self, name: str) -> NodeHome:
        """A node with an identity, whose directory is elsewhere than the authority's."""
        node = NodeHome.of(self.root / "elsewhere", name)
        node.create_request("home")
        authority = self.home.unlock(PASSPHRASE)
        node.install(authority.issue(node.request(), self.now, 30 * 86400), self.now)
        authority.store.close()
        return node

    def grant(self, name: str, lifetime: int, rules: str = "") -> bytes:
        """A grant to subscribe `/pose`, recorded; returns its id."""
        authority = self.home.unlock(PASSPHRASE)
        holder = authority.store.valid_certificate(name, self.now).thumbprint
        draft = Draft(
            domain="home",
            subject=name,
            holder=holder,
            not_before=self.now - 60,
            expires=self.now + lifetime,
            cap=self.now + lifetime,
            serial=secrets.token_bytes(16),
            permissions=(Permission("/pose", Right.SUBSCRIBE),),
        )
        data = authority.issue_grant(draft, self.now, rules)
        authority.store.close()
        return grant_id(data)

    def ask_for(self, node: NodeHome, *rights: RequestedRight, why: str = "please") -> bytes:
        """A request of a node in the inbox; returns its id."""
        name = node.name
        asked = GrantRequest("home", name, self.now, secrets.token_bytes(16), rights, why)
        data = sign_request(node.credentials().signer, asked)
        put_in_inbox(self.home.path, asked, data)
        return asked.id

    def _deliver(self, call: StatementCall) -> object:
        self.called.append(call)
        if self.answers:
            return self.answers.pop(0)
        raise NotDelivered(f"the master did not get {call.what}: there is none", call.hint)


def ask(part: object, operation: str, *arguments: Value) -> Value:
    """Have a part carry out an operation."""
    return handlers_of(part)[operation](*arguments)


def many(kind: type[T], value: Value) -> tuple[T, ...]:
    """The records of an answer, as the console reads them."""
    return from_value(tuple[kind, ...], value)  # type: ignore[valid-type]
