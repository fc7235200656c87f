"""The console's pages over a service in memory, and a browser's requests to them."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from starlette.testclient import TestClient

from ca.encoding import Value
from rossec.authority.console.views import (
    ApprovalView,
    AskedRight,
    DenialView,
    EventView,
    FactView,
    GrantView,
    IdentityRequestView,
    InvitationView,
    LoginChallenge,
    NodeView,
    Outcome,
    PhoneView,
    PolicyView,
    Prepared,
    Proposal,
    Question,
    Standing,
    Status,
)
from rossec.console.app import create_app
from rossec.console.context import ConsoleContext
from rossec.console.pages.login import FIRST
from rossec.console.service import Position
from rossec.console.sessions import COOKIE, COOKIE_SIZE
from rossec.console.settings import Settings
from rossec.errors import KeyServiceRefused

NOW = 1_800_000_000
ORIGIN = "http://localhost:7411"
CODE = "right-code"
CHALLENGE = LoginChallenge(b"i" * 16, b"c" * 32, NOW + 300, "localhost", (b"passkey",))


@dataclass
class FakeService:
    """What `ConsoleClient` has, answered from lists; `calls` are those that change something."""

    shown: Status = Status("home", "ab12", False, 900, 1, NOW, 1, True)
    node_views: tuple[NodeView, ...] = ()
    grant_views: tuple[GrantView, ...] = ()
    request_views: tuple[IdentityRequestView, ...] = ()
    question_views: tuple[Question, ...] = ()
    considered: tuple[AskedRight, ...] = ()
    invitation_views: tuple[InvitationView, ...] = ()
    phone_views: tuple[PhoneView, ...] = (PhoneView(b"passkey", "my phone", NOW, 0, "", ""),)
    proposal_views: tuple[Proposal, ...] = ()
    approval_views: tuple[ApprovalView, ...] = ()
    event_views: tuple[EventView, ...] = ()
    denial_views: tuple[DenialView, ...] = ()
    facts: tuple[FactView, ...] = ()
    policy_view: PolicyView = PolicyView("policy.yaml", b"", (), (), 0, ())
    position: Position = (1, 2)
    reached: Standing = Standing(1, 2, True, True, 3, 3)
    prepared: Prepared = Prepared(
        b"i" * 16, b"statement", b"c" * 32, NOW + 300, "localhost", (b"passkey",), b""
    )
    outcome_view: Outcome = Outcome(b"i" * 16, "done", "", b"")
    calls: list[tuple[object, ...]] = field(default_factory=list)

    async def status(self) -> Status:
        return self.shown

    async def nodes(self) -> tuple[NodeView, ...]:
        return self.node_views

    async def grants(self) -> tuple[GrantView, ...]:
        return self.grant_views

    async def identity_requests(self) -> tuple[IdentityRequestView, ...]:
        return self.request_views

    async def questions(self) -> tuple[Question, ...]:
        return self.question_views

    async def consider(self, question: bytes, coarse: str, seconds: int) -> tuple[AskedRight, ...]:
        return self.considered

    async def invitations(self) -> tuple[InvitationView, ...]:
        return self.invitation_views

    async def phones(self) -> tuple[PhoneView, ...]:
        return self.phone_views

    async def proposals(self) -> tuple[Proposal, ...]:
        return self.proposal_views

    async def approvals(self, most: int) -> tuple[ApprovalView, ...]:
        return self.approval_views[:most]

    async def events(self, before: int, most: int) -> tuple[EventView, ...]:
        found = [event for event in self.event_views if not before or event.number < before]
        return tuple(found[:most])

    async def denials(self) -> tuple[DenialView, ...]:
        return self.denial_views

    async def graph(self) -> tuple[FactView, ...]:
        return self.facts

    async def policy(self) -> PolicyView:
        return self.policy_view

    async def standing(self, epoch: int, seq: int) -> Standing:
        return self.reached

    async def deny_request(self, request: bytes, reason: str) -> None:
        self.calls.append(("deny-request", request, reason))

    async def deny_question(self, question: bytes, reason: str) -> None:
        self.calls.append(("deny-question", question, reason))

    async def revoke_grant(self, grant: bytes, reason: str) -> Position:
        self.calls.append(("revoke-grant", grant, reason))
        return self.position

    async def revoke_node(self, name: str, reason: str) -> Position:
        self.calls.append(("revoke-node", name, reason))
        return self.position

    async def end_invitation(self, invitation: bytes, reason: str) -> None:
        self.calls.append(("end-invitation", invitation, reason))

    async def remove_phone(self, phone: bytes, reason: str) -> None:
        self.calls.append(("remove-phone", phone, reason))

    async def prepare(self, kind: str, arguments: Sequence[Value]) -> Prepared:
        self.calls.append(("prepare", kind, list(arguments)))
        return self.prepared

    async def approve(
        self,
        statement: bytes,
        credential: bytes,
        client_data: bytes,
        authenticator_data: bytes,
        signature: bytes,
    ) -> Outcome:
        self.calls.append(("approve", statement, credential))
        return self.outcome_view

    async def outcome(self, statement: bytes) -> Outcome:
        return self.outcome_view

    async def login_challenge(self, origin: str) -> LoginChallenge:
        self.calls.append(("login-challenge", origin))
        return CHALLENGE

    async def login(
        self,
        challenge: bytes,
        credential: bytes,
        client_data: bytes,
        authenticator_data: bytes,
        signature: bytes,
    ) -> str:
        if signature != b"right":
            raise KeyServiceRefused("this passkey is not known", "set up this phone")
        return "my phone"

    async def redeem(self, code: str) -> None:
        if code != CODE:
            raise KeyServiceRefused("the code is not known", "rossec console phone")

    async def new_passkey(self, origin: str, rp_id: str) -> LoginChallenge:
        self.calls.append(("new-passkey", origin, rp_id))
        return CHALLENGE

    async def add_passkey(
        self, challenge: bytes, code: str, name: str, client_data: bytes, attestation: bytes
    ) -> PhoneView:
        await self.redeem(code)
        self.calls.append(("add-passkey", challenge, name, client_data, attestation))
        return PhoneView(b"new", name, NOW, 0, "", "")

    async def propose_passkey(
        self, challenge: bytes, code: str, name: str, client_data: bytes, attestation: bytes
    ) -> Proposal:
        await self.redeem(code)
        self.calls.append(("propose-passkey", challenge, name))
        return Proposal(b"proposal", name, "123 456", NOW + 300)

    async def phone_link(self) -> str:
        self.calls.append(("phone-link",))
        return CODE


class Browser(TestClient):
    """Requests as a browser at the console's address sends them; raises what a page raises."""

    def __init__(
        self, service: FakeService | None = None, settings: Settings | None = None
    ) -> None:
        self.service = service or FakeService()
        self.context = ConsoleContext(
            self.service, settings or Settings("home", (ORIGIN,)), clock=lambda: NOW
        )
        super().__init__(create_app(self.context), ORIGIN, follow_redirects=False)
        self.headers["Origin"] = ORIGIN

    def log_in(self, phone: str = "my phone") -> "Browser":
        """Have a session, without the pages that begin one."""
        value = self.context.sessions.begin(b"s" * COOKIE_SIZE, phone, NOW)
        self.headers["Cookie"] = f"{COOKIE}={value}"
        return self


__all__ = ["CHALLENGE", "CODE", "FIRST", "NOW", "ORIGIN", "Browser", "FakeService"]
