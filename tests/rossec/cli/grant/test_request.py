"""Asking for rights, and the ways an answer comes: transcripts."""

import json
import time
from pathlib import Path

import pytest

from tests.support.commands import Shell, refused
from tests.support.refusingmaster import refuse_grants

POLICY = """rossec: 1
robot: r
defaults: {decision: prompt, lifetime: 7d, prompt_timeout: 1h}
types: {/robot/pose: geometry_msgs/PoseStamped}
filters: {room: {pose.position: {round: 2.0}}}
rules:
  - id: heating
    why: it heats
    who: /heating
    allow: {subscribe: [/robot/pose], publish: [/heat]}
    filter: {use: room}
  - {id: no, who: "*", deny: {call: [/door]}}
  - {id: maybe, who: /heating, prompt: {call: [/lift]}, why: it lifts}
"""


@pytest.fixture
def site(shell: Shell) -> Shell:
    shell.enroll("/heating")
    (shell.root / "ca" / "policy.yaml").write_text(POLICY)
    return shell


def ask(site: Shell, *options: str) -> str:
    said = site("grant", "request", "/heating", *options, "--why", "to heat\x1b[2J")
    assert said.code == 0, said
    return said.out.split()[1]


def test_a_request_the_policy_allows_is_signed(site: Shell, tmp_path: Path) -> None:
    ask(site, "--subscribe", "/robot/pose", "--publish", "/heat", "--call", "/door")
    said = site.unlocked("grant", "decide", "--out-dir", str(tmp_path / "out"))
    assert said.code == 0, said
    first, *rest = said.out.splitlines()
    assert first.startswith("grant ")
    assert " for /heating until " in first
    assert "  may subscribe /robot/pose" in rest
    assert "    pose.position: round step 2.0" in rest
    assert rest[-3:] == [
        "denied /heating call /door: by rule no",
        "  what would change it: rossec explain /heating call /door",
        "2 allowed, 0 for you, 1 denied",
    ]
    assert len(list((site.node("/heating") / "grants").iterdir())) == 1
    assert len(list((tmp_path / "out").iterdir())) == 1
    assert site("grant", "pending").out == "no open requests\n"


def test_a_denial_by_default_is_said_with_what_would_change_it(site: Shell) -> None:
    (site.root / "ca" / "policy.yaml").write_text("rossec: 1\nrobot: r\nrules: []\n")
    ask(site, "--publish", "/nobody/said")
    said = site.unlocked("grant", "decide", "--json")
    (denial,) = json.loads(said.out)["denials"]
    assert denial["reason"].startswith("no rule gives it, and where none does the policy denies")
    assert "denied /heating publish /nobody/said: no rule gives it" in said.err
    assert "rossec explain /heating publish /nobody/said" in said.err


def test_who_asks_where_there_is_no_policy_is_told_who_can_answer(shell: Shell) -> None:
    shell.enroll("/lamp")
    said = shell("grant", "request", "/lamp", "--publish", "/lamp/on", "--why", "it shines")
    assert said.code == 0
    assert "there is no policy that decides it: rossec grant sign /lamp --publish /lamp/on" in (said.err)
    assert "rossec policy init" in said.err


def test_a_request_is_sent_as_a_file(site: Shell, tmp_path: Path) -> None:
    out = tmp_path / "heat.request"
    ask(site, "--publish", "/heat", "--out", str(out))
    said = site.unlocked("grant", "decide", str(out))
    assert "1 allowed, 0 for you\n" in said.out
    refused(site.unlocked("grant", "decide", str(out)), "already recorded or answered", "pending")


def test_a_person_is_shown_everything(site: Shell) -> None:
    number = ask(site, "--call", "/lift")
    lines = site("grant", "pending").out.splitlines()
    assert lines[:4] == [
        f"{number[:8]}  /heating wants to call /lift",
        '  it says: "to heat\\u001b[2J"',
        "  rule maybe: it lifts",
        "  valid 7d",
    ]
    (row,) = json.loads(site("grant", "pending", "--json").out)
    assert (row["request"], row["right"], row["name"]) == (number, "call", "/lift")


def test_an_approved_request_is_signed_as_it_is(site: Shell) -> None:
    number = ask(site, "--call", "/lift")
    said = site.unlocked("grant", "approve", number[:6])
    assert "may call /lift" in said.out
    assert "given to /heating" in said.out
    refused(site.unlocked("grant", "approve", number[:6]), "no open request begins with", "pending")


