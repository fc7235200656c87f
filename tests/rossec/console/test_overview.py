"""What pages begin with."""

from typing import Any

import pytest
from starlette.requests import Request

from rossec.authority.console.messages import DenialView
from rossec.console import samples
from rossec.console.pages import visibility
from rossec.console.rendering import Visit
from rossec.console.samples import Recorded
from rossec.errors import HttpRefused, KeyServiceRefused
from tests.support.consolehome import NOW, POSE, as_service, crowd, demo, sees
from tests.support.consolepages import Browser


def visit(of: Browser) -> Visit:
    scope = {"type": "http", "path": "/", "query_string": b"", "headers": [], "state": {}}
    return Visit(Request(scope), of.context)


def browser(**context: Any) -> Browser:
    made = Browser(as_service(demo()), **context)
    made.now = NOW
    return made


async def test_it_has_the_matrix_of_the_grants_and_the_graph() -> None:
    home = await visibility.load(visit(browser()))
    assert home.matrix == demo().matrix
    assert not home.without_master
    assert [node.name for node in home.named("/robot")] == ["/robot"]
    assert home.named("/nobody") == []


async def test_without_a_master_there_are_the_grants() -> None:
    made = browser()
    made.home.refusals["graph"] = KeyServiceRefused("no master answers", "start it")
    made.home.refusals["denials"] = KeyServiceRefused("no master answers")
    home = await visibility.load(visit(made))
    assert home.without_master
    assert home.matrix.receivers == ("/doctor", "/heating")
    assert await visibility.denials(visit(made)) == ()


async def test_a_node_without_a_grant_is_ending_too_until_every_node_has_heard() -> None:
    home = demo()
    home.grants, home.nodes[0] = [], home.nodes[0]._replace(revoked_at=NOW - 9)
    home.nodes.append(home.nodes[0]._replace(name="/old", key=b"o" * 32, not_after=NOW))
    made = Browser(as_service(home))
    made.now = NOW
    made.home.trust_status = made.home.trust_status._replace(nodes_with_list=0)
    assert (await visibility.load(visit(made))).ending == {home.nodes[0].key.hex()}
    made.home.trust_status = made.home.trust_status._replace(nodes_with_list=3)
    assert (await visibility.load(visit(made))).ending == frozenset()
    made.home.refusals["trust-status"] = KeyServiceRefused("busy")
    home.nodes[1] = home.nodes[1]._replace(revoked_at=NOW)
    assert (await visibility.load(visit(made))).ending == {home.nodes[1].key.hex()}


async def test_a_refusal_of_the_rest_is_not_hidden() -> None:
    made = browser()
    made.home.refusals["grants"] = KeyServiceRefused("busy")
    with pytest.raises(KeyServiceRefused, match="busy"):
        await visibility.load(visit(made))


def test_refused_names_are_those_of_the_last_nodes() -> None:
    found = tuple(DenialView(NOW - at, f"/node{at % 20}", 2, f"/topic{at % 3}") for at in range(60))
    names = visibility.refused_names(found)
    assert list(names) == [f"/node{at}" for at in range(visibility.MAX_REFUSED)]
    assert names["/node0"] == ["/topic0", "/topic2", "/topic1"]


class _Preview:
    def recorded(self, topic: str) -> Recorded | None:
        if topic != "/robot/pose":
            return None
        made = samples.recorded(topic, POSE)
        return None if made is None else made._replace(is_made_up=False)


async def test_a_topic_is_compared_by_the_preview_or_made_up() -> None:
    made = browser(preview=_Preview())
    home = await visibility.load(visit(made))
    found = {row.topic: visibility.comparison(visit(made), row) for row in home.matrix.rows}
    pose, scan = found["/robot/pose"], found["/robot/scan"]
    assert pose is not None
    assert scan is not None
    assert (pose.is_made_up, scan.is_made_up) == (False, True)
    assert found["/robot/camera"] is None  # nobody sees it any more


def test_a_pattern_and_an_unknown_type_are_not_drawn() -> None:
    home = demo()
    home.node("/eye")
    home.grant("/eye", sees("/robot/**"), sees("/untyped"))
    given = visit(browser())
    for topic in ("/robot/**", "/untyped"):
        row = home.matrix.row(topic)
        assert row is not None
        assert visibility.comparison(given, row) is None


def test_a_name_in_a_path_is_a_name_or_a_pattern() -> None:
    assert visibility.name_of("robot/pose") == "/robot/pose"
    assert visibility.name_of("robot/**") == "/robot/**"
    for wrong in ("", "a b", "../x", "a//b", "<script>", "\u202e"):
        with pytest.raises(HttpRefused) as refused:
            visibility.name_of(wrong)
        assert refused.value.status == 404


def test_a_position_is_a_number() -> None:
    assert visibility.position(None) == visibility.position("") == 0
    assert visibility.position("24") == 24
    for wrong in ("-1", "x", "1" * 13, "٣"):
        with pytest.raises(HttpRefused):
            visibility.position(wrong)


def test_a_crowd_is_read() -> None:
    assert len(crowd().matrix.rows) == 40
