"""The console's side: asks the authority's service over `console.sock`. A shell.

A few connections are kept, one request at a time on each. One that the service ended instead of
answering is made anew, once: services are restarted, and drop those that are idle. That is safe for
every operation of the table: a code, a challenge or a statement is used up by the first, and what
was taken away stays so. Whoever listens must be the own user, or the owner of the socket's
directory, which nobody else can write.
"""

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, nullcontext
from pathlib import Path
from typing import Final, NamedTuple

from ca.encoding import Value
from rossec.authority.console import messages
from rossec.authority.console.records import from_value, many
from rossec.authority.console.views import (
    ApprovalView,
    AskedRight,
    DenialView,
    EventView,
    FactView,
    GrantQuestion,
    GrantView,
    IdentityRequestView,
    InvitationView,
    ListStanding,
    LoginChallenge,
    NodeView,
    Outcome,
    PhoneView,
    PolicyName,
    PolicyView,
    Prepared,
    Proposal,
    QuestionAnswer,
    Status,
)
from rossec.authority.keyservice import messages as frames
from rossec.authority.keyservice.messages import Request
from rossec.errors import KeyMessageRefused, KeyServiceFailed, PeerUserRefused
from rossec.net.host.peeruid import require_user
from rossec.operation.unix_socket import raw_socket

CONNECTIONS: Final = 4
STRANGERS: Final = 1  # of them are used at a time for what anybody on the network may ask
OF_STRANGERS: Final = frozenset(
    {"login-challenge", "login", "redeem", "new-passkey", "add-passkey", "propose-passkey"}
)
TIMEOUT: Final = 60.0  # seconds for an answer: the master is called within 30
_HINT: Final = "see: rossec ca status; start it with: rossec ca serve"
_NEWER: Final = "are the service and the console of one version of rossec?"


class Assertion(NamedTuple):
    """What a browser returns for a challenge: `navigator.credentials.get`."""

    credential: bytes
    client_data: bytes
    authenticator_data: bytes
    signature: bytes


class Registration(NamedTuple):
    """A new passkey with the code that allows it: `navigator.credentials.create`."""

    challenge_id: bytes
    code: str
    name: str
    client_data: bytes
    attestation_object: bytes


class _Connection(NamedTuple):
    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter


