"""The three example policies, loaded and evaluated."""

from pathlib import Path

import pytest

from grants.filters.layout import parse
from grants.model import Right
from grants.policy.decision import Decider
from grants.policy.lint import lint
from grants.policy.model import DAY, HOUR, Effect
from grants.policy.read import load
from tests.grants.policy.policies import definition, node

FOLDER = Path(__file__).parents[3] / "examples" / "policies"
HEATING = bytes.fromhex("1f3a5c7e9b0d2f4a6c8e0b1d3f5a7c9e1b0d2f4a6c8e0b1d3f5a7c9e1b3d5f70")


def decider(name: str) -> Decider:
    text = (FOLDER / f"{name}.yaml").read_text()
    return Decider(load(text, definition, file=f"{name}.yaml"))


def test_there_are_three_examples() -> None:
    assert {path.stem for path in FOLDER.glob("*.yaml")} == {"home", "hospital", "visitor"}


def test_decisions_of_the_home_policy() -> None:
    home = decider("home")
    heating = node("/heating", HEATING)
    room = home.decide(heating, Right.SUBSCRIBE, "/robot/pose")
    assert room
    assert room.rate == 0.2
    assert {rule.path for item in room.restrictions for rule in item.filters} == {
        "pose.position", "pose.orientation", "header.stamp", "header.seq",
    }  # fmt: skip
    assert (room.lifetime, room.renew_until) == (7 * DAY, 180 * DAY)
    assert home.decide(heating, Right.PUBLISH, "/heating/temperature")
    assert not home.decide(node("/heating"), Right.PUBLISH, "/heating/temperature")
    assert home.decide(node("/nav/planner"), Right.SUBSCRIBE, "/robot/pose").restrictions == ()
    for who, effect in (("/toaster", Effect.DENY), ("/nav/planner", Effect.PROMPT)):
        camera = home.decide(node(who), Right.SUBSCRIBE, "/camera/image")
        assert camera.effect is effect
    assert home.decide(node("/toaster"), Right.SUBSCRIBE, "/robot/pose").effect is Effect.PROMPT


def test_decisions_of_the_hospital_policy() -> None:
    ward = decider("hospital")
    station = ward.decide(node("/ward/station"), Right.SUBSCRIBE, "/patient/vitals")
    assert station
    assert station.restrictions == ()
    vendor = ward.decide(node("/vendor/diag"), Right.SUBSCRIBE, "/patient/vitals")
    assert vendor
    (restriction,) = vendor.restrictions
    assert {rule.operator for rule in restriction.filters} == {"hash", "clear", "drop"}
    assert len(restriction.conditions) == 2
    odom = ward.decide(node("/vendor/diag"), Right.SUBSCRIBE, "/odom")
    assert "twist" in {rule.path for item in odom.restrictions for rule in item.filters}
    blurred = ward.decide(node("/fleet/r7"), Right.SUBSCRIBE, "/camera/image")
    assert [str(rule) for item in blurred.restrictions for rule in item.filters] == [
        "data: pixelate block 16"
    ]
    for who in ("/vendor/diag", "/ward/station"):
        assert ward.decide(node(who), Right.PUBLISH, "/cmd_vel").effect is Effect.DENY
        assert ward.decide(node(who), Right.CALL, "/arm/stop").effect is Effect.DENY


def test_decisions_of_the_visitor_policy() -> None:
    flat = decider("visitor")
    guest = node("/guest/phone")
    pose = flat.decide(guest, Right.SUBSCRIBE, "/robot/pose")
    assert pose
    assert (pose.lifetime, pose.renew_until) == (2 * HOUR, 0)
    assert 'now < timestamp("2026-11-20T18:00:00Z")' in pose.restrictions[0].conditions
    assert flat.decide(guest, Right.CALL, "/robot/come_here")
    drive = flat.decide(guest, Right.PUBLISH, "/cmd_vel")
    assert (drive.effect, drive.lifetime) == (Effect.PROMPT, 600)
    assert flat.decide(node("/guest"), Right.CALL, "/robot/come_here").effect is Effect.DENY


@pytest.mark.parametrize("name", ["home", "hospital", "visitor"])
def test_examples_get_no_advice(name: str) -> None:
    found = lint(decider(name).policy, lambda kind: parse(kind, definition(kind)))
    assert [item.message for item in found] == []


def test_the_how_to_matches_the_program() -> None:
    text = (FOLDER.parents[1] / "docs" / "howto" / "room-not-position.md").read_text()
    decided = Decider(load(text.split("```yaml\n")[1].split("```")[0], definition))
    verdict = decided.decide(node("/heating"), Right.SUBSCRIBE, "/robot/pose")
    explained = "\n".join(decided.explain(verdict))
    assert f"$ rossec explain /heating subscribe /robot/pose\n{explained}\n```" in text
    messages = [
        item.message for item in lint(decided.policy, lambda kind: parse(kind, definition(kind)))
    ]
    assert all(word in " ".join(messages) for word in ("full rate", "hysteresis"))
    assert messages[0] in text
