"""What is told of a site."""

from rossec.federation.settings import SiteSettings
from rossec.federation.site_state import NAMED, SiteEvent, SiteState, site_status
from rossec.master.state.imports import Imports
from rossec.master.state.registry import Registry

OFFICE = SiteSettings("office", "", "/master/office", parameters=("/robot/**",), via="ward")


def followed() -> SiteState:
    state = SiteState()
    for event in (SiteEvent.DUE, SiteEvent.CONNECTED, SiteEvent.ANSWERED):
        state.take(event, 0.0)
    return state


def test_a_site_without_facts() -> None:
    assert site_status(OFFICE, SiteState(), Imports(Registry()), 5.0) == {
        "label": "office",
        "uri": "",
        "via": "ward",
        "master": "/master/office",
        "domain": "",
        "state": "idle",
        "facts": 0,
        "lost_s": None,
        "parameters": ["/robot/**"],
        "topics": [],
        "topics_count": 0,
    }


def test_topics_and_how_long_it_is_lost() -> None:
    imports, state = Imports(Registry()), followed()
    facts = [("publisher", "/b", "/n"), ("subscriber", "/a", "/n"), ("service", "/s", "/n")]
    imports.apply(OFFICE.site, facts, [])
    state.take(SiteEvent.FAILED, 2.0)
    found = site_status(OFFICE, state, imports, 5.04)
    assert (found["facts"], found["topics"], found["topics_count"]) == (3, ["/a", "/b"], 2)
    assert (found["state"], found["lost_s"]) == ("lost", 3.0)


def test_of_many_topics_the_first_are_named() -> None:
    imports = Imports(Registry())
    facts = [("publisher", f"/{'t' * 100}{number:04}", "/n") for number in range(200)]
    imports.apply(OFFICE.site, facts, [])
    found = site_status(OFFICE, followed(), imports, 0.0)
    assert found["topics_count"] == 200
    assert len(found["topics"]) == NAMED // 105
