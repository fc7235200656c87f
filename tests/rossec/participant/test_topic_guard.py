"""The guard of a restricted right on a topic."""

from pathlib import Path
from typing import Any

import pytest

from grants.errors import GrantError
from grants.model import Restriction, Right, filter_rules
from rossec.errors import ConnectionHeaderRefused
from rossec.participant.authorized import memory_scope
from rossec.participant.definitions import Definition, guard_for
from tests.rossec.sidecar.agent_setup import AgentSetup
from tests.support.site import Site

WORD = Definition("std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1", "string data\n")
NOTHING = Definition("*", "*", "")


@pytest.fixture
def setup(tmp_path: Path) -> AgentSetup:
    return AgentSetup(Site(tmp_path / "site"))


def decision(setup: AgentSetup, restriction: Restriction | None) -> Any:
    setup.site.grant("/robot", Right.PUBLISH, "/word", restriction=restriction)
    access, now = setup.access("/robot"), setup.site.now()
    shown = access.present(Right.PUBLISH, "/word", now)
    return access.authorize(setup.identity("/robot"), shown, Right.PUBLISH, "/word", now)


def keyed(name: str) -> bytes:
    return name.encode().ljust(32, b".")


def test_a_right_without_restrictions_needs_no_guard(setup: AgentSetup) -> None:
    assert guard_for(NOTHING, decision(setup, None), keyed, memory_scope("/viewer")) is None


def test_a_guard_applies_conditions_and_filters(setup: AgentSetup) -> None:
    rules = filter_rules({"data": {"hash": {"key": "names", "length": 8}}})
    restriction = Restriction("std_msgs/String", ('msg.data != "no"',), rules)
    guard = guard_for(WORD, decision(setup, restriction), keyed, memory_scope("/viewer"))
    assert guard is not None
    assert guard(b"\x02\0\0\0no", setup.site.now()) is None
    filtered = guard(b"\x04\0\0\0anna", setup.site.now())
    assert filtered is not None
    assert len(b"".join(filtered)) == 12


def test_a_restriction_by_rate_or_time_needs_no_definition(setup: AgentSetup) -> None:
    restricted = decision(setup, Restriction(None, ("now.getHours() >= 0",), rate=1.0))
    guard = guard_for(NOTHING, restricted, keyed, memory_scope("/viewer"))
    assert guard is not None
    assert guard(b"anything", setup.site.now()) == [b"anything"]


def test_a_definition_of_another_type_or_md5sum_is_refused(setup: AgentSetup) -> None:
    restricted = decision(setup, Restriction("std_msgs/String", ("true",)))
    with pytest.raises(ConnectionHeaderRefused, match="does not have the md5sum"):
        guard_for(
            Definition(WORD.name, WORD.md5sum, "int32 data"), restricted, keyed, memory_scope("/viewer")
        )
    text = Definition("std_msgs/Text", WORD.md5sum, WORD.definition)
    with pytest.raises(GrantError, match="these are std_msgs/Text"):
        guard_for(text, restricted, keyed, memory_scope("/viewer"))
