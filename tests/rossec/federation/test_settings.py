import json
from dataclasses import replace
from typing import Any

import pytest

from rossec.errors import ConfigurationError, RossecError
from rossec.federation.settings import (
    MAX_FILE,
    MAX_SITES,
    SiteSettings,
    checked_sites,
    read_sites,
    write_sites,
)
from rossec.master.state.imported_facts import Site

KITCHEN = SiteSettings("kitchen", "http://kitchen:11311/", "/master/kitchen")
OFFICE = SiteSettings("office", "", "/master/office", via="ward")
HOSPITAL = SiteSettings("hospital", "http://h:11311/", domain="hospital", parameters=("/robot/**",))


def test_what_is_written_is_read() -> None:
    sites = checked_sites([KITCHEN, HOSPITAL, OFFICE])
    assert read_sites(write_sites(sites), "f") == sites
    assert read_sites(write_sites({}), "f") == {}


def test_the_site_of_the_import_layer() -> None:
    assert KITCHEN.site == Site("kitchen", "")
    assert HOSPITAL.site == Site("hospital", "hospital")
    near = replace(KITCHEN, uri="http://127.0.0.1:11411/")
    assert near.site.on_this_host
    assert near.address == ("127.0.0.1", 11411)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"label": "a-b"}, "is not a label"),
        ({"domain": "/x"}, "is not a label"),
        ({"master": "/robot"}, "is not the name of a master"),
        ({"master": "/master/a/b"}, "is not the name of a master"),
        ({"uri": "kitchen"}, "master's URI"),
        ({"uri": "http://kitchen"}, "master's URI"),
        ({"via": "a b"}, "is not a label"),
        ({"via": "office"}, "a URI or a relay's peer, one of"),
        ({"uri": ""}, "a URI or a relay's peer, one of"),
        ({"parameters": ("robot",)}, "robot"),
        ({"parameters": ("/a",) * 65}, "at most 64"),
    ],
)
def test_what_is_not_in_form_is_refused(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(RossecError, match=message) as caught:
        replace(KITCHEN, **changed)
    assert caught.value.hint or message == "at most 64"


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (replace(KITCHEN, master="/master"), "two sites are called kitchen"),
        (replace(KITCHEN, label="cook"), "kitchen and cook are one master"),
        (replace(HOSPITAL, label="ward", domain="kitchen"), "label of a foreign domain"),
        (SiteSettings("h2", "http://h:1/", "/master/b", "kitchen"), "label of a foreign domain"),
    ],
)
def test_sites_that_contradict_each_other(other: SiteSettings, message: str) -> None:
    for pair in ([KITCHEN, other], [other, KITCHEN]):
        with pytest.raises(ConfigurationError, match=message.split(" and ", maxsplit=1)[0]):
            checked_sites(pair)


def test_two_masters_of_one_foreign_domain() -> None:
    other = SiteSettings("ward", "http://h2:11311/", "/master/ward", "hospital")
    assert set(checked_sites([HOSPITAL, other])) == {"hospital", "ward"}


def test_the_number_of_sites_is_bounded() -> None:
    many = [SiteSettings(f"s{i}", "http://h:1/", f"/master/s{i}") for i in range(MAX_SITES + 1)]
    with pytest.raises(ConfigurationError, match=f"at most {MAX_SITES}"):
        checked_sites(many)
    assert len(checked_sites(many[1:])) == MAX_SITES


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"{",
        b"[]",
        b"null",
        b'{"rossec-federation": 2, "sites": []}',
        b'{"rossec-federation": 1, "sites": [], "more": 1}',
        b'{"rossec-federation": 1}',
        b'{"rossec-federation": 1, "sites": [1]}',
        b"[" * 100_000,
        b" " * (MAX_FILE + 1),
        b"\xff",
    ],
    ids=lambda each: str(len(each)),
)
def test_another_file_is_refused(data: bytes) -> None:
    with pytest.raises(ConfigurationError, match=r"federation\.json"):
        read_sites(data, "federation.json")


@pytest.mark.parametrize(
    "changed", [{"uri": 5}, {"extra": 1}, {"parameters": [1]}, {"parameters": "/a"}], ids=str
)
def test_a_site_in_the_file_has_its_fields_and_no_others(changed: dict[str, Any]) -> None:
    whole = json.loads(write_sites({"kitchen": KITCHEN}))
    whole["sites"][0].update(changed)
    with pytest.raises(ConfigurationError, match="not in form"):
        read_sites(json.dumps(whole).encode(), "f")
    for key in whole["sites"][0]:
        less = json.loads(write_sites({"kitchen": KITCHEN}))
        less["sites"][0].pop(key, None)
        if key in less["sites"][0] or key == "extra":
            continue
        with pytest.raises(ConfigurationError, match="not in form"):
            read_sites(json.dumps(less).encode(), "f")


def test_a_site_behind_a_relay_has_forwarded_ports_that_may_be_on_this_host() -> None:
    assert OFFICE.site == Site("office", "", on_this_host=True)
    assert (OFFICE.place, KITCHEN.place) == ("via ward", "at http://kitchen:11311/")


def test_sites_without_a_relay_are_written_as_they_were_before_there_were_relays() -> None:
    rows = json.loads(write_sites(checked_sites([KITCHEN, OFFICE])))["sites"]
    assert [row.get("via") for row in rows] == [None, "ward"]
    assert [set(row) - {"via"} for row in rows] == [{"label", "uri", "master", "domain", "parameters"}] * 2


@pytest.mark.parametrize("wrong", [{"via": 7}, {"via": "ward", "more": 1}])
def test_a_way_that_is_not_in_form_is_refused(wrong: dict[str, object]) -> None:
    whole = json.loads(write_sites(checked_sites([OFFICE])))
    whole["sites"][0].update(wrong)
    with pytest.raises(ConfigurationError, match="a site that is not in form"):
        read_sites(json.dumps(whole).encode(), "f")
