"""A restricted right on a topic, from the header its publisher writes to the messages it sends."""

from pathlib import Path
from typing import Any

import pytest

from grants.errors import RestrictionMismatch
from grants.model import Restriction, Right, filter_rules
from rossec.errors import TopicRefused
from rossec.node.fields import Fields
from rossec.node.topicguard import guard_of
from tests.rossec.sidecar.playbook import Stage
from tests.support.site import Site

HEADER: Fields = {
    "type": b"std_msgs/String", "md5sum": b"992ce8a1687cec8c8bd883ec73ca41d1",
    "message_definition": b"string data\n",
}  # fmt: skip


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    return Stage(Site(tmp_path / "site"))


def decision(stage: Stage, restriction: Restriction | None) -> Any:
    stage.site.grant("/robot", Right.PUBLISH, "/word", restriction=restriction)
    access, now = stage.access("/robot"), stage.site.now()
    shown = access.present(Right.PUBLISH, "/word", now)
    return access.authorize(stage.identity("/robot"), shown, Right.PUBLISH, "/word", now)


def keyed(name: str) -> bytes:
    return name.encode().ljust(32, b".")


def test_without_restrictions_there_is_nothing_to_apply(stage: Stage) -> None:
    assert guard_of({}, decision(stage, None), keyed) is None


def test_conditions_and_filters(stage: Stage) -> None:
    rules = filter_rules({"data": {"hash": {"key": "names", "length": 8}}})
    restriction = Restriction("std_msgs/String", ('msg.data != "no"',), rules)
    guard = guard_of(HEADER, decision(stage, restriction), keyed)
    assert guard is not None
    assert guard(b"\x02\0\0\0no", stage.site.now()) is None
    treated = guard(b"\x04\0\0\0anna", stage.site.now())
    assert treated is not None
    assert len(b"".join(treated)) == 12


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"message_definition": b"int32 data\n"}, TopicRefused, "definition of std_msgs/String"),
        ({"message_definition": b"\xff"}, TopicRefused, "not UTF-8"),
        ({"type": b"std_msgs/Text"}, RestrictionMismatch, "these are std_msgs/Text"),
        ({"md5sum": b"*"}, TopicRefused, "does not have the md5sum"),
    ],
)
def test_what_cannot_be_told_is_refused(
    stage: Stage, change: Fields, error: type[Exception], message: str
) -> None:
    restricted = decision(stage, Restriction("std_msgs/String", ("true",)))
    with pytest.raises(error, match=message):
        guard_of(HEADER | change, restricted, keyed)
    with pytest.raises(TopicRefused):
        guard_of({}, restricted, keyed)
