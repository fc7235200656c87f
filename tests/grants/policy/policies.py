"""Policies for tests: message definitions without ROS, and short helpers."""

from collections.abc import Callable

from ca.errors import HintedError
from grants.model import Right
from grants.policy.decision import Decider, Verdict
from grants.policy.model import Policy, Subject
from grants.policy.read import load, mistakes_in
from grants.policy.source import Mistake
from rossec.participant.message_types import message_type, type_names

HEATING_KEY = bytes(range(32))
OTHER_KEY = bytes(32)

HEADER = """rossec: 1
robot: test
"""
SMALL = f"""rossec: 1
robot: test-robot
defaults: {{decision: prompt, lifetime: 7d, renew_until: 180d, prompt_timeout: 60s}}
identities:
  heating: {{node: /heating, key: "sha256:{HEATING_KEY.hex()}"}}
  navigation: {{node: "/nav/**"}}
types: {{/robot/pose: geometry_msgs/PoseStamped, /camera/image: sensor_msgs/Image}}
filters:
  room:
    pose.position: {{round: 2.0}}
    pose.orientation: {{clear: true}}
rules:
  - id: heating-room
    why: "Heating lowers rooms."
    who: heating
    allow: {{subscribe: [/robot/pose]}}
    when: 'now.getHours("Europe/Zurich") >= 6 && msg.header.frame_id == "map"'
    filter: {{use: room}}
    limit: {{rate: 0.2}}
  - {{id: heating-own, who: heating, allow: {{publish: ["/heating/**"]}}}}
  - {{id: nav-full, who: navigation, allow: {{publish: [/cmd_vel], subscribe: [/robot/pose]}}}}
  - {{id: no-camera, who: "*", except: navigation, deny: {{subscribe: ["/camera/**"]}}, why: "no"}}
"""


def definition(name: str) -> str:
    return message_type(name).definition


def nothing_known(name: str) -> str:
    raise HintedError(f"unknown message type {name!r}", "write package/Type")


def policy(text: str = SMALL, types: Callable[[str], str] = definition) -> Policy:
    return load(text, types, file="test.yaml", known_types=type_names())


def rules(*lines: str, head: str = HEADER) -> Policy:
    """A policy of these rules, one flow mapping each."""
    listed = "".join(f"\n  - {line}" for line in lines) or " []"
    return policy(f"{head}rules:{listed}\n")


def mistakes(text: str) -> list[Mistake]:
    """All mistakes of a text; none for a valid one."""
    try:
        policy(text)
    except HintedError as error:
        return list(mistakes_in(error))
    return []


def node(name: str, key: bytes = OTHER_KEY) -> Subject:
    return Subject(name, key)


HEATING = node("/heating", HEATING_KEY)


def decide(of: Policy, subject: Subject, right: Right, name: str) -> Verdict:
    return Decider(of).decide(subject, right, name)
