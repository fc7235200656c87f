from pathlib import Path
from typing import Any

import pytest

from rossec.errors import ConfigurationError
from rossec.inprocess.options import Options, file_of, read

HOME = {"ROSSEC_HOME": "/h"}
FILE = '[rospy]\nnode = "/file"\nallow_plain = ["/f"]\n'


def test_without_options_nothing_is_plain() -> None:
    assert read(HOME, None) == read(HOME, "") == Options(Path("/h"))


def test_arguments_come_before_the_environment_before_the_file() -> None:
    environ = {**HOME, "ROSSEC_NODE": "/env", "ROSSEC_ALLOW_PLAIN": "/a, /b,"}
    assert read(HOME, FILE) == Options(Path("/h"), "/file", ("/f",))
    assert read(environ, FILE) == Options(Path("/h"), "/env", ("/a", "/b"))
    given = read(environ, FILE, node="/given", allow_plain=[])
    assert given == Options(Path("/h"), "/given", ())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("node =", "not TOML"),
        ("a = " + "[" * 5000, "not TOML"),
        ("a = " + "9" * 5000, "not TOML"),
        (".".join(["a"] * 3000) + " = 1", "more than 2000 dots"),
        ("[rospy]\nnodes = 1", "something unknown"),
        ("rospy = 1", "something unknown"),
        ('[rospy]\nnode = "no slash"', "not the name of a node"),
        ('[rospy]\nallow_plain = "/all"', "a list of names"),
        ("[rospy]\nallow_plain = true", "a list of names"),
        ("[rospy]\nallow_plain = [1]", "not text"),
        ('[rospy]\nallow_plain = [""]', "not text"),
    ],
)
def test_a_misspelling_opens_nothing(text: str, said: str) -> None:
    with pytest.raises(ConfigurationError, match=said):
        read(HOME, text)


@pytest.mark.parametrize(
    "given", [{"node": "ro bot"}, {"node": "ns/robot"}, {"node": ""}, {"allow_plain": "/x"}]
)
def test_invalid_arguments_are_refused(given: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError):
        read(HOME, None, **given)


def test_a_name_may_be_relative_as_in_rospy() -> None:
    assert read(HOME, None, node="robot").node == "robot"


def test_the_file_is_at_rossec_config_or_in_the_home() -> None:
    assert file_of(HOME) == Path("/h/rossec.toml")
    assert file_of({**HOME, "ROSSEC_CONFIG": "/etc/r.toml"}) == Path("/etc/r.toml")
