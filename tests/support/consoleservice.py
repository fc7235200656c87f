"""A service at a console's socket, with a home full of views: no authority, no key, no record.

What its operations return are its attributes, which a test changes; what takes away, or gives,
changes them too. `refusals` makes an operation refuse.
"""

import asyncio
import contextlib
import hashlib
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from ca.encoding import Value, encode
from ca.errors import HintedError
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from ca.svid import build_request
from grants.document import grant_id, peek, scope_of, sign
from grants.model import Draft, FilterRule, Permission, Restriction, Right
from rossec.authority.console import messages
from rossec.authority.console.messages import (
    ApprovalOutcome,
    ApprovalView,
    AskedRight,
    DenialView,
    EventView,
    FactView,
    GrantQuestion,
    GrantView,
    IdentityRequestView,
    InvitationView,
    ListProgress,
    LoginChallenge,
    NodeView,
    PhoneView,
    PolicyName,
    PolicyRight,
    PolicyView,
    Prepared,
    Proposal,
    QuestionAnswer,
    Status,
    to_value,
)
from rossec.authority.console.serving import ConsoleService
from rossec.authority.keyservice.process import KeyServer, SocketRules
from rossec.errors import KeyServiceRefused
from tests.support.authority import EnrolledNode, Site

DAY = 86400
COARSE = Restriction(
    "geometry_msgs/PoseStamped", (), (FilterRule("pose.position", "round", (("step", 0.5),)),), 1.0
)
_KINDS = ("enroll", "grant", "policy", "delegate", "intermediate", "passkey", "invitation")


