from pathlib import Path

import pytest

from ca.errors import PathRefused
from rossec.environment import own_home, rossec_home
from rossec.errors import ConfigurationError


def test_rossec_home_and_its_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/user")
    assert rossec_home({}) == Path("/home/user/.local/share/rossec")
    assert rossec_home({"ROSSEC_HOME": "/srv/rossec"}) == Path("/srv/rossec")
    assert rossec_home({"ROSSEC_HOME": "~/keys"}) == Path("/home/user/keys")


@pytest.mark.parametrize("value", ["", ".", "keys"])
def test_home_is_absolute(value: str) -> None:
    with pytest.raises(ConfigurationError, match="ROSSEC_HOME is") as caught:
        rossec_home({"ROSSEC_HOME": value})
    assert "absolute path" in caught.value.hint


def test_an_unknown_home_directory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(text: Path) -> Path:
        raise RuntimeError(text)

    with pytest.raises(ConfigurationError, match=r"^~nobody-of-that-name is no home") as caught:
        rossec_home({"ROSSEC_HOME": "~nobody-of-that-name/rossec"})
    assert "absolute path" in caught.value.hint
    monkeypatch.setattr(Path, "expanduser", unknown)  # a user without an entry, and no HOME
    with pytest.raises(ConfigurationError, match=r"^~ is no home directory"):
        rossec_home({})


def test_a_home_that_others_can_write_in_is_refused(tmp_path: Path) -> None:
    environ = {"ROSSEC_HOME": str(tmp_path / "home")}
    assert own_home(environ) == tmp_path / "home"  # it need not exist yet
    (tmp_path / "home").mkdir(mode=0o700)
    assert own_home(environ) == tmp_path / "home"
    (tmp_path / "home").chmod(0o777)
    with pytest.raises(PathRefused):
        own_home(environ)
