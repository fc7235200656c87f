import json
import time
from pathlib import Path

import pytest

from ca.domains import ForeignDomain
from rossec.federation.settings import FILE, SiteFile
from tests.support.commands import Shell, refused
from tests.support.masters import domain_list
from tests.support.site import DAY, Site

URI = "http://kitchen:11311/"
KITCHEN = ("--as", "kitchen", "--name", "/master/kitchen")


@pytest.fixture
def site(empty: Shell) -> Site:
    made = Site(empty.root)
    made.enroll("/master")
    return made


@pytest.mark.usefixtures("site")
def test_a_site_is_added_listed_and_removed(empty: Shell) -> None:
    assert "no master is followed" in empty("federation", "list").err
    said = empty("federation", "add", URI, *KITCHEN)
    assert said.out == f"kitchen is followed: /master/kitchen at {URI}\n"
    assert empty("federation", "param", "kitchen", "/robot/**").code == 0
    assert empty("federation", "list").out.split() == ["kitchen", "/master/kitchen", URI, "/robot/**"]
    assert json.loads(empty("federation", "list", "--json").out) == {
        "label": "kitchen",
        "uri": URI,
        "master": "/master/kitchen",
        "domain": "",
        "parameters": ["/robot/**"],
        "via": "",
    }
    assert empty("federation", "param", "kitchen", "/robot/**", "--remove").code == 0
    assert "/robot" not in empty("federation", "list").out
    assert empty("federation", "remove", "kitchen").out == "kitchen is followed no longer\n"
    assert list(SiteFile(empty.node("/master")).sites()) == []


@pytest.mark.usefixtures("site")
def test_what_cannot_be_followed(empty: Shell) -> None:
    refused(empty("federation", "add", URI, "--as", "kitchen"), "/master is the master of this hos")
    refused(empty("federation", "add", "kitchen", *KITCHEN), "master's URI")
    refused(empty("federation", "add", URI, "--as", "a-b", *KITCHEN[2:]), "is not a label")
    assert empty("federation", "add", URI, *KITCHEN).code == 0
    refused(empty("federation", "add", URI, *KITCHEN), "there is a site kitchen already", "remove")
    twice = empty("federation", "add", URI, "--as", "cook", *KITCHEN[2:])
    refused(twice, "kitchen and cook are one master")
    refused(empty("federation", "remove", "hall"), "there is no site 'hall'", "there are: kitchen")
    refused(empty("federation", "param", "kitchen", "robot"), "robot")
    refused(empty("federation", "param", "kitchen", "/a", "--remove"), "is not mirrored")
    assert len(list(SiteFile(empty.node("/master")).sites())) == 1


def test_without_a_master_here(empty: Shell) -> None:
    refused(empty("federation", "add", URI, *KITCHEN), "there is no master", "enroll")


def test_a_damaged_file_is_named(empty: Shell, site: Site) -> None:
    path = site.enroll("/master").path / FILE
    path.touch(0o600)
    path.write_text("{}")
    refused(empty("federation", "list"), FILE, "rossec federation add")


def test_the_label_of_a_trusted_domain_means_a_master_of_it(empty: Shell, site: Site, tmp_path: Path) -> None:
    other = Site(tmp_path / "other", "hospital.example")
    entry = ForeignDomain(
        "hospital.example", "hospital", other.anchor.certificate, ("/**",), 3600, int(time.time()) + DAY
    )
    path = site.enroll("/master").path / "domains.cose"
    path.touch(0o600)
    path.write_bytes(domain_list(site, "/master", foreign=[entry]))
    said = empty("federation", "add", "http://h:11311", "--as", "hospital")
    assert said.out == "hospital is followed: hospital:/master at http://h:11311\n"
    [found] = SiteFile(empty.node("/master")).sites()
    assert found.domain == "hospital"


@pytest.mark.usefixtures("site")
def test_the_masters_own_name_is_not_followed(empty: Shell) -> None:
    said = empty("federation", "add", URI, "--as", "hospital")
    refused(said, "/master is the master of this host itself", "rossec domain accept")


@pytest.mark.usefixtures("site")
def test_a_site_behind_a_relay(empty: Shell) -> None:
    office = ("--via", "office", "--as", "office", "--name", "/master/office")
    said = empty("federation", "add", *office)
    assert said.out == "office is followed: /master/office via office\n"
    assert empty("federation", "list").out.split() == ["office", "/master/office", "via", "office"]
    assert json.loads(empty("federation", "list", "--json").out)["via"] == "office"
    again = empty("federation", "add", *office)
    refused(again, "there is a site office already: via office", "rossec federation remove office")
    assert empty("federation", "remove", "office").code == 0


@pytest.mark.usefixtures("site")
def test_a_site_has_a_uri_or_a_relay(empty: Shell) -> None:
    hint = "rossec federation add URI --as kitchen, or: add --via PEER --as kitchen"
    refused(empty("federation", "add", *KITCHEN), "at a URI or by a relay", hint)
    refused(empty("federation", "add", URI, "--via", "a", *KITCHEN), "at a URI or by a rel", hint)
    refused(empty("federation", "add", "--via", "a b", *KITCHEN), "'a b' is not a label")
