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
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from ca.enrollment import qr, sides
from ca.enrollment.messages import EnrollmentOffer, read, write
from ca.enrollment.sides import AuthorityEnrollment, AuthorityState, NodeEnrollment, NodeState, Pending
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
    for states, section in ((NodeState, node), (AuthorityState, authority)):
        assert {state.name for state in states} == set(re.findall(r"\b[A-Z]{4,}\b", section)) - {
            "MUST",
            "SHOULD",
            "FALSE",
        }


class Enrollments(RuleBasedStateMachine):
    """One robot and one authority, enrolling again and again over one hostile network."""

    @initialize(label=st.booleans(), thief=st.booleans())
    def begin(self, label: bool, thief: bool) -> None:
        self.now = NOW
        self.label, self.thief = label, thief
        self.queues: dict[str, list[bytes]] = {"node": [], "authority": []}
        self.heard: dict[str, list[bytes]] = {"node": [], "authority": []}
        self.trusted: list[Pending] = []
        self.node = self.new_node()
        self.authority = self.new_authority()

    def new_node(self) -> NodeEnrollment:
        return ROBOT.enrollment(label=self.label, now=self.now)

    def new_authority(self) -> AuthorityEnrollment:
        self.offer = b""
        return AuthorityEnrollment(qr.parse(self.node.code(ADDRESS)), "home")

    def say(self, to: str, *messages: bytes) -> None:
        self.queues[to] += messages

    def deliver(self, to: str, message: bytes) -> None:
        self.heard[to].append(message)
        with suppress(CAError):
            if to == "node":
                self.say("authority", *self.node.receive(message, self.now))
            else:
                self.authority.receive(message, self.now)

    @rule(steps=st.sampled_from([1, 3, 9]), order=st.permutations(["node", "authority"]))
    def both_sides_do_their_part(self, steps: int, order: list[str]) -> None:
        """Up to where the person has the word."""
        for _ in range(steps):
            waiting = next((to for to in order if self.queues[to]), None)
            if waiting is not None:
                self.deliver(waiting, self.queues[waiting].pop(0))
            elif self.authority.state is AuthorityState.FETCHING:
                self.say("node", self.authority.fetch())
            elif self.authority.state is AuthorityState.COMPARED:
                self.approve_and_offer()

    def approve_and_offer(self) -> None:
        with suppress(CAError):
            self.authority.approve(self.now)
            self.offer = self.authority.offer([LEAF], HOME.root, fresh(), self.now)
            self.say("node", self.offer)

    @rule(who=st.sampled_from(["robot", "authority", "both"]))
    def somebody_starts_again(self, who: str) -> None:
        if who != "authority":
            self.node = self.new_node()
        if who != "robot":
            self.authority = self.new_authority()

    @rule(fresh_start=st.booleans())
    def mallory_offers(self, fresh_start: bool) -> None:
        """To the session that runs, or as the first to one that has just begun."""
        if fresh_start:
            self.node = self.new_node()
        nonce = fresh()
        agreed = sides.transcript(ROBOT.csr, [FORGED], MALLORY.root, nonce)
        secret = qr.parse(self.node.code(ADDRESS)).secret
        tag = sides.tag(secret, agreed) if secret and self.thief else b""
        self.deliver("node", write(EnrollmentOffer((FORGED,), MALLORY.root, nonce, tag)))

    @rule(to=st.sampled_from(["node", "authority"]), pick=PICK)
    def mallory_plays_back(self, to: str, pick: int) -> None:
        if self.heard[to]:
            self.deliver(to, self.heard[to][pick % len(self.heard[to])])

    @rule(to=st.sampled_from(["node", "authority"]), order=st.sampled_from(["drop", "turn"]))
    def the_network_is_bad(self, to: str, order: str) -> None:
        queue = self.queues[to]
        self.queues[to] = queue[1:] if order == "drop" else queue[::-1]
        if self.offer:  # the connection broke, so the authority calls again
            self.say("node", self.offer)

    @rule()
    def a_person_compares(self) -> None:
        if self.node.state is not NodeState.PENDING:
            return
        if self.authority.digits != self.node.pending.digits:
            return
        with suppress(CAError):
            self.trusted.append(self.node.confirm(self.authority.digits, self.now))
            self.say("authority", *self.node.activated())

    @rule(step=st.sampled_from([1, 10, 100, 301]))
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
    def who_says_enrolled_means_what_a_node_confirmed(self) -> None:
        if self.authority.state is AuthorityState.ENROLLED:
            offer = read(self.offer)
            assert isinstance(offer, EnrollmentOffer)
            agreed = sides.transcript(ROBOT.csr, offer.chain, offer.root, offer.nonce)
            assert agreed in {pending.transcript for pending in self.trusted}

    @invariant()
    def a_node_is_enrolled_only_by_its_person(self) -> None:
        if self.node.state is NodeState.ENROLLED:
            assert any(self.node.pending is pending for pending in self.trusted)


Enrollments.TestCase.settings = settings(max_examples=150, stateful_step_count=40)
TestEnrollments = Enrollments.TestCase
