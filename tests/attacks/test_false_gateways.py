"""A subscriber of another domain's topic is told addresses of nodes that are no gateways of its own
domain, or of one that does not serve the topic: every form refuses them, and shows them nothing.

The subscriber holds the right twice, by a grant of each authority; the attackers hold all that
an authority could be brought to sign for them.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import pytest

from ca.encoding import decode
from grants.model import Right
from grants.token import peek
from rossec.participant.access import FIELD
from tests.support.aliasforms import Begin, forms
from tests.support.gateways import (
    ALIAS,
    HOSPITAL,
    ORIGIN,
    SERVED,
    FalsePublisher,
    Sites,
    answering,
    two_sites,
)
from tests.support.trust import share
from tests.support.witness import until

OTHER: Final = "/gateway/hospital/other"
CLINIC: Final = "/gateway/clinic/ward/word"


@dataclass(frozen=True)
class Case:
    """A false publisher, and why it is refused.

    Attributes:
        name: its name in its domain.
        foreign: it is a node of the hospital.
        answers: the topic in its answer.
        by_home, by_hospital: what these authorities signed for it, a right to publish.
        why: words of the refusal.
    """

    name: str
    answers: str
    why: str
    foreign: bool = False
    by_home: str = ""
    by_hospital: str = ""


NOT_OURS: Final = "not a grant of this authority"
ANOTHER_TOPIC: Final = "answers with another topic than"
CASES: Final = {
    "a foreign gateway": Case("/gateway", ORIGIN, NOT_OURS, foreign=True, by_home="/**"),
    "a foreign gateway that serves": Case(
        "/gateway", SERVED, ANOTHER_TOPIC, foreign=True, by_home="/**", by_hospital="/**"
    ),
    "a visitor": Case("/guest", ORIGIN, NOT_OURS, foreign=True, by_home="/**"),
    "almost a gateway": Case("/gatewayx", SERVED, ANOTHER_TOPIC, by_home="/**", by_hospital="/**"),
    "an own node": Case("/robot", ORIGIN, NOT_OURS, by_home="/**"),
    "an own node that serves": Case("/robot", SERVED, ANOTHER_TOPIC, by_home="/**"),
    "an own node that answers with the alias": Case("/robot", ALIAS, ANOTHER_TOPIC, by_home="/**"),
    "a gateway with another topic": Case("/gateway", OTHER, ANOTHER_TOPIC, by_home="/**"),
    "a gateway with another domain": Case("/gateway", CLINIC, ANOTHER_TOPIC, by_home="/**"),
    "a gateway with the origin's name": Case(
        "/gateway", ORIGIN, ANOTHER_TOPIC, by_home="/**", by_hospital="/**"
    ),
    "a gateway without a right": Case("/gateway", SERVED, NOT_OURS, by_hospital="/**"),
    "a gateway for another topic": Case("/gateway", SERVED, "no grant", by_home="/gateway/a/**"),
}


def false_publisher(sites: Sites, case: Case) -> FalsePublisher:
    """The attacker, with what was signed for it."""
    home, hospital = sites.home, sites.hospital
    place = hospital if case.foreign else home
    grants = []
    for authority, pattern in ((home, case.by_home), (hospital, case.by_hospital)):
        if pattern and authority is place:
            grants.append(authority.publish(case.name, pattern))
        elif pattern:
            grants.append(share(authority, place, case.name, Right.PUBLISH, pattern))
    own = place.enroll(case.name).credentials()
    return FalsePublisher(own, answering(case.name, case.answers, *grants))


def check_shown(publisher: FalsePublisher, case: Case) -> None:
    """It was asked by the one name that it could have, and shown the grants for that alone."""
    asked = SERVED if (case.name, case.foreign) == ("/gateway", False) else ORIGIN
    assert set(publisher.requested) == {asked}
    for fields in publisher.headers:
        assert fields["topic"] == asked.encode()
        shown: Any = decode(fields[FIELD], limit=1 << 16)
        domains = {peek(token).domain for token in shown}
        assert domains == {"home" if asked == SERVED else HOSPITAL}


@pytest.mark.attack("false-gateway")
@forms
async def test_whoever_is_no_gateway_of_the_topic_is_refused(begin: Begin, tmp_path: Path) -> None:
    names = {case.name for case in CASES.values() if not case.foreign}
    async with two_sites(tmp_path, *names) as sites, begin(sites, tmp_path) as form:
        for case in CASES.values():
            publisher = false_publisher(sites, case)
            async with publisher.listening() as uri:
                await sites.lead(form.uri, uri)
                await until(publisher.was_left)
                await until(partial(form.refused, case.why))
                await sites.lead(form.uri)
            check_shown(publisher, case)
        assert form.heard == []
