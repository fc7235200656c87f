import pytest

from rossec.cli.shared.context import Environment
from rossec.cli.shared.own_address import own_address
from rossec.enrollment import address


def test_as_ros_is_configured(capsys: pytest.CaptureFixture[str]) -> None:
    assert own_address(Environment({"ROS_IP": "10.0.0.7"})) == "10.0.0.7"
    assert own_address(Environment({"ROS_HOSTNAME": "robot.local"})) == "robot.local"
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("others", [[], ["fd00::7"]])
def test_else_the_first_found_and_the_others_are_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], others: list[str]
) -> None:
    monkeypatch.setattr(address, "own_addresses", lambda: ["192.168.1.7", *others])
    assert own_address(Environment({})) == "192.168.1.7"
    said = capsys.readouterr().err
    assert said == (
        "rossec: other addresses of this host, for --address: fd00::7\n" if others else ""
    )


def test_how_the_master_is_found_does_not_matter() -> None:
    assert own_address(Environment({"ROS_IP": "10.0.0.7", "ROS_MASTER_URI": "discover:"}))