class ConsoleClient:
    """The service whose console's socket is at `path`; connected when it is needed.

    Every method raises the service's refusal (`HintedError`), or `KeyServiceFailed` if it does not
    answer.
    """

    def __init__(self, path: Path, timeout: float = TIMEOUT) -> None:
        self._path = path
        self._timeout = timeout
        self._free: list[_Connection] = []
        self._places = asyncio.Semaphore(CONNECTIONS)
        self._strangers = asyncio.Semaphore(STRANGERS)

    async def close(self) -> None:
        """End the connections."""
        while self._free:
            self._free.pop().writer.transport.abort()
        await asyncio.sleep(0)

    async def ask(self, operation: str, *arguments: Value) -> Value:
        """Send a request, and return what its answer says."""
        data = frames.write_request(Request(operation, arguments))
        lane = self._strangers if operation in OF_STRANGERS else nullcontext()
        async with lane, self._places:
            try:
                async with asyncio.timeout(self._timeout):
                    try:
                        return await self._exchange(data)
                    except (ConnectionError, asyncio.IncompleteReadError):
                        await self.close()
                        return await self._exchange(data)
            except (FileNotFoundError, ConnectionRefusedError) as error:
                raise KeyServiceFailed("the authority's service does not run", _HINT) from error
            except (OSError, TimeoutError, asyncio.IncompleteReadError) as error:
                raise KeyServiceFailed("the authority's service does not answer", _HINT) from error

    async def status(self) -> Status:
        """The service itself; ask this often."""
        return from_value(Status, await self.ask("status"))

    async def nodes(self) -> tuple[NodeView, ...]:
        """The identities."""
        return many(NodeView, await self.ask("nodes"))

    async def grants(self) -> tuple[GrantView, ...]:
        """The grants in force, and those that ended within 30 days."""
        return many(GrantView, await self.ask("grants"))

    async def identity_requests(self) -> tuple[IdentityRequestView, ...]:
        """The requests for identities that wait."""
        return many(IdentityRequestView, await self.ask("identity-requests"))

    async def questions(self) -> tuple[GrantQuestion, ...]:
        """The requests for grants that wait for a person."""
        return many(GrantQuestion, await self.ask("questions"))

    async def consider(self, question: bytes, coarse: str, seconds: int) -> tuple[AskedRight, ...]:
        """What would be granted, through the filter `coarse`, for `seconds` (0: as asked)."""
        return many(AskedRight, await self.ask("consider", question, coarse, seconds))

    async def question_answers(self, question: bytes) -> tuple[QuestionAnswer, ...]:
        """How a question was answered; nothing while it waits."""
        return many(QuestionAnswer, await self.ask("question-answers", question))

    async def invitations(self) -> tuple[InvitationView, ...]:
        """The join codes."""
        return many(InvitationView, await self.ask("invitations"))

    async def phones(self) -> tuple[PhoneView, ...]:
        """The passkeys."""
        return many(PhoneView, await self.ask("phones"))

    async def proposals(self) -> tuple[Proposal, ...]:
        """The passkeys that wait to be approved."""
        return many(Proposal, await self.ask("proposals"))

    async def approvals(self, count: int) -> tuple[ApprovalView, ...]:
        """The newest approvals."""
        return many(ApprovalView, await self.ask("approvals", count))

    async def events(self, before: int, count: int) -> tuple[EventView, ...]:
        """Entries of the log before the number `before` (0: the newest), newest first."""
        return many(EventView, await self.ask("events", before, count))

    async def denials(self) -> tuple[DenialView, ...]:
        """What nodes were refused in the last day."""
        return many(DenialView, await self.ask("denials"))

    async def graph(self) -> tuple[FactView, ...]:
        """The graph as it is at the master."""
        return many(FactView, await self.ask("graph"))

    async def policy(self) -> PolicyView:
        """The policy file, compared with the grants in force."""
        return from_value(PolicyView, await self.ask("policy"))

    async def policy_names(self) -> tuple[PolicyName, ...]:
        """What the policy calls nodes and topics, and the types of these."""
        return many(PolicyName, await self.ask("policy-names"))

    async def standing(self, epoch: int, seq: int) -> ListStanding:
        """How far a revocation list has come."""
        return from_value(ListStanding, await self.ask("standing", epoch, seq))

    async def deny_request(self, request: bytes, reason: str) -> None:
        """Deny a request for an identity."""
        await self.ask("deny-request", request, reason)

    async def deny_question(self, question: bytes, reason: str) -> None:
        """Deny a request for grants."""
        await self.ask("deny-question", question, reason)

    async def revoke_grant(self, grant: bytes, reason: str) -> tuple[int, int]:
        """Revoke a grant; returns epoch and number of the list, zeros while the key is locked."""
        return _number(await self.ask("revoke-grant", grant, reason))

    async def revoke_node(self, name: str, reason: str) -> tuple[int, int]:
        """Revoke every key of a node; returns as `revoke_grant`."""
        return _number(await self.ask("revoke-node", name, reason))

    async def end_invitation(self, invitation: bytes, reason: str) -> None:
        """End a join code."""
        await self.ask("end-invitation", invitation, reason)

    async def remove_phone(self, phone: bytes, reason: str) -> None:
        """End a passkey: it approves nothing more."""
        await self.ask("remove-phone", phone, reason)

    async def end_proposal(self, proposal: bytes) -> None:
        """Refuse a phone that waits to be approved."""
        await self.ask("end-proposal", proposal)

    async def prepare(self, kind: str, *arguments: Value, owner: str = "") -> Prepared:
        """Have a statement made for `owner`, to be approved; the arguments are of `PREPARED`."""
        return from_value(Prepared, await self.ask("prepare", kind, [*arguments], owner))

    async def approve(self, statement: bytes, assertion: Assertion) -> Outcome:
        """Approve the statement with this id."""
        return from_value(Outcome, await self.ask("approve", statement, *assertion))

    async def outcome(self, approval: bytes) -> Outcome:
        """What came of an approval."""
        return from_value(Outcome, await self.ask("outcome", approval))

    async def login_challenge(self, origin: str) -> LoginChallenge:
        """A challenge for a passkey, at the page's origin."""
        return from_value(LoginChallenge, await self.ask("login-challenge", origin))

    async def login(self, challenge: bytes, assertion: Assertion) -> str:
        """Log in with a passkey; returns the phone's name."""
        return from_value(str, await self.ask("login", challenge, *assertion))

    async def redeem(self, code: str) -> None:
        """Use up a code from the terminal, to look."""
        await self.ask("redeem", code)

    async def new_passkey(self, origin: str, rp_id: str) -> LoginChallenge:
        """A challenge for a new passkey."""
        return from_value(LoginChallenge, await self.ask("new-passkey", origin, rp_id))

    async def add_passkey(self, registration: Registration) -> PhoneView:
        """Add a passkey with a code from the terminal."""
        return from_value(PhoneView, await self.ask("add-passkey", *registration))

    async def propose_passkey(self, registration: Registration) -> Proposal:
        """Propose a passkey, with a code of `phone_link`; a phone approves it."""
        return from_value(Proposal, await self.ask("propose-passkey", *registration))

    async def phone_link(self, owner: str = "") -> str:
        """A code for one proposal, made for `owner`."""
        return from_value(str, await self.ask("phone-link", owner))

    async def _exchange(self, data: bytes) -> Value:
        async with self._connection() as (reader, writer):
            writer.write(data)
            await writer.drain()
            head = await reader.readexactly(frames.HEAD)
            size = frames.frame_size(head, messages.MAX_ANSWER)
            body = await reader.readexactly(size)
        return frames.read_answer(body, messages.MAX_ANSWER)

    @asynccontextmanager
    async def _connection(self) -> AsyncIterator[_Connection]:
        """A free connection, or a new one; one that is left by an error or in the middle is cut."""
        connection = self._free.pop() if self._free else await _connect(self._path)
        try:
            yield connection
        except BaseException:
            connection.writer.transport.abort()
            raise
        self._free.append(connection)


async def _connect(path: Path) -> _Connection:
    """Connect.

    Raises:
        OSError: nobody listens.
        KeyServiceFailed: another user does.
    """
    allowed = {os.geteuid()}
    directory = path.parent.stat()
    if not directory.st_mode & 0o022:
        allowed.add(directory.st_uid)
    reader, writer = await asyncio.open_unix_connection(path)
    try:
        require_user(raw_socket(writer.get_extra_info("socket")), allowed)
    except PeerUserRefused as error:
        writer.transport.abort()
        raise KeyServiceFailed(
            f"another user listens at {path}", "find out who did that"
        ) from error
    return _Connection(reader, writer)


def _number(value: Value) -> tuple[int, int]:
    numbers = from_value(tuple[int, ...], value)
    if len(numbers) != 2:
        raise KeyMessageRefused("a list has an epoch and a number", _NEWER)
    return numbers[0], numbers[1]
