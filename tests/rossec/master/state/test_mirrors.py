"""Parameters of other masters: read below their label, replaced as a whole, bounded."""

import pytest

from ca.errors import NameRefused
from rossec.errors import ImportRefused
from rossec.master.state.imported_facts import Site
from rossec.master.state.parameters import MirrorChange, Mirrors, refuse_mirror

KITCHEN, HOSPITAL = Site("kitchen"), Site("ward", "hospital")
TREE: dict[str, object] = {"robot": {"speed": 1.5, "name": "r"}}


@pytest.fixture
def mirrors() -> Mirrors:
    return Mirrors()


def test_parameters_are_below_the_label_of_their_origin(mirrors: Mirrors) -> None:
    mirrors.replace(KITCHEN, TREE)
    mirrors.replace(HOSPITAL, {"ward": 3})
    for key in ("/remote/kitchen/robot/speed", "/remote/kitchen/robot", "/remote/kitchen"):
        assert mirrors.item(key)[0] == key
    assert mirrors.item("/remote/kitchen/robot/speed")[1] == 1.5
    assert mirrors.item("/remote/kitchen/robot")[1] == TREE["robot"]
    assert mirrors.item("/remote/hospital/ward")[1] == 3
    assert dict(mirrors.items()) == {"/remote/kitchen": TREE, "/remote/hospital": {"ward": 3}}
    for key in ("/remote", "/remote/ward/ward", "/robot/speed", "/remote/kitchen/x", "/"):
        assert mirrors.item(key) == (key, None)


def test_only_what_has_changed_is_reported(mirrors: Mirrors) -> None:
    first = mirrors.replace(KITCHEN, TREE)
    assert first == [MirrorChange("/remote/kitchen/robot", TREE["robot"])]
    assert mirrors.replace(KITCHEN, TREE) == []
    changed = mirrors.replace(KITCHEN, {"robot": {"speed": 2.0}, "new": True})
    assert sorted(changed) == [
        MirrorChange("/remote/kitchen/new", value=True),
        MirrorChange("/remote/kitchen/robot/name", {}),
        MirrorChange("/remote/kitchen/robot/speed", 2.0),
    ]
    assert len(mirrors.drop("kitchen")) == 2
    assert mirrors.drop("kitchen") == []
    assert list(mirrors.items()) == []


def test_another_site_under_a_label_replaces_the_one_before(mirrors: Mirrors) -> None:
    mirrors.replace(KITCHEN, {"a": 1})
    changes = mirrors.replace(Site("kitchen", "hospital"), {"b": 2})
    assert changes == [MirrorChange("/remote/kitchen/a", {}), MirrorChange("/remote/hospital/b", 2)]


def test_two_sites_of_one_domain_share_a_namespace(mirrors: Mirrors) -> None:
    mirrors.replace(HOSPITAL, {"a": 1})
    mirrors.replace(Site("attic", "hospital"), {"b": 2})
    assert mirrors.item("/remote/hospital/a")[1] == 1
    assert mirrors.item("/remote/hospital/b")[1] == 2


@pytest.mark.parametrize("tree", [{"a/b": 1}, {"a b": 1}, {"a": None}, {"a": 1 << 40}, {"remote": {"x": 1}}])
def test_what_cannot_be_a_parameter_is_refused(mirrors: Mirrors, tree: dict[str, object]) -> None:
    mirrors.replace(KITCHEN, TREE)
    with pytest.raises(ImportRefused, match="kitchen"):
        mirrors.replace(KITCHEN, tree)
    assert mirrors.item("/remote/kitchen")[1] == TREE


def test_a_site_mirrors_a_bounded_size() -> None:
    mirrors = Mirrors(limit=1000)
    with pytest.raises(ImportRefused, match="more than 1000 bytes") as refusal:
        mirrors.replace(KITCHEN, {"a": "x" * 1000})
    assert "rossec federation param" in (refusal.value.hint or "")


@pytest.mark.parametrize(
    ("key", "value"),
    [("/remote", 1), ("/remote/kitchen/a", 1), ("/", {"remote": {}}), ("/remote/kitchen", None)],
)
def test_nothing_below_remote_is_set_here(key: str, value: object) -> None:
    with pytest.raises(NameRefused) as refusal:
        refuse_mirror(key, value)
    assert refusal.value.hint == "set it at its own master"


@pytest.mark.parametrize(("key", "value"), [("/", {"a": 1}), ("/remotes", 1), ("/a/remote", None)])
def test_everything_else_may_be_set(key: str, value: object) -> None:
    refuse_mirror(key, value)
