"""Answering calls so that nobody waits long for another: in turns, and what waits does so apart.

A shell. Nearly every call is answered within the callback that brought it. A query over all there
is, and a multicall, may take many turns (`rossec.master.api.turns`); between two the loop answers
others, and the caller is asked for anew: what was found before a revocation does not count.
"""

import asyncio
from typing import NamedTuple

from ca.errors import HintedError
from rossec.master.api.dispatch import MasterApi
from rossec.master.api.methods import CallDenied
from rossec.master.api.multicall import MULTICALL, Multicall
from rossec.master.api.turns import CallOutcome, Turns, Work, advance
from rossec.master.api.watch_calls import WATCH, no_news
from rossec.master.rights.access_rules import Caller
from rossec.master.rights.interfaces import ChannelPeer
from rossec.master.server.dialer import SlaveDialer
from rossec.master.server.effects import Effects, MasterState
from rossec.master.server.graph_news import WATCH_WAIT
from rossec.master.state.registry import NodeRef
from rossec.ros.xmlrpc import Fault


class PendingCall(NamedTuple):
    """One call of `peer`; `near`: it comes from the master's own host."""

    near: bool
    method: str
    params: tuple[object, ...]
    peer: ChannelPeer


class CallAnswers:
    """Answers by one `MasterApi`, for the state it shares with `consequences`."""

    def __init__(
        self,
        api: MasterApi,
        state: MasterState,
        consequences: Effects,
        dialler: SlaveDialer,
        turns: Turns,
    ) -> None:
        self._api = api
        self._state = state
        self._consequences = consequences
        self._dialler = dialler
        self._turns = turns

    def dispatch(
        self, near: bool, method: str, params: tuple[object, ...], peer: ChannelPeer
    ) -> object:
        """The value to answer with, or what to await for it.

        Raises:
            Fault: the call is none, or the peer was revoked a moment ago.
        """
        call = PendingCall(near, method, params, peer)
        if method == MULTICALL:
            multicall = Multicall(params)
            self._step(call, multicall)
            return multicall.answer if multicall.done else self._multicall(call, multicall)
        begun = self._begin(call)
        if not isinstance(begun, CallOutcome):
            return self._query(call, begun)
        match begun.events:
            case [CallDenied(taken_by=NodeRef() as owner)] if owner not in self._dialler.doubted:
                return self._ask_who_is_there(owner, call)
        return self._consequences.follow(begun)

    def _query(self, call: PendingCall, work: Work) -> object:
        """Answer at once what takes no longer than a turn."""
        outcome = advance(work, self._turns.begin())
        if outcome is None:
            return self._in_turns(call, work)
        answer = self._consequences.follow(outcome)
        return self._watch(call) if self._is_without_news(call, answer) else answer

    async def _in_turns(self, call: PendingCall, work: Work) -> object:
        answer = await self._finished(call, work)
        return await self._watch(call) if self._is_without_news(call, answer) else answer

    async def _watch(self, call: PendingCall) -> object:
        await self._state.news.wait(WATCH_WAIT)
        return await self._finished(call, self._begin(call))

    async def _ask_who_is_there(self, owner: NodeRef, call: PendingCall) -> object:
        """A node says it is where `owner` was: if somebody else answers there, `owner` is gone."""
        await self._dialler.doubt(owner)
        return await self._finished(call, self._begin(call))

    async def _finished(self, call: PendingCall, work: CallOutcome | Work) -> object:
        number = self._state.standing.number
        while not isinstance(work, CallOutcome):
            await asyncio.sleep(0)  # others have their turn
            self._admit(call.peer)
            if number != self._state.standing.number:
                number, work = self._state.standing.number, self._begin(call)
            else:
                work = advance(work, self._turns.begin()) or work
        return self._consequences.follow(work)

    async def _multicall(self, call: PendingCall, multicall: Multicall) -> object:
        number = self._state.standing.number
        while not multicall.done:
            await asyncio.sleep(0)
            if number != self._state.standing.number:
                number = self._state.standing.number
                multicall.begin_again()
            self._step(call, multicall)
        return multicall.answer

    def _step(self, call: PendingCall, multicall: Multicall) -> None:
        caller, now = self._admit(call.peer)
        over = self._turns.begin()
        events = self._api.make(multicall, caller, now, near=call.near, over=over)
        self._consequences.follow(CallOutcome(None, events))

    def _begin(self, call: PendingCall) -> CallOutcome | Work:
        caller, now = self._admit(call.peer)
        return self._api.begin(call.method, call.params, caller, now, near=call.near)

    def _admit(self, peer: ChannelPeer) -> tuple[Caller, int]:
        """Who calls, with what it may do at this moment, and the time."""
        now = self._state.now()
        try:
            return self._state.standing.caller(peer, now), now
        except HintedError as error:  # revoked a moment ago: the connection is being cut
            raise Fault(1, f"rossec: {error}") from error

    @staticmethod
    def _is_without_news(call: PendingCall, answer: object) -> bool:
        return call.method == WATCH and no_news(answer)
