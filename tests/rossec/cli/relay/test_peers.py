"""`rossec relay descriptor | add | list | remove`."""

import json
import time
from pathlib import Path

import pytest

from ca.domains import ForeignDomain
from rossec.overlay.documents import Routers
from rossec.overlay.homes import RelayFiles
from tests.support.commands import Said, Shell, refused
from tests.support.masters import domain_list
from tests.support.site import DAY, Site

ROUTERS = Routers(("tcp/127.0.0.1:7447",), "home", "p" * 22)
OFFICE = {
    "rossec-relay-descriptor": 1,
    "domain": "office.example",
    "relay": "/relay",
    "inbox": "rossec/1/office/" + "a" * 32,
}


@pytest.fixture
def site(empty: Shell) -> Site:
    made = Site(empty.root)
    RelayFiles(made.enroll("/relay")).keep_account(ROUTERS.write())
    return made


def trust(site: Site, tmp_path: Path) -> None:
    """The relay's home has a list of domains with the office."""
    other = Site(tmp_path / "office", "office.example")
    until = int(time.time()) + DAY
    entry = ForeignDomain("office.example", "office", other.anchor.certificate, ("/**",), 60, until)
    path = site.enroll("/relay").path / "domains.cose"
    path.touch(0o600)
    path.write_bytes(domain_list(site, foreign=[entry]))


def take(shell: Shell, tmp_path: Path, label: str = "office", **changes: str) -> Said:
    file = tmp_path / "descriptor.json"
    file.write_text(json.dumps(OFFICE | changes))
    return shell("relay", "add", label, str(file))


def test_descriptors_are_exchanged(empty: Shell, site: Site, tmp_path: Path) -> None:
    trust(site, tmp_path)
    assert "no relay of another site" in empty("relay", "list").err
    said = empty("relay", "descriptor", "office")
    own = json.loads(said.out)
    assert (own["domain"], own["relay"]) == ("home", "/relay")
    assert own["inbox"].startswith("rossec/1/home/")
    assert "here, its descriptor: rossec relay add office FILE" in said.err
    assert empty("relay", "list").out.split() == ["office", "its", "descriptor", "is", "not", "here", "yet"]
    assert take(empty, tmp_path).out == "office is office:/relay\n"
    assert empty("relay", "list").out.split() == ["office", "office:/relay"]
    assert json.loads(empty("relay", "list", "--json").out) == {
        "label": "office",
        "domain": "office",
        "relay": "/relay",
    }
    assert json.loads(empty("relay", "descriptor", "office").out) == own  # the same again
    assert empty("relay", "remove", "office").out == "office is linked with no longer\n"
    assert json.loads(empty("relay", "descriptor", "office").out) != own


def test_each_peer_has_an_inbox_of_its_own(empty: Shell, site: Site) -> None:
    one, other = (json.loads(empty("relay", "descriptor", each).out) for each in ("a", "b"))
    assert one["inbox"] != other["inbox"]
    assert site.enroll("/relay").path.joinpath("overlay.json").stat().st_mode & 0o777 == 0o600


def test_the_descriptor_must_be_of_a_trusted_domain(empty: Shell, site: Site, tmp_path: Path) -> None:
    refused(take(empty, tmp_path), "of domain office.example, not trusted", "rossec domain accept")
    refused(empty("relay", "descriptor", "x", "--domain", "office"), "no trusted domain is called")
    trust(site, tmp_path)
    assert empty("relay", "descriptor", "x", "--domain", "office").code == 0
    assert empty("relay", "descriptor", "own", "--domain", "").code == 0
    refused(take(empty, tmp_path, "own"), "own is to be of the own one", "rossec relay remove own")
    assert take(empty, tmp_path, "x").code == 0
    refused(empty("relay", "descriptor", "x", "--domain", ""), "x is office:/relay already", "remove")
    refused(take(empty, tmp_path, "x", relay="/relay/attic"), "x is office:/relay already")
    refused(take(empty, tmp_path, "y", inbox="rossec/1/o/" + "b" * 32), "are one relay")


@pytest.mark.usefixtures("site")
def test_a_relay_of_the_own_domain(empty: Shell, tmp_path: Path) -> None:
    own = {"domain": "home", "relay": "/relay/attic"}
    assert take(empty, tmp_path, "attic", **own).out == "attic is /relay/attic\n"
    refused(take(empty, tmp_path, "self", **{**own, "relay": "/relay"}), "the relay of this host itself")


@pytest.mark.usefixtures("site")
def test_what_is_no_descriptor_or_no_peer(empty: Shell, tmp_path: Path) -> None:
    refused(take(empty, tmp_path, inbox="x"), "the descriptor names no relay, or no inbox")
    refused(take(empty, tmp_path, "a b", domain="home", relay="/relay/a"), "is not a label")
    refused(empty("relay", "descriptor", "a-b"), "is not a label")
    refused(empty("relay", "remove", "hall"), "there is no peer 'hall'", "there are: none")


def test_another_relay_of_this_host_by_its_name(empty: Shell, site: Site) -> None:
    refused(empty("relay", "--name", "/relay/attic", "descriptor", "x"), "has no ca.pem", "node request")
    refused(empty("relay", "--name", "/attic", "descriptor", "x"), "is not the name of a relay")
    RelayFiles(site.enroll("/relay/attic")).keep_account(ROUTERS.write())
    descriptor = json.loads(empty("relay", "--name", "/relay/attic", "descriptor", "x").out)
    assert descriptor["relay"] == "/relay/attic"
