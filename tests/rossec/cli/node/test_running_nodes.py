"""`rossec node list | info`: the nodes that run."""

import json
from collections.abc import Iterator

import pytest

from tests.rossec.cli.ros.talking import prepare, talk
from tests.support.background import command, serving
from tests.support.site import Site


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with serving(tmp_path_factory.mktemp("site"), "/talker", prepare, talk) as site:
        yield site


def said(site: Site, capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> str:
    capsys.readouterr()
    assert command(site, "node", *words) == code
    out, err = capsys.readouterr()
    assert "Traceback" not in err
    return out if code == 0 and out else err


def test_running_nodes_are_listed(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    assert said(site, capsys, "list", "--as", "/observer") == "/talker\n"
    assert said(site, capsys, "list", "--as", "/observer", "--json") == '["/talker"]\n'
    assert "rossec grant sign /eve --graph" in said(site, capsys, "list", "--as", "/eve")


def test_what_a_node_does(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    out = said(site, capsys, "info", "/talker", "--as", "/observer")
    assert out.startswith("Node [/talker] at http://127.0.0.1:")
    assert "\nPublications: \n * /chatter [std_msgs/String]\n * /words [words_msgs/Words]\n" in out
    assert out.endswith("\nSubscriptions: None\n\nServices: None\n\n")
    found = json.loads(said(site, capsys, "info", "/talker", "--as", "/listener", "--json"))
    assert found["publications"] == ["/chatter", "/words"]


def test_a_node_that_does_not_run(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    err = said(site, capsys, "info", "/nobody", "--as", "/observer", code=1)
    assert err.startswith("rossec: error: no running node /nobody that /observer may see\n")
    assert "rossec node list --as /observer" in err
