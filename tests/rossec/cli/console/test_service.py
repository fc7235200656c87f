"""What the console's commands share: the service they ask, and the code they show."""

import pytest

from ca.enrollment import qr
from rossec.authority.home import AuthorityHome
from rossec.cli.phones import login_address, running_service, show_code
from rossec.errors import ConfigurationError
from tests.support.commands import Shell
from tests.support.keyservice import running_service as service


def test_the_service_that_runs_is_found(shell: Shell) -> None:
    home = AuthorityHome.at(shell.root)
    with pytest.raises(ConfigurationError, match="does not run"):
        running_service(home)
    with service(home):
        client = running_service(home)
        assert client.status()["domain"] == home.domain
        client.close()


def test_a_code_is_in_the_fragment() -> None:
    assert login_address("https://a", "C") == "https://a/login#C"
    assert login_address("https://a", "C", "é #.") == "https://a/login#C.%C3%A9%20%23."


def test_a_code_is_printed_as_text_and_picture(capsys: pytest.CaptureFixture[str]) -> None:
    show_code("https://a/login#C")
    out = capsys.readouterr().out
    assert out.startswith(qr.terminal("https://a/login#C"))
    assert "https://a/login#C\n" in out
    assert "of this computer" not in out
    show_code("http://localhost:7411/login#C")
    assert "of this computer" in capsys.readouterr().out
