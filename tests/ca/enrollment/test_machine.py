"""Both sides, a person who compares, and a network that belongs to somebody else.

The network keeps, repeats, reorders and drops messages, makes offers of its own authority (with the
stolen secret of the screen, when it has that), and time passes. Whatever happens: a node trusts
only the authority whose digits a person read, and when both sides say "enrolled" they mean the same
transcript.
"""

import re
from contextlib import suppress
from pathlib import Path

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from ca import qr
from ca.enrollment import transcript
from ca.enrollment.authority import AuthorityEnrollment
from ca.enrollment.authority import State as Ours
from ca.enrollment.messages import Offer, read, write
from ca.enrollment.node import NodeEnrollment, Pending, State
from ca.errors import CAError
from tests.support.enrolling import ADDRESS, Robot, fresh
from tests.support.pki import NOW, Site

HOME, MALLORY = Site.create(), Site.create()
ROBOT = Robot()
LEAF = HOME.authority.issue(ROBOT.csr, now=NOW, serial=1, lifetime=86400)
FORGED = MALLORY.authority.issue(ROBOT.csr, now=NOW, serial=1, lifetime=86400)
PICK = st.integers(0, 1 << 16)


def test_the_states_are_those_of_the_specification() -> None:
    text = (Path(__file__).parents[3] / "docs" / "spec" / "enrollment.md").read_text()
    node = text.partition("## 4.")[2].partition("## 5.")[0]
    authority = text.partition("## 5.")[2].partition("## 6.")[0]
    for states, section in ((State, node), (Ours, authority)):
        assert {state.name for state in states} == set(re.findall(r"\b[A-Z]{4,}\b", section)) - {
            "MUST", "SHOULD", "FALSE",
        }  # fmt: skip


class Enrollments(RuleBasedStateMachine):
    """One robot and one authority, enrolling again and again over one hostile network."""

    @initialize(label=st.booleans(), thief=st.booleans())
    def begin(self, label: bool, thief: bool) -> None:
        self.now = NOW
        self.label, self.thief = label, thief
        self.to_node: list[bytes] = []
        self.to_authority: list[bytes] = []
        self.trusted: list[Pending] = []
        self.node = self.new_node()
        self.authority = self.new_authority()

    def new_node(self) -> NodeEnrollment:
        return ROBOT.enrollment(label=self.label, now=self.now)

    def new_authority(self) -> AuthorityEnrollment:
        self.offer = b""
        return AuthorityEnrollment(qr.parse(self.node.code(ADDRESS)), "home")

    @rule(robot=st.booleans(), authority=st.booleans())
    def somebody_starts_again(self, robot: bool, authority: bool) -> None:
        if robot:
            self.node = self.new_node()
        if authority:
            self.authority = self.new_authority()

    @rule()
    def fetch(self) -> None:
        self.to_node.append(self.authority.fetch())

    @rule()
    @precondition(lambda self: self.authority.state is Ours.COMPARED)
    def approve_and_offer(self) -> None:
        try:
            self.authority.approve(self.now)
            self.offer = self.authority.offer([LEAF], HOME.root, fresh(), self.now)
        except CAError:
            return
        self.to_node.append(self.offer)

    @rule()
    @precondition(lambda self: self.offer)
    def offer_again(self) -> None:
        self.to_node.append(self.offer)

    @rule()
    def mallory_offers(self) -> None:
        nonce = fresh()
        agreed = transcript.transcript(ROBOT.csr, [FORGED], MALLORY.root, nonce)
        code = qr.parse(self.node.code(ADDRESS))
        tag = transcript.tag(code.secret, agreed) if code.secret and self.thief else b""
        self.to_node.append(write(Offer((FORGED,), MALLORY.root, nonce, tag)))

    @rule(pick=PICK, keep=st.booleans())
    @precondition(lambda self: self.to_node)
    def deliver_to_node(self, pick: int, keep: bool) -> None:
        place = pick % len(self.to_node)
        message = self.to_node[place] if keep else self.to_node.pop(place)
        with suppress(CAError):
            self.to_authority += self.node.receive(message, self.now)

    @rule(pick=PICK, keep=st.booleans())
    @precondition(lambda self: self.to_authority)
    def deliver_to_authority(self, pick: int, keep: bool) -> None:
        place = pick % len(self.to_authority)
        message = self.to_authority[place] if keep else self.to_authority.pop(place)
        with suppress(CAError):
            self.authority.receive(message, self.now)

    @rule(steps=st.integers(1, 12))
    def everybody_does_his_part(self, steps: int) -> None:
        for _ in range(steps):
            if self.to_node or self.to_authority:
                self.the_network_is_kind()
            elif self.authority.state is Ours.FETCHING:
                self.fetch()
            elif self.authority.state is Ours.COMPARED:
                self.approve_and_offer()
            elif self.node.state is State.PENDING and self.authority.digits:
                self.a_person_compares()

    def the_network_is_kind(self) -> None:
        for message in self.taken(self.to_authority):
            with suppress(CAError):
                self.authority.receive(message, self.now)
        for message in self.taken(self.to_node):
            with suppress(CAError):
                self.to_authority += self.node.receive(message, self.now)

    def taken(self, queue: list[bytes]) -> list[bytes]:
        waiting = [*queue]
        queue.clear()
        return waiting

    @rule()
    def drop(self) -> None:
        self.to_node, self.to_authority = self.to_node[1:], self.to_authority[1:]

    @rule()
    @precondition(lambda self: self.node.state is State.PENDING and self.authority.digits)
    def a_person_compares(self) -> None:
        if self.authority.digits != self.node.pending.digits:
            return
        try:
            self.trusted.append(self.node.confirm(self.authority.digits, self.now))
        except CAError:
            return
        self.to_authority += self.node.activated()

    @rule(step=st.sampled_from([1, 100, 301]))
    def time_passes(self, step: int) -> None:
        self.now += step
        self.node.tick(self.now)
        with suppress(CAError):
            self.authority.tick(self.now)

    @invariant()
    def only_the_compared_authority_is_trusted(self) -> None:
        for pending in self.trusted:
            assert pending.anchor.thumbprint == HOME.anchor.thumbprint

    @invariant()
    def both_mean_the_same(self) -> None:
        if self.authority.state is not Ours.ENROLLED:
            return
        said = {(pending.digits, pending.acknowledgement) for pending in self.trusted}
        assert self.authority.digits in {digits for digits, _ in said}
        if self.node.state is State.ENROLLED:
            assert any(self.node.pending is pending for pending in self.trusted)

    @invariant()
    def an_authority_is_finished_only_by_the_node_it_offered_to(self) -> None:
        if self.authority.state is Ours.ENROLLED:
            assert any(pending.transcript in self.offer_transcripts() for pending in self.trusted)

    def offer_transcripts(self) -> set[bytes]:
        offer = read(self.offer)
        assert isinstance(offer, Offer)
        return {transcript.transcript(ROBOT.csr, offer.chain, offer.root, offer.nonce)}


Enrollments.TestCase.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)
TestEnrollments = Enrollments.TestCase
