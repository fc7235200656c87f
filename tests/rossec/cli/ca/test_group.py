from tests.support.commands import Shell, refused


def test_the_log_is_shown_by_its_group_and_checked_by_a_verb(shell: Shell) -> None:
    lines = shell("ca", "log").out.splitlines()
    assert len(lines) > 1
    assert shell("ca", "log", "--last", "1").out.splitlines() == lines[-1:]
    assert shell("ca", "log", "verify").out.splitlines() != lines


def test_the_invitations_are_shown_by_their_group_and_ended_by_a_verb(shell: Shell) -> None:
    assert shell("ca", "invitations").out == "no open invitations\n"
    assert shell("ca", "invitations", "--all").out == "no invitations\n"
    refused(shell("ca", "invitations", "revoke", "abc"), "no invitation")
