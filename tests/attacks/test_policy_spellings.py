"""Keys of a policy that are one name in two spellings: the second must not win without a word."""

import pytest

from grants.errors import PolicyRefused
from grants.policy.read import mistakes_in
from tests.grants.policy.policies import policy, rules

HEAD = """rossec: 1
robot: r
types: {~/pose: geometry_msgs/PoseStamped, /plan: geometry_msgs/PoseArray}
"""
HIDES, LEAKS = "{pose.position: {clear: true}}", "{header.frame_id: {clear: true}}"
ALLOWS = "id: a, who: /x, allow: {subscribe: [~/pose]}"


def refused(text: str) -> str:
    with pytest.raises(PolicyRefused) as error:
        policy(text)
    (found,) = mistakes_in(error.value)
    return f"{found.line}:{found.column} {found.message}"


@pytest.mark.attack("two-spellings")
@pytest.mark.parametrize(("first", "second"), [("~/pose", '"{node}/pose"'), ('"{node}/pose"', "~/pose")])
@pytest.mark.parametrize(
    ("part", "said"),
    [
        ("filter", (HIDES, LEAKS)),
        ("filter", (LEAKS, HIDES)),
        ("see", ("{position: no}", "{position: exact}")),
        ("see", ("{position: exact}", "{position: no}")),
    ],
)
def test_neither_of_two_filters_is_lost(part: str, said: tuple[str, str], first: str, second: str) -> None:
    before = f"  - {{{ALLOWS}, {part}: {{{first}: {said[0]}, "
    at, column = before.rindex(first[0] + first[1]), len(before)
    if first.startswith('"'):
        at = before.rindex(first)
    text = f"{HEAD}rules:\n{before}{second}: {said[1]}}}}}\n"
    expected = f"{part} of rule a: '{{node}}/pose' a second time, first in 5:{at + 1}"
    assert refused(text) == f"5:{column + 1} {expected}"


@pytest.mark.attack("two-spellings")
def test_neither_of_two_types_is_lost() -> None:
    kinds = 'types:\n  ~/a: std_msgs/String\n  "{node}/a": std_msgs/Header\n'
    found = refused(f"rossec: 1\nrobot: r\n{kinds}rules: []\n")
    assert found == "5:3 types: '{node}/a' a second time, first in 4:3"


@pytest.mark.attack("two-spellings")
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            'vocabulary:\n  ~/pose: {header.seq: presence}\n  "{node}/pose": {header.seq: image}\n',
            "6:3 vocabulary: '{node}/pose' a second time, first in 5:3",
        ),
        (
            """tests:
  - who: /x
    may: {subscribe: [/y]}
    at: '2026-01-01T00:00:00Z'
    message: {pose.x: 1, pose: {x: 2}}
""",
            "8:36 message: 'pose.x' a second time, first in 8:23",
        ),
    ],
)
def test_nothing_else_that_is_keyed_by_names_is_lost(text: str, expected: str) -> None:
    with pytest.raises(PolicyRefused) as error:
        policy(f"{HEAD}{text}rules: []\n")
    assert expected in {f"{x.line}:{x.column} {x.message}" for x in mistakes_in(error.value)}


@pytest.mark.attack("two-spellings")
@pytest.mark.parametrize("name", ["/x/", "//x", "/x//y", "x", "/é", "/\uff58", "/x ", "{node}/", "~//p"])
def test_a_name_has_no_further_spellings(name: str) -> None:
    with pytest.raises(PolicyRefused):
        rules(f'{{id: a, who: "/a", allow: {{subscribe: ["{name}"]}}}}')
