"""`title:`: one short line for people, which decides nothing and imitates nothing."""

import pytest

from grants.errors import PolicyRefused
from grants.filters.layout import Layout
from grants.model import Right
from grants.policy.decision import Decider
from grants.policy.learn import NewRule, add_rules
from grants.policy.lint import lint
from grants.policy.model import Policy, Subject
from grants.policy.read import MAX_TITLE, flaw_of, load

HEAD = "rossec: 1\nrobot: r\ngroups: {lamps: [/lamp1, /lamp2, '/hall/*']}\nrules: []\n"


def unknown(name: str) -> Layout:
    raise LookupError(name)


def read(title: str) -> Policy:
    return load(f"{HEAD}title: {title}\n", str)


@pytest.mark.parametrize(
    "title", ["Dr. Meier", "Zoë", "the lamp (hall)", "a" * MAX_TITLE, "Ärztin", "客厅", "Café №5"]
)
def test_a_title(title: str) -> None:
    assert flaw_of(title) == ""


@pytest.mark.parametrize(
    ("title", "flaw"),
    [
        ("", "1 to 60 characters"),
        ("a" * 61, "1 to 60 characters"),
        ("a\nb", "control"),
        ("a\u202eb", "direction"),
        ("a\u200bb", "format"),
        ("a\ud800", "control"),
        ("a\u2066b", "direction"),
        ("a\u00a0b", "other spaces"),
        ("a\u2003b", "other spaces"),
        (" a", "single spaces"),
        ("a ", "single spaces"),
        ("a  b", "single spaces"),
        ("e\u0301", "NFC"),
        ("\u0301a", "combining"),
        ("x\u0323\u0331\u0330", "combining"),
        ("Dr. Meier /doctor", "slash"),
        ("/doctor", "slash"),
    ],
)
def test_what_is_no_title(title: str, flaw: str) -> None:
    assert flaw in flaw_of(title)


def test_titles_are_of_names_patterns_and_members_of_groups() -> None:
    policy = read("{/doctor: Dr. Meier, '/robot/**': all of it, lamps: a lamp, /lamp2: the red one}")
    assert policy.titles == {
        "/doctor": "Dr. Meier",
        "/robot/**": "all of it",
        "/lamp1": "a lamp",
        "/lamp2": "the red one",
        "/hall/*": "a lamp",
    }
    assert read("{'hospital:/rounds/one': Ward 3}").titles == {"/remote/hospital/rounds/one": "Ward 3"}
    assert load(HEAD, str).titles == {}


@pytest.mark.parametrize(
    ("title", "mistake"),
    [
        ("{/a: Anna, /b: anna}", "title: 'anna' a second time"),
        ("{/a: Anna, /a: Berta}", "duplicate key"),
        ("{/a: 5}", "must be text"),
        ("{/a: [Anna]}", "must be text"),
        ('{/a: "a\\u202eb"}', "no control, format or direction"),
        ("{doctors: Anna}", "neither a name nor a group"),
        ("{'~/pose': Anna}", "neither a name nor a group"),
        ("{/a/: Anna}", "/a/"),
        ("{/robot*: Anna}", "/robot*"),
        ("[/a]", "must be a mapping"),
        ("Anna", "must be a mapping"),
    ],
)
def test_what_is_refused(title: str, mistake: str) -> None:
    with pytest.raises(PolicyRefused) as refused:
        read(title)
    assert any(mistake in str(each) for each in refused.value.mistakes), refused.value.mistakes


def test_a_title_decides_nothing_and_is_kept_when_the_file_is_rewritten() -> None:
    plain, titled = load(HEAD, str), read("{/doctor: Dr. Meier}  # who comes on Mondays")
    asked = Subject("/doctor", bytes(32)), Right.SUBSCRIBE, "/robot/pose"
    assert Decider(titled).decide(*asked).effect is Decider(plain).decide(*asked).effect
    assert [each.code for each in lint(titled, unknown)] == [each.code for each in lint(plain, unknown)]
    text = f"{HEAD}title: {{/doctor: Dr. Meier}}  # who comes on Mondays\n"
    after = add_rules(text, [NewRule("a", "b", "/doctor", "deny", {"subscribe": ["/x"]})])
    assert "title: {/doctor: Dr. Meier}  # who comes on Mondays" in after
    assert load(after, str).titles == titled.titles
