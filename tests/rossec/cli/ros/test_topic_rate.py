"""`rossec topic hz | bw` against a publisher of 20 messages a second."""

import re
from collections.abc import Iterator

import pytest

from tests.rossec.cli.ros.talking import prepare, talk
from tests.support.background import command, serving
from tests.support.site import Site


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with serving(tmp_path_factory.mktemp("site"), "/talker", prepare, talk) as site:
        yield site


@pytest.mark.parametrize(
    ("verb", "line"),
    [
        ("hz", r"average rate: [0-9]+\.[0-9]{3}\n\tmin: .*s max: .*s std dev: .*s window: [0-9]+"),
        ("bw", r"average: .*B/s\n\tmean: 9\.00B min: 9\.00B max: 9\.00B window: [0-9]+"),
    ],
)
def test_what_arrives_is_measured(
    site: Site, capsys: pytest.CaptureFixture[str], verb: str, line: str
) -> None:
    words = ("topic", verb, "/chatter", "--as", "/listener", "-n", "2", "-w", "50")
    assert command(site, *words) == 0
    out, err = capsys.readouterr()
    assert re.search(line, out), out
    assert err.startswith("rossec: subscribed to [/chatter]\n")


@pytest.mark.parametrize("verb", ["hz", "bw"])
def test_silence_is_said(site: Site, capsys: pytest.CaptureFixture[str], verb: str) -> None:
    assert command(site, "topic", verb, "/silent", "--as", "/listener", "-n", "3") == 0
    out, err = capsys.readouterr()
    assert out == "no new messages\n" * 3
    assert "nobody publishes /silent at this master; waiting" in err
