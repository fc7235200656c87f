from pathlib import Path

import pytest

from ca.errors import PathRefused
from rossec.environment import own_gateway, own_home, own_master, own_relay, rossec_home
from rossec.errors import ConfigurationError


def test_rossec_home_and_its_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/user")
    assert rossec_home({}) == Path("/home/user/.local/share/rossec")
    assert rossec_home({"ROSSEC_HOME": "/srv/rossec"}) == Path("/srv/rossec")
    assert rossec_home({"ROSSEC_HOME": "~/keys"}) == Path("/home/user/keys")


@pytest.mark.parametrize("value", ["", ".", "keys"])
def test_home_is_absolute(value: str) -> None:
    with pytest.raises(ConfigurationError, match="ROSSEC_HOME is") as caught:
        rossec_home({"ROSSEC_HOME": value})
    assert "absolute path" in caught.value.hint


def test_an_unknown_home_directory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(text: Path) -> Path:
        raise RuntimeError(text)

    with pytest.raises(ConfigurationError, match=r"^~nobody-of-that-name is no home") as caught:
        rossec_home({"ROSSEC_HOME": "~nobody-of-that-name/rossec"})
    assert "absolute path" in caught.value.hint
    monkeypatch.setattr(Path, "expanduser", unknown)  # a user without an entry, and no HOME
    with pytest.raises(ConfigurationError, match=r"^~ is no home directory"):
        rossec_home({})


def test_a_home_that_others_can_write_in_is_refused(tmp_path: Path) -> None:
    environ = {"ROSSEC_HOME": str(tmp_path / "home")}
    assert own_home(environ) == tmp_path / "home"  # it need not exist yet
    (tmp_path / "home").mkdir(mode=0o700)
    assert own_home(environ) == tmp_path / "home"
    (tmp_path / "home").chmod(0o777)
    with pytest.raises(PathRefused):
        own_home(environ)


@pytest.mark.parametrize(
    ("variables", "name"),
    [
        ({}, "/master"),
        ({"ROSSEC_MASTER": ""}, "/master"),
        ({"ROSSEC_MASTER": "/master"}, "/master"),
        ({"ROSSEC_MASTER": "/master/kitchen"}, "/master/kitchen"),
    ],
)
def test_the_own_master_is_called_as_the_environment_says(variables: dict[str, str], name: str) -> None:
    assert own_master(variables) == name


@pytest.mark.parametrize(
    "name", ["master", "/robot", "/master/", "/master/a/b", "/masters", "/remote/hospital/master"]
)
def test_no_other_name_is_that_of_a_master(name: str) -> None:
    with pytest.raises(ConfigurationError, match="is not the name of a master"):
        own_master({"ROSSEC_MASTER": name})


@pytest.mark.parametrize(
    ("variables", "name"),
    [({}, "/relay"), ({"ROSSEC_RELAY": ""}, "/relay"), ({"ROSSEC_RELAY": "/relay/a"}, "/relay/a")],
)
def test_the_relay_of_this_host_is_called_as_the_environment_says(
    variables: dict[str, str], name: str
) -> None:
    assert own_relay(variables) == name


@pytest.mark.parametrize("name", ["/robot", "/relay/a/b", "relay", "/master"])
def test_what_is_not_the_name_of_a_relay(name: str) -> None:
    with pytest.raises(ConfigurationError, match="is not the name of a relay"):
        own_relay({"ROSSEC_RELAY": name})


@pytest.mark.parametrize(
    ("variables", "name"), [({}, "/gateway"), ({"ROSSEC_GATEWAY": "/gateway/attic"}, "/gateway/attic")]
)
def test_the_gateway_of_this_host_is_called_as_the_environment_says(
    variables: dict[str, str], name: str
) -> None:
    assert own_gateway(variables) == name


@pytest.mark.parametrize("name", ["/robot", "/gateway/a/b", "gateway", "/master"])
def test_what_is_not_the_name_of_a_gateway(name: str) -> None:
    with pytest.raises(ConfigurationError, match="is not the name of a gateway"):
        own_gateway({"ROSSEC_GATEWAY": name})
