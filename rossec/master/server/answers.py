"""Answering calls so that none delays the others for long: in turns, or in a coroutine. A shell.

Nearly every call is answered within the callback that received it. A filtered query and a multicall
may take many turns (`rossec.master.api.methods`); between two of them the loop answers other calls,
and the caller's rights are evaluated again: results from before a revocation are discarded.
"""

import asyncio
import contextlib
from collections.abc import Awaitable
from functools import partial
from typing import Final, NamedTuple, cast

from ca.certificates import Identity
from ca.errors import HintedError
from rossec.master.api.dispatch import MULTICALL, MasterApi, Multicall
from rossec.master.api.graph_calls import WATCH, is_unchanged
from rossec.master.api.methods import CallDenied, CallOutcome, TurnClock, TurnExpired, Work, advance
from rossec.master.api.site_calls import FOLLOW, UNCHANGED, is_idle
from rossec.master.api.statement_calls import WATCH_GRANTS, has_no_renewal, is_empty
from rossec.master.operation.config import MasterLimits
from rossec.master.rights.caller import Caller
from rossec.master.server.effects import Effects, MasterState
from rossec.master.server.updates import WATCH_WAIT
from rossec.master.state.imports import Imports
from rossec.master.state.registry import NodeRef
from rossec.net.aio import SecureStream
from rossec.net.rpc.calls import Dispatch
from rossec.net.rpc.time_slices import of_loop, source_of
from rossec.ros.names import PRESENT_GRANTS, RELAY_DOORS, WATCH_RENEWALS
from rossec.ros.xmlrpc import Fault


class Admission:
    """What a peer may use of the master before a grant gives it any right here.

    A certificate costs a foreign authority nothing, and a node without grants has few calls to
    make: its bodies are small, and so is the number of its connections, of a foreign domain for all
    nodes without a right together.
    """

    def __init__(self, state: MasterState, limits: MasterLimits) -> None:
        self._state = state
        self._limits = limits

    def has_rights(self, peer: Identity) -> bool:
        try:
            return self._state.trust.caller(peer, self._state.now()).has_rights
        except HintedError:
            return False

    def body_bound(self, peer: Identity) -> int:
        if self.has_rights(peer):
            return self._limits.body
        return min(self._limits.body, self._limits.body_without_right)

    def has_room_for(self, peer: Identity) -> bool:
        source = source_of(peer)
        peers = [stream.peer for stream in self._state.streams]
        of_group = [other for other in peers if source_of(other).group == source.group]
        if peer.is_foreign and len(of_group) >= self._limits.connections_per_domain:
            return False
        most = self._limits.connections_without_right
        if len(of_group) >= most and not self.has_rights(peer):
            keys = {each.thumbprint: each for each in of_group}
            shown = {key for key, each in keys.items() if self.has_rights(each)}
            if sum(each.thumbprint not in shown for each in of_group) >= most:
                return False
        of_key = sum(other.thumbprint == peer.thumbprint for other in of_group)
        return of_key < self._limits.connections_per_identity

    def dispatch_unshown(
        self,
        stream: SecureStream[Identity],
        dispatch: Dispatch[Identity],
        method: str,
        params: tuple[object, ...],
        peer: Identity,
    ) -> object:
        value = dispatch(method, params, peer)
        return self._presented(stream, value) if method == PRESENT_GRANTS else value

    async def _presented(self, stream: SecureStream[Identity], value: object) -> object:
        answer = await cast("Awaitable[object]", value) if isinstance(value, Awaitable) else value
        if self.has_rights(stream.peer):
            stream.raise_unit_limit()
        return answer


SITES_WAIT: Final = 1.0  # seconds
ASKING: Final = frozenset(
    {"lookupService", "lookupNode", "getSystemState", "getPublishedTopics", "getTopicTypes"}
)
"""The calls that wait; a subscriber is told of publishers later."""


