"""Answering calls so that none delays the others for long: in turns, or in a coroutine. A shell.

Nearly every call is answered within the callback that received it. A filtered query and a multicall
may take many turns (`rossec.master.api.methods`); between two of them the loop answers other calls,
and the caller's rights are evaluated again: results from before a revocation are discarded.
"""

import asyncio
from collections.abc import Awaitable
from functools import partial
from typing import Final, NamedTuple, cast

from ca.certificates import Identity
from ca.errors import HintedError
from rossec.master.api import graph_calls, statement_calls
from rossec.master.api.dispatch import MULTICALL, MasterApi, Multicall
from rossec.master.api.methods import CallDenied, CallOutcome, TurnClock, TurnExpired, Work, advance
from rossec.master.api.site_calls import FOLLOW, UNCHANGED, is_idle
from rossec.master.rights.caller import Caller
from rossec.master.server.effects import Effects, MasterState
from rossec.master.state.registry import NodeRef
from rossec.net.aio import SecureStream
from rossec.net.rpc import Dispatch, of_loop, source_of
from rossec.ros import names, xmlrpc


class Admission:
    """What a peer may use of the master before a grant gives it any right here."""

    # A certificate costs a foreign authority nothing, and a node without grants has few calls to make: its
    # bodies are small, and so is the number of its connections, of a foreign domain for all nodes without a
    # right together.
    def __init__(self, state: MasterState) -> None:
        self._state = state
        self._limits = state.limits

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
        of_group = [stream.peer for stream in self._state.streams.of_group(source_of(peer).group)]
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
        if method != names.PRESENT_GRANTS:
            return value

        async def presented() -> object:
            answer = await cast("Awaitable[object]", value) if isinstance(value, Awaitable) else value
            if self.has_rights(stream.peer):
                stream.raise_unit_limit()
            return answer

        return presented()


