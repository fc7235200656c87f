import subprocess
import sys

import pytest

import rossec.node
from rossec.node.node import Node
from rossec.participant.message_types import message_type


def test_exports_are_imported_on_first_use() -> None:
    shown = "import rossec.node, sys; print({'numpy', 'rossec.node.node'} & {*sys.modules})"
    command = [sys.executable, "-I", "-c", shown]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert said == "set()\n"
    assert (rossec.node.Node, rossec.node.message_type) == (Node, message_type)


def test_every_export_exists_and_nothing_else() -> None:
    assert [name for name in rossec.node.__all__ if not hasattr(rossec.node, name)] == []
    with pytest.raises(AttributeError, match=r"'rossec\.node' has no attribute 'Master'"):
        _ = rossec.node.Master
