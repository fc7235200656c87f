from tests.support.commands import Shell, refused


def test_privacy_is_a_report_and_a_group(shell: Shell) -> None:
    refused(shell("privacy", "--node", "/a"), "policy")
    refused(shell("privacy", "opt-out", "camera"), "camera")
