"""The names of other masters here, and back."""

import pytest

from ca.errors import NameRefused
from rossec.master.state.imported_facts import Site

KITCHEN, WARD = Site("kitchen"), Site("ward", "hospital")


def test_only_nodes_of_the_own_domain_have_aliases() -> None:
    assert KITCHEN.node("/robot") == "/remote/kitchen/robot"
    assert KITCHEN.key("/pose") == "/pose"
    assert (KITCHEN.namespace, WARD.namespace) == ("kitchen", "hospital")


def test_all_names_of_a_foreign_domain_lie_below_its_label() -> None:
    assert WARD.node("/robot") == "/remote/hospital/robot"
    assert WARD.key("/pose") == "/remote/hospital/pose"


@pytest.mark.parametrize("site", [KITCHEN, WARD])
def test_a_name_returns_to_its_origin(site: Site) -> None:
    assert site.origin(site.node("/robot")) == "/robot"
    assert site.origin(site.key("/pose")) == "/pose"


def test_a_name_of_another_origin_is_not_of_this_site() -> None:
    assert WARD.origin("/pose") is None
    assert WARD.origin("/remote/ward/pose") is None
    assert KITCHEN.origin("/remote/hospital/pose") is None
    assert KITCHEN.origin("/remote") is None


@pytest.mark.parametrize("site", [Site("9"), Site(""), Site("ok", "no/label")])
def test_a_site_has_valid_labels(site: Site) -> None:
    with pytest.raises(NameRefused):
        site.check()
    assert KITCHEN.check() is KITCHEN