SITES_WAIT: Final = 1.0  # seconds; a name is wanted for a minute, so a slow site delays no more often
WATCH_WAIT: Final = 5.0  # seconds; an answer without changes shows that the master is alive
RENEWALS_WAIT: Final = 20.0  # likewise
# Facts of sites travel by need: these wait for those connected, or the first query would find nothing
ASKING: Final = frozenset(
    {"lookupService", "lookupNode", "getSystemState", "getPublishedTopics", "getTopicTypes"}
)


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
        self._polls = {
            statement_calls.WATCH_GRANTS: self._watch_grants,
            names.WATCH_RENEWALS: self._watch_renewals,
            names.RELAY_FORWARDED_PORTS: self._relay_forwarded_ports,
        }

    def dispatch(self, is_local: bool, method: str, params: tuple[object, ...], peer: Identity) -> object:
        call = PendingCall(is_local, method, params, peer)
        # 1. Calls that are many, and calls that wait.
        if method == MULTICALL:
            multicall = Multicall(params)
            self._step(call, multicall, self._first_turn())
            return multicall.answer if multicall.done else self._multicall(call, multicall)
        if method in self._polls:
            return self._polls[method](call)
        return self._call(call)

    def _call(self, call: PendingCall) -> object:
        # 2. Nearly every other call is answered here and now.
        method, imports = call.method, self._state.imports
        wanted = imports.demand.version
        begun = self._begin(call)
        if method in ASKING and imports.demand.version != wanted and not imports.is_settled:
            return self._after_sites(call)
        if isinstance(begun, CallOutcome):
            match begun.events:
                case [CallDenied(taken_by=NodeRef() as owner)] if owner not in self._effects.dialer.probed:
                    return self._probe_owner(owner, call)
            return self._effects.apply(begun)
        # 3. A filtered query takes turns; a watcher or follower that has seen all waits for a change.
        if method == FOLLOW:
            self._state.site_polls.wake((call.peer.thumbprint,))  # its last one: one waits for each follower
        outcome = advance(begun, self._first_turn())
        if outcome is None:
            return self._in_turns(call, begun)
        answer = self._effects.apply(outcome)
        return self._watch(call, self._expect_change(call)) if _is_unchanged(call, answer) else answer

    async def _after_sites(self, call: PendingCall) -> object:
        self._state.notify()
        if not self._state.imports.is_settled:
            await self._state.settled.wait(SITES_WAIT)
        return await self._answer(call)

    async def _in_turns(self, call: PendingCall, work: Work) -> object:
        answer = await self._finish(call, work)
        return await self._watch(call, self._expect_change(call)) if _is_unchanged(call, answer) else answer

    def _expect_change(self, call: PendingCall) -> asyncio.Event:
        if call.method == graph_calls.WATCH:
            return self._state.graph_changes.expect()
        return self._state.site_polls.expect(call.peer.thumbprint)

    async def _watch(self, call: PendingCall, expected: asyncio.Event) -> object:
        if call.method == FOLLOW:
            await self._state.site_polls.wait(WATCH_WAIT, call.peer.thumbprint, expected)
            answer = await self._answer(call)
            return [*UNCHANGED] if _is_unchanged(call, answer) else answer
        # Answer a change that the watcher sees: the moment of another would tell of it.
        changes, loop = self._state.graph_changes, asyncio.get_running_loop()
        end = loop.time() + WATCH_WAIT
        try:
            while True:
                await changes.wait(max(0.0, end - loop.time()), expected=expected)
                expected = changes.expect()
                answer = await self._answer(call)
                if loop.time() >= end or not _is_unchanged(call, answer):
                    return answer
        finally:  # also of a caller that was revoked meanwhile, or has gone
            changes.forget(expected)

    async def _watch_grants(self, call: PendingCall) -> object:
        match await self._answer(call):
            case [1, _, {"grants": []}]:
                await self._state.grant_changes.wait(self._state.grants_wait, call.peer.thumbprint)
                return await self._answer(call)
            case answer:
                return answer

    async def _watch_renewals(self, call: PendingCall) -> object:
        match await self._answer(call):
            case [1, _, {"renewals": []}] if call.params[1] == 0:  # a locked service waits by itself
                await self._state.renewal_changes.wait(RENEWALS_WAIT)
                return await self._answer(call)
            case answer:
                return answer

    async def _relay_forwarded_ports(self, call: PendingCall) -> object:
        polls, relay = self._state.relay_polls, call.peer.thumbprint
        polls.wake((relay,))
        answer = await self._answer(call)
        if polls.missed(relay) or not is_idle(answer):  # lists that came between two calls too
            return answer
        await polls.wait(WATCH_WAIT, relay)
        caller_id, instance, seen, _, ways = call.params
        # The forwarded ports it reported were taken over with the first answer.
        return await self._answer(call._replace(params=(caller_id, instance, seen, [], ways)))

    async def _probe_owner(self, owner: NodeRef, call: PendingCall) -> object:
        await self._effects.dialer.probe(owner)
        return await self._answer(call)

    async def _answer(self, call: PendingCall) -> object:
        return await self._finish(call, self._begin(call))

    async def _finish(self, call: PendingCall, work: CallOutcome | Work) -> object:
        number = self._state.trust.number
        while not isinstance(work, CallOutcome):
            await self._loop_turns.wait(source_of(call.peer))  # others are answered meanwhile
            self._caller_now(call.peer)
            # Results from before a revocation are discarded: the caller may see less now.
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
        self._effects.apply(CallOutcome(None, multicall.step(begin, turn)))

    def _begin(self, call: PendingCall) -> CallOutcome | Work:
        caller, now = self._caller_now(call.peer)
        return self._api.begin(call.method, call.params, caller, now, is_local=call.is_local)

    def _caller_now(self, peer: Identity) -> tuple[Caller, int]:
        now = self._state.now()
        try:
            return self._state.trust.caller(peer, now), now
        except HintedError as error:  # just revoked: the connection is being closed
            raise xmlrpc.Fault(1, f"rossec: {error}") from error


def _is_unchanged(call: PendingCall, answer: object) -> bool:
    return call.method in (graph_calls.WATCH, FOLLOW) and graph_calls.is_unchanged(answer, call.params[2])
