from tests.support.commands import Shell, refused


def test_without_an_authority_there_are_no_domains(empty: Shell) -> None:
    refused(empty("domain", "list"), "there is no authority", "rossec ca init")
    assert "Trust other domains" in empty("domain", "--help").out