class FakeHome:
    """A robot `/robot`, a doctor who may see where it is, a heating that may coarsely, a map."""

    def __init__(self) -> None:
        self.site = Site()
        self.now = self.site.now
        self.number = 1
        self.remaining: int | None = 600
        self.has_master = True
        self.refusals: dict[str, HintedError] = {}
        self.asked: list[tuple[str, tuple[Value, ...]]] = []
        self.codes: set[str] = set()
        self.prepared: dict[bytes, tuple[str, list[Value]]] = {}
        self.outcomes: dict[bytes, ApprovalOutcome] = {}
        nodes = {name: self.site.enroll(name) for name in ("/robot", "/doctor", "/heating", "/map")}
        self.nodes = [
            NodeView(name, each.thumbprint, self.now - DAY, self.now + 30 * DAY, False, 0, "")
            for name, each in nodes.items()
        ]
        self.grants = [
            self.grant(nodes["/robot"], Permission("/robot/**", Right.PUBLISH)),
            self.grant(nodes["/doctor"], Permission("/robot/pose", Right.SUBSCRIBE)),
            self.grant(nodes["/heating"], Permission("/robot/pose", Right.SUBSCRIBE, COARSE), "rule 3"),
        ]
        self._wait(nodes["/map"].thumbprint)
        self._look()

    def _wait(self, key: bytes) -> None:
        """What waits for an answer."""
        self.requests = [
            IdentityRequestView(
                b"\1" * 32,
                "/lamp",
                b"\2" * 32,
                "code",
                self.now,
                self.now + DAY,
                "pending",
                False,
                False,
                build_request(KeySigner(generate()), "home", "/lamp"),
            )
        ]
        permission = Permission("/robot/pose", Right.SUBSCRIBE)
        self.rights = (
            AskedRight(
                int(Right.SUBSCRIBE),
                "/robot/pose",
                "geometry_msgs/PoseStamped",
                "rule 4",
                "rooms are warm where people are",
                scope_of([permission]),
            ),
        )
        self.questions = [
            GrantQuestion(
                b"\3" * 16,
                "/map",
                key,
                "to draw <b>where</b> it was",
                self.now,
                self.now + 600,
                7 * DAY,
                ("coarse", "room"),
                self.rights,
                b"\3" * 16,
            )
        ]
        self.invitations = [
            InvitationView(b"\4" * 8, "/lamp/*", 5, ("/lamp/1",), False, self.now + DAY, self.now, "open")
        ]

    def _look(self) -> None:
        """What was, and what can be seen."""
        self.phones = [PhoneView(b"\5" * 32, "Anna's phone", self.now - DAY, self.now, "", "")]
        self.proposals = [Proposal(b"\6" * 16, "Ben's phone", "123456", self.now + 300)]
        self.approvals = [
            ApprovalView(
                b"\7" * 16,
                2,
                "the doctor may see where the robot is",
                "Anna's phone",
                self.now,
                "done",
                "signed",
            )
        ]
        self.events = [
            EventView(number, self.now - 60 * (40 - number), "grant", "/doctor", f"{number:02x}")
            for number in range(1, 40)
        ]
        self.denials = [DenialView(self.now - 60, "/heating", int(Right.SUBSCRIBE), "/robot/scan")]
        self.graph = [
            FactView("publisher", "/robot/pose", "/robot"),
            FactView("subscriber", "/robot/pose", "/doctor"),
            FactView("subscriber", "/robot/pose", "/heating"),
        ]
        gives = (PolicyRight("/map", int(Right.SUBSCRIBE), "/robot/pose", "", "7d"),)
        self.policy = PolicyView("/home/anna/ca/policy.yaml", b"\x08" * 32, gives, (), 3, ())
        self.trust_status = ListProgress(1, 4, True, True, 3, 3)
        self.names: list[PolicyName] = []
        self.answers: dict[bytes, list[QuestionAnswer]] = {}

    def grant(self, to: EnrolledNode, permission: Permission, rules: str = "") -> GrantView:
        """A real grant, recorded."""
        draft = Draft(
            domain="home",
            subject=to.name,
            holder=to.thumbprint,
            not_before=self.now,
            expires=self.now + 7 * DAY,
            cap=self.now + 30 * DAY,
            serial=secrets.token_bytes(16),
            permissions=(permission,),
        )
        data = sign(self.site.signer, draft)
        end = peek(data)
        return GrantView(grant_id(data), to.name, data, self.now, end.expires, end.cap, 0, "", rules, "held")

    def handlers(self) -> Mapping[str, Callable[..., Value]]:
        """By the names of the operations."""
        return {name: self._handler(name) for name in messages.OPERATIONS}

    def _handler(self, name: str) -> Callable[..., Value]:
        lists = {"identity-requests": "requests", "policy-names": "names", "trust-status": "trust_status"}
        made: Callable[..., Any] | None = getattr(self, f"_do_{name.replace('-', '_')}", None)

        def handle(*arguments: Value) -> Value:
            self.asked.append((name, arguments))
            if name in self.refusals:
                raise self.refusals[name]
            found = made(*arguments) if made else getattr(self, lists.get(name, name.replace("-", "_")))
            return to_value(tuple(found) if isinstance(found, list) else found)

        return handle

    def _do_status(self) -> Status:
        print_ = "00c3 1f0e 7b21 9d44 5a5a 1020 77aa 0f0f"
        return Status(
            "home",
            print_,
            self.remaining is None,
            self.remaining,
            self.number,
            int(time.time()),
            len([phone for phone in self.phones if not phone.ended]),
            self.has_master,
        )

    def _do_consider(self, question: bytes, coarse: str, _: int) -> tuple[AskedRight, ...]:
        self._one(self.questions, question)
        if not coarse:
            return self.rights
        scope = scope_of([Permission("/robot/pose", Right.SUBSCRIBE, COARSE)])
        return tuple(right._replace(permissions=scope) for right in self.rights)

    def _do_approvals(self, count: int) -> list[ApprovalView]:
        return self.approvals[:count]

    def _do_events(self, before: int, count: int) -> list[EventView]:
        found = [each for each in self.events if not before or each.number < before]
        return found[::-1][:count]

    def _do_deny_request(self, number: bytes, _: str) -> None:
        self._drop(self.requests, number)

    def _do_deny_question(self, number: bytes, reason: str) -> None:
        question = self.questions[self._one(self.questions, number)]
        self._drop(self.questions, number)
        (right,) = question.rights
        given = question.node, right.right, right.pattern, "denied", reason, self.now
        self.answers[number] = [QuestionAnswer(*given)]

    def _do_question_answers(self, number: bytes) -> list[QuestionAnswer]:
        return self.answers.get(number, [])

    def _do_revoke_grant(self, number: bytes, reason: str) -> tuple[int, int]:
        place = self._one(self.grants, number)
        self.grants[place] = self.grants[place]._replace(revoked_at=self.now, reason=reason)
        return self._listed()

    def _do_revoke_node(self, name: str, reason: str) -> tuple[int, int]:
        for place, node in enumerate(self.nodes):
            if node.name == name:
                self.nodes[place] = node._replace(revoked_at=self.now, reason=reason)
                return self._listed()
        raise KeyServiceRefused(f"{name} has no valid identity to revoke")

    def _do_end_invitation(self, number: bytes, reason: str) -> None:
        place = self._one(self.invitations, number)
        self.invitations[place] = self.invitations[place]._replace(state=f"ended: {reason}")
        self.number += 1

    def _do_remove_phone(self, number: bytes, reason: str) -> None:
        place = self._one(self.phones, number)
        self.phones[place] = self.phones[place]._replace(ended=reason)
        self.number += 1

    def _do_end_proposal(self, number: bytes) -> None:
        self._drop(self.proposals, number)

    def _do_prepare(self, kind: str, arguments: list[Value], _owner: str = "") -> Prepared:
        number = secrets.token_bytes(16)
        statement = encode(["rossec-approval-v1", kind, number, arguments])
        self.prepared[number] = kind, arguments
        return Prepared(
            number,
            statement,
            hashlib.sha256(statement).digest(),
            int(time.time()) + 300,
            "localhost",
            tuple(phone.id for phone in self.phones if not phone.ended),
            b"",
        )

    def _do_approve(self, number: bytes, *_: bytes) -> ApprovalOutcome:
        kind, arguments = self.prepared.pop(number, ("", []))
        if not kind:
            raise KeyServiceRefused("this was approved before, or its time is over", "try again")
        state = "waiting" if self.remaining is None else "done"
        data = {"enroll": b"-----BEGIN CERTIFICATE-----\n", "invitation": b"ROSSEC-JOIN:X"}
        outcome = ApprovalOutcome(number, state, kind, data.get(kind, b""))
        self.outcomes[number] = outcome
        code = _KINDS.index(kind) + 1 if kind in _KINDS else 9
        self.approvals.insert(0, ApprovalView(number, code, kind, "Anna's phone", self.now, state, ""))
        if kind == "grant" and isinstance(arguments[0], bytes):
            self._drop(self.questions, arguments[0])
        self.number += 1
        return outcome

    def _do_outcome(self, number: bytes) -> ApprovalOutcome:
        if number not in self.outcomes:
            raise KeyServiceRefused("there is no such approval")
        return self.outcomes[number]

    def _do_login_challenge(self, _: str) -> LoginChallenge:
        credentials = tuple(phone.id for phone in self.phones if not phone.ended)
        return self._challenge("localhost", credentials)

    def _do_login(self, _: bytes, credential: bytes, *__: bytes) -> str:
        return self.phones[self._one(self.phones, credential)].name

    def _do_redeem(self, code: str) -> None:
        if code not in self.codes:
            raise KeyServiceRefused("this code is not valid any more", "rossec console phone")
        self.codes.discard(code)

    def _do_new_passkey(self, _: str, rp_id: str) -> LoginChallenge:
        return self._challenge(rp_id, tuple(phone.id for phone in self.phones))

    def _do_add_passkey(self, _: bytes, code: str, name: str, *__: bytes) -> PhoneView:
        self._do_redeem(code)
        phone = PhoneView(secrets.token_bytes(32), name, self.now, 0, "", "")
        self.phones.append(phone)
        self.number += 1
        return phone

    def _do_propose_passkey(self, _: bytes, code: str, name: str, *__: bytes) -> Proposal:
        self._do_redeem(code)
        proposal = Proposal(secrets.token_bytes(16), name, "004217", int(time.time()) + 300)
        self.proposals.append(proposal)
        self.number += 1
        return proposal

    def _do_phone_link(self, _owner: str = "") -> str:
        return self.add_code()

    def add_code(self) -> str:
        """A code, as from the terminal."""
        code = secrets.token_urlsafe(16)
        self.codes.add(code)
        return code

    def _challenge(self, rp_id: str, credentials: tuple[bytes, ...]) -> LoginChallenge:
        until = int(time.time()) + 120
        return LoginChallenge(secrets.token_bytes(16), secrets.token_bytes(32), until, rp_id, credentials)

    def _listed(self) -> tuple[int, int]:
        self.number += 1
        return (0, 0) if self.remaining is None else (1, self.number)

    def _drop(self, items: list[Any], number: bytes) -> None:
        del items[self._one(items, number)]
        self.number += 1

    def _one(self, items: list[Any], number: bytes) -> int:
        for place, item in enumerate(items):
            if item.id == number:
                return place
        raise KeyServiceRefused("there is no such thing any more", "look again")


def as_part(home: FakeHome) -> SimpleNamespace:
    """The handlers as methods, as a part of the service has them."""
    return SimpleNamespace(**{name.replace("-", "_"): handler for name, handler in home.handlers().items()})


@contextlib.contextmanager
def fake_service(path: Path, home: FakeHome | None = None) -> Iterator[FakeHome]:
    """Serve `home` at the socket `path`, in a thread."""
    shown = home or FakeHome()
    service = ConsoleService(as_part(shown))
    rules = SocketRules(messages.read_request, messages.MAX_REQUEST)
    server = KeyServer(path, service.carry_out, rules=rules)
    started, loop, ended = threading.Event(), asyncio.new_event_loop(), asyncio.Event()

    async def main() -> None:
        await server.start()
        started.set()
        await ended.wait()
        await asyncio.sleep(0.05)  # see tests.support.keyservice
        await server.close()
        await service.close()
        await loop.shutdown_default_executor()

    thread = threading.Thread(target=lambda: loop.run_until_complete(main()))
    thread.start()
    try:
        assert started.wait(10)
        yield shown
    finally:
        loop.call_soon_threadsafe(ended.set)
        thread.join(10)
        loop.close()
