"""The three example policies, loaded and evaluated."""

import math
import re
import struct
from pathlib import Path

import pytest

from grants.filters.layout import parse
from grants.model import Right
from grants.policy.decision import Decider
from grants.policy.lint import lint
from grants.policy.model import DAY, HOUR, Effect
from grants.policy.privacy import Trial, level_lines, shown
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
    assert [item.slot for item in room.restrictions] == [30]
    assert {rule.path for item in room.restrictions for rule in item.filters} == {
        "pose.position",
        "pose.orientation",
        "header.stamp",
        "header.seq",
    }
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
        "data: pixelate across 16 block 32 levels 8"
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


HOW_TO = sorted((FOLDER.parents[1] / "docs" / "howto").glob("*.md"))
POLICY = re.compile(r"(?:```yaml\n|<<'END'\n)(rossec: 1\n.*?)(?:```|END\n)", re.DOTALL)
REMARKED = {
    "names-by-rules": {"wide-right"}  # a phone is wherever the rules put it
}


def leaks(text: str) -> set[str]:
    found = lint(load(text, definition), lambda kind: parse(kind, definition(kind)))
    return {item.code for item in found if item.is_leak}


def test_policies_of_how_tos_give_nothing_away() -> None:
    found = {path.stem: leaks(text) for path in HOW_TO for text in POLICY.findall(path.read_text())}
    assert "thirty-robots" in found
    assert {name: codes for name, codes in found.items() if codes} == REMARKED


def how_to() -> tuple[str, list[str]]:
    """The text, and its policies: the first as it stands, and with the second filter in it."""
    text = (FOLDER.parents[1] / "docs" / "howto" / "room-not-position.md").read_text()
    first, rooms = (part.split("```")[0] for part in text.split("```yaml\n")[1:3])
    assert first.count("    filter: {use: coarse-position}\n") == 1
    return text, [first, first.replace("    filter: {use: coarse-position}\n", rooms)]


def test_the_how_to_matches_the_program() -> None:
    text, policies = how_to()
    decided = Decider(load(policies[0], definition))
    verdict = decided.decide(node("/heating"), Right.SUBSCRIBE, "/robot/pose")
    headline, *fields = decided.explain(verdict)
    seen = shown(decided.policy, verdict, lambda kind: parse(kind, definition(kind)))
    explained = "\n".join([headline, *(f"  {line}" for line in level_lines(seen)), *fields])
    assert f"$ rossec explain /heating subscribe /robot/pose\n{explained}\n```" in text
    for policy in policies:
        found = lint(load(policy, definition), lambda kind: parse(kind, definition(kind)))
        assert [item.message for item in found] == []


def test_the_words_of_the_how_to() -> None:
    """`see` with its rooms shows the heating what the filter of rooms does."""
    text, policies = how_to()
    see, rooms = (part.split("```")[0] for part in text.split("```yaml\n")[3:5])
    written = policies[0].replace("    filter: {use: coarse-position}\n", see)
    for head, level in (("", "no finer than 4 m"), (rooms, "no finer than 2.45 m")):
        policy = load(written.replace("rules:\n", f"{head}rules:\n"), definition)
        verdict = Decider(policy).decide(node("/heating"), Right.SUBSCRIBE, "/robot/pose")
        seen = shown(policy, verdict, lambda kind: parse(kind, definition(kind)))
        assert level_lines(seen)[0].startswith(f"sees where it is: the room ({level}, ")
        assert lint(policy, lambda kind: parse(kind, definition(kind))) == []


def test_the_rooms_of_the_how_to() -> None:
    """Each position in a room becomes the same point, and one in no room has none."""
    decided = Decider(load(how_to()[1][1], definition))
    verdict = decided.decide(node("/heating"), Right.SUBSCRIBE, "/robot/pose")
    kind = "geometry_msgs/PoseStamped"
    told = []
    for x, y in ((1, 1), (3.5, 2.5), (5, 1), (1, 4), (5, 7), (-5, 0)):
        message = bytes(12) + b"\3\0\0\0map" + struct.pack("<7d", x, y, 0, 0, 0, 0, 1)
        trial = Trial(parse(kind, definition(kind)), verdict)
        told_at = (trial(message, 1_800_000_000 + second).message for second in range(61))
        found = next(filter(None, told_at))  # at the first moment of a slot of 30 s
        told.append(struct.unpack_from("<2d", found, 19))
    assert told[:5] == [(2, 1.5), (2, 1.5), (5, 1.5), (3, 4), (3, 4)]
    assert all(map(math.isnan, told[5]))