def test_an_approved_request_is_filtered_and_ends_at_midnight(site: Shell) -> None:
    path = site.root / "ca" / "policy.yaml"
    path.write_text(POLICY.replace("who: /heating\n    allow", "who: /other\n    allow"))
    number = ask(site, "--subscribe", "/robot/pose")
    said = site.unlocked("grant", "approve", number, "--approximate", "room", "--today")
    assert "    pose.position: round step 2.0" in said.out
    rows = json.loads(site("grant", "list", "--json").out)
    assert rows[0]["expires"] - rows[0]["not_before"] <= 86400


def test_an_approved_request_is_signed_with_a_preset(site: Shell) -> None:
    path = site.root / "ca" / "policy.yaml"
    path.write_text(POLICY.replace("who: /heating\n    allow", "who: /other\n    allow"))
    number = ask(site, "--subscribe", "/robot/pose")
    said = site.unlocked("grant", "approve", number, "--approximate", "coarse-position")
    assert "    pose.position: round hysteresis 2.0 step 4.0" in said.out
    assert "    one message at the start of each 30 s" in said.out


def test_a_filter_that_is_not_there(site: Shell) -> None:
    number = ask(site, "--subscribe", "/other")
    said = site.unlocked("grant", "approve", number, "--approximate", "rom")
    refused(said, "no filter 'rom'", "there are: room, coarse-position")
    refused(
        site.unlocked("grant", "approve", number, "--approximate", "room"),
        "the type of /other is not known",
        "add it to types",
    )
    assert "nobody" not in site("grant", "pending").out  # it still waits


def test_a_denied_request_is_closed(site: Shell) -> None:
    number = ask(site, "--call", "/lift")
    assert site("grant", "deny", number).out == "denied /heating call /lift\n"
    refused(site("grant", "deny", number), "no open request begins")


def test_an_ambiguous_request_id_is_refused(site: Shell) -> None:
    refused(site("grant", "deny", ""), "no open request begins")
    ask(site, "--call", "/lift")
    ask(site, "--call", "/lift")
    refused(site("grant", "deny", ""), "several requests begin")


def test_an_unanswered_request_is_denied(site: Shell) -> None:
    path = site.root / "ca" / "policy.yaml"
    path.write_text(POLICY.replace("prompt_timeout: 1h", "prompt_timeout: 1s"))
    ask(site, "--call", "/lift")
    site("grant", "pending")
    time.sleep(2.1)
    assert site("grant", "pending").out == "no open requests\n"


def test_an_empty_or_invalid_request_is_refused(site: Shell) -> None:
    said = site("grant", "request", "/heating", "--why", "x")
    refused(said, "a request for nothing", "--publish")
    said = site("grant", "request", "/heating", "--call", "lift", "--why", "x")
    refused(said, "not a name pattern")


def test_a_request_for_an_authority_elsewhere_needs_a_file(site: Shell, tmp_path: Path) -> None:
    (site.root / "ca").rename(tmp_path / "ca")
    said = site("grant", "request", "/heating", "--call", "/lift", "--why", "x")
    refused(said, "the authority is elsewhere", "--out FILE")


def test_an_invalid_file_in_the_inbox_is_reported_and_dropped(site: Shell) -> None:
    (site.root / "ca" / "inbox").mkdir()
    (site.root / "ca" / "inbox" / "x.request").write_bytes(b"?")
    said = site("grant", "pending")
    assert said.err.startswith("rossec: a request was dropped: x.request: not a request")


@pytest.mark.parametrize("wish", [("--publish", "/heat"), ("--call", "/lift")])
def test_an_answer_that_the_master_refuses_is_no_success(
    site: Shell, wish: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The policy allows the one, a person the other."""
    number = ask(site, *wish)
    site.node("/heating").rename(site.root / "elsewhere")
    refuse_grants(monkeypatch)
    said = site.unlocked("grant", "decide")
    if wish[1] == "/lift":
        assert said.code == 0
        said = site.unlocked("grant", "approve", number[:8])
    assert said.code == 3
    assert "of /heating: no room\n" in said.err
    assert "rossec: error: 1 grant is signed, but not delivered" in said.err
    assert "rossec grant deliver" in said.err.splitlines()[-1]
