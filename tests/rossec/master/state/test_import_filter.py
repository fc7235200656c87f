"""What is taken from a foreign domain: by name and right, asked anew each time."""

import pytest

from grants.decision import Reach
from grants.model import Permission, Right
from rossec.master.state.imports import ImportFilter

POSE, FORWARDED_PORT = "/remote/hospital/rounds/pose", "/remote/hospital/door"


@pytest.fixture
def imported() -> ImportFilter:
    rules = {
        "hospital": Reach((Permission("/rounds/**", Right.SUBSCRIBE), Permission("/door", Right.CALL))),
        "clinic": Reach(()),
    }
    return ImportFilter(rules.get)


def test_a_right_counts_for_its_use(imported: ImportFilter) -> None:
    assert imported.gives(Right.SUBSCRIBE, POSE)
    assert not imported.gives(Right.CALL, POSE)
    assert imported.gives(Right.CALL, FORWARDED_PORT)
    assert not imported.gives(Right.SUBSCRIBE, FORWARDED_PORT)


def test_any_right_is_enough_to_be_seen(imported: ImportFilter) -> None:
    assert imported.shows(POSE)
    assert imported.shows(FORWARDED_PORT)
    assert not imported.shows("/remote/hospital/secret")
    assert not imported.shows("/remote/clinic/pose"), "nothing is taken from it"
    assert imported.shows("/remote/other/pose"), "there is no rule for it"


def test_a_node_is_seen_by_what_it_is_registered_for(imported: ImportFilter) -> None:
    assert imported.shows_node("/remote/hospital/robot", ["/remote/hospital/secret", POSE])
    assert not imported.shows_node("/remote/hospital/robot", ["/remote/hospital/secret"])
    assert imported.shows_node("/remote/hospital/rounds/robot", [])


def test_names_of_the_own_domain_have_no_rule(imported: ImportFilter) -> None:
    assert imported.gives(Right.SUBSCRIBE, "/rounds/pose")
    assert imported.shows("/remotely")
    assert not imported.shows("/remote/hospital"), "an alias that is none"
    assert ImportFilter().shows(POSE)