class SiteAnswers:
    """A query for what was not wanted before waits until the other masters have answered.

    Facts travel by need, so the first query for a name would be answered with no although a site
    has it. It waits for the sites that are connected, and not long: a site that is slow delays
    nobody more than once in a minute, the time for which the name is wanted then.
    """

    def __init__(self, imports: Imports) -> None:
        self._imports = imports
        self._settled: asyncio.Event | None = None  # while a query waits
        imports.on_settled = self._wake

    async def wait(self, longest: float = SITES_WAIT) -> None:
        if self._imports.is_settled:
            return
        if self._settled is None:
            self._settled = asyncio.Event()
        settled = self._settled
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(longest):
                await settled.wait()

    def _wake(self) -> None:
        if self._settled is not None:
            self._settled.set()
            self._settled = None


RENEWALS_WAIT: Final = 20.0  # seconds; an answer without requests shows that the master is alive


class PendingCall(NamedTuple):
    is_local: bool
    method: str
    params: tuple[object, ...]
    peer: Identity


class CallAnswers:
    def __init__(self, api: MasterApi, state: MasterState, effects: Effects, turns: TurnClock) -> None:
        self._api = api
        self._state = state
        self._effects = effects
        self._turns = turns
        self._loop_turns = of_loop()
        self._site_answers = SiteAnswers(state.imports)
        self._polls = {
            WATCH_GRANTS: self._watch_grants,
            WATCH_RENEWALS: self._watch_renewals,
            RELAY_DOORS: self._relay_doors,
        }

    def dispatch(self, is_local: bool, method: str, params: tuple[object, ...], peer: Identity) -> object:
        call = PendingCall(is_local, method, params, peer)
        if method == MULTICALL:
            multicall = Multicall(params)
            self._step(call, multicall, self._first_turn())
            return multicall.answer if multicall.done else self._multicall(call, multicall)
        if method in self._polls:
            return self._polls[method](call)
        imports = self._state.imports
        wanted = imports.demand.version
        begun = self._begin(call)
        if method in ASKING and imports.demand.version != wanted and not imports.is_settled:
            return self._after_sites(call)
        if not isinstance(begun, CallOutcome):
            return self._query(call, begun)
        match begun.events:
            case [CallDenied(taken_by=NodeRef() as owner)] if owner not in self._effects.dialer.probed:
                return self._probe_owner(owner, call)
        return self._effects.apply(begun)

    async def _after_sites(self, call: PendingCall) -> object:
        self._state.notify()
        await self._site_answers.wait()
        return await self._finish(call, self._begin(call))

    def _query(self, call: PendingCall, work: Work) -> object:
        if call.method == FOLLOW:
            self._state.site_polls.supersede(call.peer.thumbprint)
        outcome = advance(work, self._first_turn())
        if outcome is None:
            return self._in_turns(call, work)
        answer = self._effects.apply(outcome)
        if self._is_unchanged(call, answer):
            return self._watch(call, self._expect_change(call))
        return answer

    async def _in_turns(self, call: PendingCall, work: Work) -> object:
        answer = await self._finish(call, work)
        if self._is_unchanged(call, answer):
            return await self._watch(call, self._expect_change(call))
        return answer

    def _expect_change(self, call: PendingCall) -> asyncio.Event:
        # For a change from now on: a coroutine begins later, and would miss what comes before.
        if call.method == WATCH:
            return self._state.graph_changes.expect()
        return self._state.site_polls.expect(call.peer.thumbprint)

    async def _watch(self, call: PendingCall, expected: asyncio.Event) -> object:
        if call.method == WATCH:
            return await self._watch_graph(call, expected)
        await self._state.site_polls.wait(call.peer.thumbprint, WATCH_WAIT, expected)
        answer = await self._finish(call, self._begin(call))
        if call.method == FOLLOW and self._is_unchanged(call, answer):
            return [*UNCHANGED]
        return answer

    async def _watch_graph(self, call: PendingCall, expected: asyncio.Event) -> object:
        # Answer a change that the watcher sees: the moment of another would tell of it.
        loop = asyncio.get_running_loop()
        end = loop.time() + WATCH_WAIT
        while True:
            await self._state.graph_changes.wait(max(0.0, end - loop.time()), expected)
            expected = self._expect_change(call)
            answer = await self._finish(call, self._begin(call))
            if loop.time() >= end or not self._is_unchanged(call, answer):
                return answer

    async def _watch_grants(self, call: PendingCall) -> object:
        answer = await self._finish(call, self._begin(call))
        if is_empty(answer):
            await self._state.grant_changes.wait(call.peer.thumbprint)
            answer = await self._finish(call, self._begin(call))
        return answer

    async def _watch_renewals(self, call: PendingCall) -> object:
        changes = self._state.renewal_changes
        answer = await self._finish(call, self._begin(call))
        if has_no_renewal(answer) and call.params[1] == 0:  # a locked service waits by itself
            await changes.wait(RENEWALS_WAIT)
            answer = await self._finish(call, self._begin(call))
        return answer

    async def _relay_doors(self, call: PendingCall) -> object:
        polls, relay = self._state.relay_polls, call.peer.thumbprint
        polls.supersede(relay)
        answer = await self._finish(call, self._begin(call))
        if polls.missed(relay) or not is_idle(answer):  # lists that came between two calls too
            return answer
        await polls.wait(relay, WATCH_WAIT)
        caller_id, instance, seen, _, ways = call.params
        again = call._replace(params=(caller_id, instance, seen, [], ways))  # doors are taken
        return await self._finish(again, self._begin(again))

    async def _probe_owner(self, owner: NodeRef, call: PendingCall) -> object:
        await self._effects.dialer.probe(owner)
        return await self._finish(call, self._begin(call))

    async def _finish(self, call: PendingCall, work: CallOutcome | Work) -> object:
        number = self._state.trust.number
        while not isinstance(work, CallOutcome):
            await self._loop_turns.wait(source_of(call.peer))  # others are answered meanwhile
            self._caller_now(call.peer)
            if number != self._state.trust.number:
                number, work = self._state.trust.number, self._begin(call)
            else:
                work = advance(work, self._turns.begin()) or work
        return self._effects.apply(work)

    async def _multicall(self, call: PendingCall, multicall: Multicall) -> object:
        number = self._state.trust.number
        while not multicall.done:
            await self._loop_turns.wait(source_of(call.peer))
            if number != self._state.trust.number:
                number = self._state.trust.number
                multicall.restart_element()
            self._step(call, multicall, self._turns.begin())
        return multicall.answer

    def _first_turn(self) -> TurnExpired:
        expired, all_expired = self._turns.begin(), self._loop_turns.first()
        return lambda: expired() or all_expired()

    def _step(self, call: PendingCall, multicall: Multicall, turn: TurnExpired) -> None:
        caller, now = self._caller_now(call.peer)
        begin = partial(self._api.begin, caller=caller, now=now, is_local=call.is_local)
        events = multicall.step(begin, turn)
        self._effects.apply(CallOutcome(None, events))

    def _begin(self, call: PendingCall) -> CallOutcome | Work:
        caller, now = self._caller_now(call.peer)
        return self._api.begin(call.method, call.params, caller, now, is_local=call.is_local)

    def _caller_now(self, peer: Identity) -> tuple[Caller, int]:
        now = self._state.now()
        try:
            return self._state.trust.caller(peer, now), now
        except HintedError as error:  # just revoked: the connection is being closed
            raise Fault(1, f"rossec: {error}") from error

    @staticmethod
    def _is_unchanged(call: PendingCall, answer: object) -> bool:
        return call.method in (WATCH, FOLLOW) and is_unchanged(answer, call.params[2])
