"""`rossec topic list | info | type | find` and `rossec node list | info` against a real master."""

import json
from collections.abc import Iterator

import pytest

from rossec.cli.ros.graph import absolute
from tests.rossec.cli.ros.talking import STRING, prepare, talk
from tests.support.background import command, serving
from tests.support.commands import Said, refused
from tests.support.site import Site


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with serving(tmp_path_factory.mktemp("site"), "/talker", prepare, talk) as site:
        yield site


class TopicCommand:
    """`rossec topic`, as one of the nodes."""

    def __init__(self, site: Site, capsys: pytest.CaptureFixture[str]) -> None:
        self.site, self.capsys = site, capsys

    def __call__(self, *words: str, node: str = "/listener") -> Said:
        self.capsys.readouterr()
        code = command(self.site, "topic", *words, "--as", node)
        return Said(code, *self.capsys.readouterr())


@pytest.fixture
def ask(site: Site, capsys: pytest.CaptureFixture[str]) -> TopicCommand:
    return TopicCommand(site, capsys)


def test_topics_are_listed_as_far_as_the_node_may_see_them(ask: TopicCommand) -> None:
    assert ask("list").out == "/chatter\n/words\n"
    assert ask("list", "/words").out == "/words\n"
    assert ask("list", "word").out == ""
    assert ask("list", "/chat").out == ""
    hidden = ask("list", node="/eve")
    assert (hidden.code, hidden.out) == (0, "")
    assert "all of it needs: rossec grant sign /eve --graph" in hidden.err


def test_a_list_with_types_and_numbers(ask: TopicCommand) -> None:
    assert ask("list", "-v").out == (
        "\nPublished topics:\n * /chatter [std_msgs/String] 1 publisher\n"
        " * /words [words_msgs/Words] 1 publisher\n\n\nSubscribed topics:\n\n"
    )
    assert ask("list", "-s").out == ""
    assert ask("list", "-p").out == "/chatter\n/words\n"
    assert json.loads(ask("list", "/chatter", "--json").out) == [
        {"topic": "/chatter", "type": STRING, "publishers": ["/talker"], "subscribers": []}
    ]


def test_one_topic(ask: TopicCommand) -> None:
    said = ask("info", "chatter").out
    assert said.startswith("Type: std_msgs/String\n\nPublishers: \n * /talker")
    assert said.endswith("\n\nSubscribers: None\n\n")
    assert json.loads(ask("info", "/chatter", "--json").out)["publishers"] == ["/talker"]
    assert ask("type", "/chatter").out == "std_msgs/String\n"
    assert ask("find", STRING).out == "/chatter\n"
    assert ask("find", "std_msgs/Bool").out == ""


def test_the_address_is_shown_to_who_may_look_it_up(ask: TopicCommand) -> None:
    assert "\n * /talker (http://127.0.0.1:" in ask("info", "/chatter", node="/observer").out


def test_a_topic_that_nobody_knows(ask: TopicCommand) -> None:
    for verb in ("info", "type"):
        refused(ask(verb, "/silent"), "no topic /silent that", "rossec topic list --as /listener")


def test_names_are_taken_from_the_root() -> None:
    assert absolute("chatter") == "/chatter"
    assert absolute("hospital:/robot/pose") == "/remote/hospital/robot/pose"
