"""Every kind of statement as one line; what nodes wrote has no control characters there."""

import pytest

from ca.approvals.statement import Enroll, GrantStatement, StatementKind
from ca.encoding import encode
from grants.document import from_draft, peek
from rossec.authority.console.messages import sentence
from rossec.clock import format_time
from tests.support.approving import WHATS, state
from tests.support.consoleservice import FakeHome


@pytest.mark.parametrize("kind", sorted(StatementKind))
def test_a_sentence_for_every_kind(kind: StatementKind) -> None:
    text = sentence(state(WHATS[kind]), b"")
    assert text
    assert text.isprintable()
    assert len({sentence(state(what), b"") for what in WHATS.values()}) == len(WHATS)


def test_a_sentence_about_a_grant_names_its_node() -> None:
    grant = peek(FakeHome().grants[1].data)
    payload = encode([b"", [], [[encode(from_draft(grant, grant.issuer)), ""]]])
    asked = state(GrantStatement(b"r" * 16, b"d" * 32))
    assert sentence(asked, payload) == (f"/doctor may subscribe /robot/pose, until {format_time(grant.cap)}")
    for malformed in (b"", b"\xff", encode([]), encode([b"", [], [[b"x", ""]]])):
        assert sentence(asked, malformed) == "a right of a node"


def test_a_sentence_has_no_control_characters() -> None:
    what = Enroll(b"c" * 32, "/x\n\x1b[2J", b"k" * 32, wildcard=False, lifetime=9, replaces=False)
    assert sentence(state(what), b"").isprintable()
