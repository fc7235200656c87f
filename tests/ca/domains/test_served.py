import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.errors import NameRefused
from ca.names import (
    GATEWAY,
    alias_of,
    alias_of_served,
    is_alias,
    is_gateway,
    is_in_gateway,
    is_served,
    served_name,
)
from tests.ca.domains.test_aliases import LABELS, NAMES


@given(LABELS, NAMES)
def test_a_served_name_and_its_alias_are_made_of_each_other(label: str, name: str) -> None:
    if is_alias(name):
        return
    alias = alias_of(label, name)
    served = served_name(alias)
    assert served == f"/gateway/{label}{name}"
    assert alias_of_served(served) == alias
    assert is_served(served)
    assert is_in_gateway(served)
    assert not is_gateway(served)
    assert not is_alias(served)


@given(st.text(max_size=40) | NAMES | st.builds("/gateway{}".format, NAMES))
def test_what_is_a_served_name_has_exactly_one_alias(name: str) -> None:
    alias = alias_of_served(name)
    assert is_served(name) is (alias is not None)
    if alias is not None:
        assert served_name(alias) == name


@pytest.mark.parametrize(
    "name",
    [
        "",
        "/",
        "/pose",
        "/gateway",
        "/gateway/",
        "/gateway/hospital",
        "/gateway/hospital/",
        "/gateway//pose",
        "/gateway/9/pose",
        "/gateway/a-b/pose",
        "/gateways/hospital/pose",
        "/gateway_1/hospital/pose",
        "/remote/hospital/gateway/hospital/pose",
        "gateway/a/b",
        "/gateway/hospital/pose/",
        "/gateway/hospital/pose\n",
        f"/gateway/{'x' * 33}/pose",
        f"/gateway/hospital/{'a' * 250}",
    ],
)
def test_any_other_name_stands_for_no_alias(name: str) -> None:
    assert alias_of_served(name) is None
    assert not is_served(name)


@pytest.mark.parametrize(
    ("alias", "because"),
    [
        ("/pose", "a name of this domain"),
        ("/gateway/hospital/pose", "a name of this domain"),
        ("/remote", "names no origin"),
        ("/remote/hospital", "names no origin"),
        ("/remote/a-b/pose", "is not a label"),
        (f"/remote/hospital/{'a' * 238}", "at most 255"),  # the alias is 254 characters long
        ("/remote/hospital/remote/clinic/pose", "a name travels one hop"),
    ],
)
def test_only_an_alias_has_a_served_name(alias: str, because: str) -> None:
    with pytest.raises(NameRefused) as caught:
        served_name(alias)
    assert because in f"{caught.value} {caught.value.hint}"


def test_where_only_gateways_publish() -> None:
    assert GATEWAY == "/gateway"
    for name in ("/gateway/hospital", "/gateway/hospital/pose", f"/gateway/{'x' * 33}/pose"):
        assert is_in_gateway(name)
    for name in ("/gateway", "/gateways/a/b", "/gateway_1/a", "/remote/hospital/gateway/a/b"):
        assert not is_in_gateway(name)
