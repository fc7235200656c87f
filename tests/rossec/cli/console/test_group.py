"""The group: what is listed, and what runs without a verb."""

from tests.support.commands import Shell, refused


def test_its_verbs_are_listed(empty: Shell) -> None:
    out = empty("console", "--help").out
    for verb in ("approvals", "phone", "phones", "tls"):
        assert f"\n  {verb} " in out
    assert "localhost:7411" in out


def test_without_a_verb_it_runs(empty: Shell) -> None:
    refused(empty("console"), "there is no authority")
    refused(empty("console", "phones"), "there is no authority")
    refused(empty("console", "phones", "remove", "mine"), "there is no authority")
    refused(empty("console", "--demo", "--lan"), "--demo is for localhost")


def test_a_port_is_a_number(empty: Shell) -> None:
    for port in ("0", "65536", "http"):
        refused(empty("console", "--port", port), "--port", code=2)
