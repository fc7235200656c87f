"""Answers of a master, as ROS 1's tools read them."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from rossec.cli.completion import values
from rossec.cli.ros.graph import SystemState, addresses, note_hidden, read_state, system_state
from rossec.cli.shared.context import Environment
from rossec.errors import AnswerMalformed
from tests.rossec.cli.ros.talking import prepare, talk
from tests.support.background import serving
from tests.support.site import Site

STATE: list[object] = [[["/a", ["/n2", "/n1"]]], [["/a", ["/n3"]], ["/b", ["/n1"]]], [["/s", ["/n4"]]]]


async def state(system: object, types: object) -> SystemState:
    answers = {"getSystemState": system, "getTopicTypes": types}

    async def call(method: str, *_: object) -> object:
        return answers[method]

    return await read_state(call)


async def test_an_answer_is_read() -> None:
    found = await state(STATE, [["/a", "std_msgs/String"], ["/b", "*"]])
    assert found.topics == ["/a", "/b"]
    assert found.nodes == ["/n1", "/n2", "/n3", "/n4"]
    assert [found.type_of(topic) for topic in ("/a", "/b", "/c")] == [
        "std_msgs/String",
        "unknown type",
        "unknown type",
    ]


@pytest.mark.parametrize(
    ("system", "types"),
    [
        (None, []),
        ([[], []], []),
        ([[["/a"]], [], []], []),
        ([[["/a", "/n"]], [], []], []),
        ([[], [], []], None),
        ([[], [], []], [["/a"]]),
    ],
)
async def test_other_answers_are_refused(system: object, types: object) -> None:
    with pytest.raises(AnswerMalformed):
        await state(system, types)


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with serving(tmp_path_factory.mktemp("site"), "/talker", prepare, talk) as site:
        yield site


def test_the_state_as_a_node_may_see_it(served: Site, capsys: pytest.CaptureFixture[str]) -> None:
    environment = Environment(served.environ)
    seen = system_state(environment, "/listener")
    assert (seen.topics, seen.nodes) == (["/chatter", "/words"], ["/talker"])
    found = addresses(environment, "/observer", ["/talker", "/nobody"])
    assert list(found) == ["/talker"]
    assert system_state(environment, "/eve").topics == []
    note_hidden("/eve")
    assert capsys.readouterr().err.endswith("rossec grant sign /eve --graph\n")


def test_names_that_were_seen_complete_from_now_on(tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir(mode=0o700)
    found = SystemState({"/scan": ("/robot",)}, {}, {"/reset": ("/robot",)}, {"/scan": "a/B"})
    environment = Environment({"ROSSEC_HOME": str(home), "ROS_MASTER_URI": "http://x:1"})
    (found).keep_for_completion(environment)
    kinds = (values.TOPIC, values.SERVICE, values.NODE, values.TYPE)
    assert [values.read(home, "http://x:1", kind) for kind in kinds] == [
        ["/scan"],
        ["/reset"],
        ["/robot"],
        ["a/B"],
    ]
