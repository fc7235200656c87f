"""Seven mistakes of each of seven kinds, inserted into a valid policy: found with position."""

import pytest

from grants.filters.operators import OPERATORS
from tests.grants.policy.policies import HEATING_KEY, mistakes

KEY = HEATING_KEY.hex()
GOOD = f"""rossec: 1
robot: test-robot
defaults: {{decision: prompt, lifetime: 7d, renew_until: 180d, prompt_timeout: 60s}}
identities:
  heating: {{node: /heating, key: "sha256:{KEY}"}}
  vendor: {{node: "/vendor/**"}}
types:
  /robot/pose: geometry_msgs/PoseStamped
  /scan: sensor_msgs/LaserScan
  /diagnostics: diagnostic_msgs/DiagnosticArray
filters:
  room:
    pose.position: {{round: 2.0}}
    pose.orientation: {{clear: true}}
rules:
  - id: heating-room
    why: Heating lowers rooms.
    who: heating
    allow: {{subscribe: [/robot/pose]}}
    when: 'msg.header.frame_id == "map" && msg.pose.position.x > 0.0'
    filter: {{use: room}}
    limit: {{rate: 0.2}}
    lifetime: 1d
    renew_until: 30d
  - id: vendor-scan
    who: vendor
    except: heating
    allow:
      subscribe: [/scan, /diagnostics]
      publish: ["/vendor/**"]
    filter:
      /scan:
        ranges: {{truncate: 10}}
        header.frame_id: {{redact: "***"}}
        range_max: {{clamp: [0.0, 5.0]}}
      /diagnostics:
        "status[*].values": {{drop: true}}
        "status[*].name": {{set: hidden}}
  - {{id: vendor-params, who: vendor, deny: {{param-set: ["/**"]}}}}
  - {{id: heating-asks, who: heating, prompt: {{call: [/lift/down]}}, lifetime: 10m}}
"""

