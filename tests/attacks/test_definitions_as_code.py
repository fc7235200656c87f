"""A publisher's type: its name and its definition become Python code in the library that reads it.

rosbags generates a class for each type and executes it, so nothing of another host's text may be
in that code but names and values of its grammar.
"""

from pathlib import Path

import pytest

from rossec.cli.ros.topic import readable
from rossec.errors import MessageError
from rossec.participant.definitions import Definition
from rossec.participant.message_types import message_type

RUN = "__import__('os').mknod({!r})"

pytestmark = pytest.mark.attack("definition-runs-code")


@pytest.fixture
def ran(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Is there if any of it was executed; no `/` is needed for that."""
    monkeypatch.chdir(tmp_path)
    return tmp_path / "ran"


@pytest.mark.parametrize(
    "name",
    [
        "evil_a/X:\n    {}\nclass Y",
        'evil_b/X:\n    """"""\n    {}\n    """',
        "evil_c/X = {} #",
        "evil_d/X'] = {} #",
        "evil e/X",
        "evil_f/X\n",
        "\u0435vil/X",
    ],
)
def test_the_name_of_a_type(ran: Path, name: str) -> None:
    claimed = Definition(name.format(RUN.format(ran.name)), "0" * 32, "int32 x\n")
    with pytest.raises(MessageError):
        readable(claimed)
    assert not ran.exists()


@pytest.mark.parametrize(
    "text",
    [
        "string S='+{}+'\nint32 x\n",
        'string S="""\n    {}\n"""\nint32 x\n',
        "int32 S={}\nint32 x\n",
        "int32 x={}\n",
        "int32[{}] x\n",
        "int32 x\n    {}\n",
        "int32 x\n" + "=" * 80 + "\nMSG: evil_n/Y:\n    {}\nint32 y\n",
    ],
)
def test_the_definition_of_a_type(ran: Path, text: str) -> None:
    name = f"evil_text/T{abs(hash(text))}"
    try:
        readable(Definition(name, "0" * 32, text.format(RUN.format(ran.name))))
    except MessageError:
        pass
    else:
        message_type(name).create()
    assert not ran.exists()
