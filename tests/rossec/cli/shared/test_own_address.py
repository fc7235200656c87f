import pytest

from rossec.cli.shared.context import Environment
from rossec.cli.shared.master import own_address
from rossec.host import addresses


def test_as_ros_is_configured(capsys: pytest.CaptureFixture[str]) -> None:
    assert own_address(Environment({"ROS_IP": "127.0.0.1"})) == "127.0.0.1"
    assert capsys.readouterr().err == ""
    assert own_address(Environment({"ROS_HOSTNAME": "robot.local"})) == "robot.local"


def test_an_address_of_another_host_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    """Robots would be sent there, and find nobody."""
    assert own_address(Environment({"ROS_IP": "192.0.2.7"})) == "192.0.2.7"
    assert "ROS_IP is 192.0.2.7, which is no address of this host" in capsys.readouterr().err


@pytest.mark.parametrize("others", [[], ["fd00::7"]])
def test_else_the_first_found_and_the_others_are_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], others: list[str]
) -> None:
    monkeypatch.setattr(addresses, "own_addresses", lambda: ["192.168.1.7", *others])
    assert own_address(Environment({})) == "192.168.1.7"
    said = capsys.readouterr().err
    assert said == ("rossec: other addresses of this host, for --address: fd00::7\n" if others else "")


def test_how_the_master_is_found_does_not_matter() -> None:
    assert own_address(Environment({"ROS_IP": "10.0.0.7", "ROS_MASTER_URI": "discover:"}))
