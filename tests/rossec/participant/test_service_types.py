import pytest

from rossec.errors import MessageError
from rossec.node import register_service_type, service_type
from rossec.participant.message_types import field_names
from rossec.participant.service_types import _STANDARD, part_type


def test_a_standard_type() -> None:
    kind = service_type("std_srvs/SetBool")
    assert kind.md5sum == "09fb03525b03e7ea1fd3992bafd87e16"  # as in genpy's class
    assert field_names(kind.request.create()) == ["data"]
    assert field_names(kind.response.create()) == ["success", "message"]


def test_a_part_without_fields() -> None:
    kind = service_type("std_srvs/Empty")
    assert kind.md5sum == "d41d8cd98f00b204e9800998ecf8427e"
    message = kind.request.create()
    assert field_names(message) == []
    assert bytes(kind.request.serialize(message)) == b""
    with pytest.raises(MessageError, match="no field"):
        kind.request.create(structure_needs_at_least_one_member=1)


def test_every_standard_type_is_registered() -> None:
    assert len(_STANDARD) == 14
    for name in _STANDARD:
        assert len(service_type(name).md5sum) == 32


@pytest.mark.ros
def test_md5sums_are_those_of_the_installed_packages() -> None:
    from importlib import import_module

    for name in _STANDARD:
        package, leaf = name.split("/")
        stock = getattr(import_module(f"{package}.srv"), leaf)
        assert service_type(name).md5sum == stock._md5sum, name


def test_a_registered_type() -> None:
    kind = register_service_type(
        "house_srvs/Dim", "# how bright\nuint8 LEVEL=3\nuint8 level\n---\nstd_msgs/Header header\n"
    )
    assert kind is service_type("house_srvs/Dim")
    assert kind.request.name == "house_srvs/DimRequest"
    assert kind.response_layout.type_name == "house_srvs/DimResponse"


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("house_srvs/None", "uint8 level", "0 lines '---'"),
        ("house_srvs/Two", "---\nuint8 level\n---", "2 lines '---'"),
        ("house_srvs/Odd", "this is :: none\n---", "cannot register house_srvs/OddRequest"),
        ("house_srvs/Part", "uint8 a\n---\nNobody b", "unknown type house_srvs/Nobody"),
        ("std_srvs/SetBool", "bool other\n---\n", "already present"),
        ("SetBool", "---", "not a message type name"),
    ],
)
def test_definitions_that_are_refused(name: str, text: str, why: str) -> None:
    with pytest.raises(MessageError, match=why):
        register_service_type(name, text)


def test_both_parts_of_a_definition_are_registered_or_none() -> None:
    with pytest.raises(MessageError):
        register_service_type("house_srvs/Half", "uint8 a\n---\nNobody b")
    assert register_service_type("house_srvs/Half", "uint16 a\n---\n").name == "house_srvs/Half"


def test_a_part_of_a_service_is_a_message_type() -> None:
    assert part_type("nav_msgs/GetPlanRequest").name == "nav_msgs/GetPlanRequest"
    assert part_type("tf2_msgs/FrameGraphResponse").name == "tf2_msgs/FrameGraphResponse"
    assert part_type("std_msgs/String").name == "std_msgs/String"
    with pytest.raises(MessageError, match="unknown message type"):
        part_type("std_srvs/NopeRequest")


def test_an_unknown_type_is_refused() -> None:
    with pytest.raises(MessageError, match="unknown service type 'std_srvs/Nope'") as caught:
        service_type("std_srvs/Nope")
    assert "register_service_type" in caught.value.hint
