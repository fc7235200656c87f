"""Answering calls so that none delays the others for long: in turns, or in a coroutine. A shell.

Nearly every call is answered within the callback that received it. A filtered query and a multicall
may take many turns (`rossec.master.api.turns`); between two of them the loop answers other calls,
and the caller's rights are evaluated again: results from before a revocation are discarded.
"""

import asyncio
from functools import partial
from typing import Final, NamedTuple

from ca.certificates import Identity
from ca.errors import HintedError
from rossec.master.api.deposit_calls import WATCH_GRANTS, is_empty
from rossec.master.api.dispatch import MasterApi
from rossec.master.api.methods import CallDenied
from rossec.master.api.multicall import MULTICALL, Multicall
from rossec.master.api.relay_calls import is_idle
from rossec.master.api.renewal_calls import is_idle as has_no_renewal
from rossec.master.api.site_calls import FOLLOW, UNCHANGED
from rossec.master.api.turns import CallOutcome, TurnExpired, Turns, Work, advance
from rossec.master.api.watch_calls import WATCH, is_unchanged
from rossec.master.rights.caller import Caller
from rossec.master.server.effects import Effects, MasterState
from rossec.master.server.graph_changes import WATCH_WAIT
from rossec.master.server.site_answers import ASKING, SiteAnswers
from rossec.master.state.registry import NodeRef
from rossec.net.rpc.turns import of_loop, source_of
from rossec.ros.names import RELAY_DOORS, WATCH_RENEWALS
from rossec.ros.xmlrpc import Fault

RENEWALS_WAIT: Final = 20.0  # seconds; an answer without requests shows that the master is alive


class PendingCall(NamedTuple):
    """One call of `peer`; `is_local`: the peer is on the master's host."""

    is_local: bool
    method: str
    params: tuple[object, ...]
    peer: Identity


class CallAnswers:
    """Answers calls with a `MasterApi`, which shares its state with `effects`."""

    def __init__(
        self,
        api: MasterApi,
        state: MasterState,
        effects: Effects,
        turns: Turns,
    ) -> None:
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

    def dispatch(
        self, is_local: bool, method: str, params: tuple[object, ...], peer: Identity
    ) -> object:
        """The value to answer with, or an awaitable of it.

        Raises:
            Fault: there is no such method, or the peer has just been revoked.
        """
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
            case [CallDenied(taken_by=NodeRef() as owner)] if (
                owner not in self._effects.dialer.probed
            ):
                return self._probe_owner(owner, call)
        return self._effects.apply(begun)

    async def _after_sites(self, call: PendingCall) -> object:
        self._state.notify()
        await self._site_answers.wait()
        return await self._finish(call, self._begin(call))

    def _query(self, call: PendingCall, work: Work) -> object:
        """Answer at once if one turn is enough."""
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
        """For a change from now on: a coroutine begins later, and would miss what comes before."""
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
        """Answer a change that the watcher sees: the moment of another would tell of it."""
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
        """Probe `owner`, whose address another node registers, and answer again."""
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
        """A turn at once: a part of the one that all calls which arrive together have."""
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
        """The caller with its rights now, and the time."""
        now = self._state.now()
        try:
            return self._state.trust.caller(peer, now), now
        except HintedError as error:  # just revoked: the connection is being closed
            raise Fault(1, f"rossec: {error}") from error

    @staticmethod
    def _is_unchanged(call: PendingCall, answer: object) -> bool:
        return call.method in (WATCH, FOLLOW) and is_unchanged(answer, call.params[2])
