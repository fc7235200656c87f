"""Imports and gateways: what other masters of the domain serve, and the types of aliases."""

import pytest

from rossec.master.state.imports import Imports
from rossec.master.state.registry import PublishersChanged, Registry
from tests.rossec.master.state.test_imports import HOSPITAL, KITCHEN, OTHER, POSE, ROBOT, subscribe


@pytest.fixture
def registry() -> Registry:
    return Registry()


@pytest.fixture
def imports(registry: Registry) -> Imports:
    return Imports(registry)


def test_who_subscribes_an_alias_does_not_decide_its_type(registry: Registry, imports: Imports) -> None:
    subscribe(registry, "/remote/hospital/pose", OTHER)
    imports.apply(HOSPITAL, POSE, [])
    assert imports.publisher_uris("/remote/hospital/pose") == [ROBOT[2]]
    subscribe(registry, "/pose", OTHER)  # of a topic of the own domain it does
    imports.apply(KITCHEN, POSE, [])
    assert imports.publisher_uris("/pose") == []


def test_subscribers_of_an_alias_are_told_of_gateways_elsewhere(registry: Registry, imports: Imports) -> None:
    served = "/gateway/hospital/pose"
    facts = [("node", "/gateway", ROBOT[2]), ("publisher", served, "/gateway")]
    assert imports.apply(KITCHEN, facts, []) == []
    imports.drop("kitchen")
    subscribe(registry, "/remote/hospital/pose")
    told = PublishersChanged(served, (), (ROBOT[2],))
    assert imports.apply(KITCHEN, facts, []) == [told]
    imports.lose("kitchen")
    imports.expire("kitchen")
    assert imports.publisher_uris(served) == [ROBOT[2]]
    assert imports.drop("kitchen") == [PublishersChanged(served, (), ())]
