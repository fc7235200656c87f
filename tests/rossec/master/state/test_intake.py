"""What is taken from a foreign domain: by name and right, asked anew each time."""

import pytest

from grants.model import Permission, Right
from grants.reach import Reach
from rossec.master.state.intake import Intake

POSE, DOOR = "/remote/hospital/rounds/pose", "/remote/hospital/door"


@pytest.fixture
def intake() -> Intake:
    rules = {
        "hospital": Reach(
            (Permission("/rounds/**", Right.SUBSCRIBE), Permission("/door", Right.CALL))
        ),
        "clinic": Reach(()),
    }
    return Intake(rules.get)


def test_a_right_counts_for_its_use(intake: Intake) -> None:
    assert intake.gives(Right.SUBSCRIBE, POSE)
    assert not intake.gives(Right.CALL, POSE)
    assert intake.gives(Right.CALL, DOOR)
    assert not intake.gives(Right.SUBSCRIBE, DOOR)


def test_any_right_is_enough_to_be_seen(intake: Intake) -> None:
    assert intake.shows(POSE)
    assert intake.shows(DOOR)
    assert not intake.shows("/remote/hospital/secret")
    assert not intake.shows("/remote/clinic/pose"), "nothing is taken from it"
    assert intake.shows("/remote/other/pose"), "there is no rule for it"


def test_a_node_is_seen_by_what_it_is_registered_for(intake: Intake) -> None:
    assert intake.shows_node("/remote/hospital/robot", ["/remote/hospital/secret", POSE])
    assert not intake.shows_node("/remote/hospital/robot", ["/remote/hospital/secret"])
    assert intake.shows_node("/remote/hospital/rounds/robot", [])


def test_names_of_the_own_domain_have_no_rule(intake: Intake) -> None:
    assert intake.gives(Right.SUBSCRIBE, "/rounds/pose")
    assert intake.shows("/remotely")
    assert not intake.shows("/remote/hospital"), "an alias that is none"
    assert Intake().shows(POSE)