# kind: (original text, mistake, beginning of the message, part of the hint)
SEEDS: dict[str, list[tuple[str, ...]]] = {
    "field": [
        ("pose.position:", "pose.positon:", "geometry_msgs/PoseStamped: pose", "'position'"),
        ("pose.orientation:", "pose.orientaton:", "geometry_msgs/PoseStamped", "'orientation'"),
        ("ranges:", "rangs:", "sensor_msgs/LaserScan: rangs: no field", "'ranges'"),
        ("header.frame_id:", "header.frameid:", "sensor_msgs/LaserScan", "'frame_id'"),
        ("status[*].values", "status[*].value", "diagnostic_msgs/DiagnosticArray", "'values'"),
        ("msg.header.frame_id", "msg.heador.frame_id", "geometry_msgs/PoseStamped", "'header'"),
        ("msg.pose.position.x", "msg.pose.positoin.x", "geometry_msgs/PoseStamped", "'position'"),
    ],
    "operator": [
        ("{round: 2.0}", "{ruond: 2.0}", "pose.position: unknown operator 'ruond'", "'round'"),
        ("{clear: true}", "{cleer: true}", "pose.orientation: unknown operator", "'clear'"),
        ("{truncate: 10}", "{trunc: 10}", "ranges: unknown operator 'trunc'", "'truncate'"),
        ('{redact: "***"}', '{redcat: "***"}', "header.frame_id: unknown operator", "'redact'"),
        ("{clamp: [0.0, 5.0]}", "{clmap: [0.0, 5.0]}", "range_max: unknown", "'clamp'"),
        ("{drop: true}", "{dorp: true}", "status[*].values: unknown operator", "'drop'"),
        ("{set: hidden}", "{sets: hidden}", "status[*].name: unknown operator", "'set'"),
    ],
    "identity": [
        ("who: heating\n    allow", "who: haeting\n    allow", "unknown identity", "'heating'"),
        ("who: vendor\n", "who: vender\n", "unknown identity 'vender'", "'vendor'"),
        ("except: heating", "except: heeting", "unknown identity 'heeting'", "'heating'"),
        ("who: vendor, deny", "who: vendors, deny", "unknown identity 'vendors'", "'vendor'"),
        ("who: heating, prompt", "who: heatin, prompt", "unknown identity 'heatin'", "'heating'"),
        ("except: heating", "except: [vendor, Heating]", "unknown identity 'Heating'", "'heating'"),
        ("who: vendor, deny", 'who: "vendor*", deny', "unknown identity 'vendor*'", "'vendor'"),
    ],
    "key": [
        ("lifetime: 1d", "lifetme: 1d", "unknown key 'lifetme' in rule heating-room", "'lifetime'"),
        ("    why:", "    wy:", "unknown key 'wy' in rule heating-room", "'why'"),
        ("filters:\n", "filter:\n", "unknown key 'filter' in the policy", "'filters'"),
        ("robot: test", "robt: test", "unknown key 'robt' in the policy", "'robot'"),
        ("{decision:", "{decison:", "unknown key 'decison' in defaults", "'decision'"),
        ("{rate: 0.2}", "{rte: 0.2}", "unknown key 'rte' in limit of rule", "'rate'"),
        ("{node: /heating, key:", "{node: /heating, kee:", "unknown key 'kee'", "'key'"),
    ],
    "duration": [
        ("lifetime: 7d", "lifetime: 7 days", "lifetime is not a duration: '7 days'", "7d"),
        ("renew_until: 180d", "renew_until: 180", "renew_until is not a duration", "or never"),
        ("prompt_timeout: 60s", "prompt_timeout: never", "prompt_timeout is not a duration", "30s"),
        ("lifetime: 1d", "lifetime: 0d", "lifetime is not a duration: '0d'", "7d"),
        ("renew_until: 30d", "renew_until: 1y", "renew_until is not a duration: '1y'", "4w"),
        ("lifetime: 10m", "lifetime: 10M", "lifetime is not a duration: '10M'", "15m"),
        ("lifetime: 1d", "lifetime: [1d]", "lifetime is not a duration", "30s"),
    ],
    "pattern": [
        ("subscribe: [/scan", "subscribe: [scan", "subscribe: not a name pattern: 'scan'", "*"),
        ('["/vendor/**"]', '["/vendor/***"]', "publish: not a name pattern", "**"),
        ('["/**"]', '["/a*"]', "param-set: not a name pattern: '/a*'", "whole segment"),
        ("[/lift/down]", "[/lift/]", "call: not a name pattern: '/lift/'", "segment"),
        ('"/vendor/**"}', '"/vendor//x"}', "node of vendor: not a name pattern", "segment"),
        ("  /diagnostics: d", "  diagnostics: d", "topic: not a name pattern", "segment"),
        (
            "      /diagnostics:\n",
            "      /diagnostic:\n",
            "rule vendor-scan has no subscribe right",
            "'/diagnostics'",
        ),
    ],
    "type": [
        ("geometry_msgs/PoseStamped", "geometry_msgs/PoseStampd", "unknown message type", "PoseStamped"),
        ("sensor_msgs/LaserScan", "sensor_msg/LaserScan", "unknown message type", "LaserScan"),
        (
            "diagnostic_msgs/DiagnosticArray",
            "DiagnosticArray",
            "'DiagnosticArray' is no",
            "diagnostic_msgs/DiagnosticArray",
        ),
        (
            "  /scan: sensor_msgs/LaserScan\n",
            "",
            "the message type of /scan is unknown",
            "/scan",
            "[/scan, /diag",
        ),
        ("{round: 2.0}", '{round: "2"}', "pose.position: step must be a number", "round"),
        ("{set: hidden}", "{set: 5}", "diagnostic_msgs/DiagnosticArray: status[*].name: set", ""),
        ("position.x > 0.0", 'position.x > "0"', "geometry_msgs/PoseStamped: > cannot be", ""),
    ],
}


def test_the_valid_policy_has_no_mistakes() -> None:
    assert mistakes(GOOD) == []


def test_there_are_seven_of_each_of_seven_kinds() -> None:
    assert len(SEEDS) == 7
    assert {len(seeds) for seeds in SEEDS.values()} == {7}
    assert OPERATORS


@pytest.mark.parametrize(
    "seed", [pytest.param(seed, id=f"{k}-{n}") for k, s in SEEDS.items() for n, seed in enumerate(s)]
)
def test_an_inserted_mistake_is_reported_with_its_line_and_a_hint(seed: tuple[str, ...]) -> None:
    there, inserted, message, hint, *where = seed
    text = GOOD.replace(there, inserted, 1)
    assert text != GOOD
    line = text[: text.index(where[0] if where else inserted)].count("\n") + 1
    about = [item for item in mistakes(text) if item.message.startswith(message)]
    assert [item.line for item in about] == [line]
    assert hint in about[0].hint
    assert about[0].column >= 1
