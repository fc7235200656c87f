import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest

from rossec.errors import ConfigurationError
from rossec.namespace.topic_names import PACKAGE, TYPE, service_type, write
from tests.support.messagepackage import generated


def test_the_type_is_registered_once() -> None:
    kind = service_type()
    assert service_type() == kind
    assert kind.name == TYPE == "rossec_namespace/GetTopicName"


def test_the_package_is_written_and_none_is_overwritten(tmp_path: Path) -> None:
    package = write(tmp_path)
    assert package == tmp_path / PACKAGE
    assert ElementTree.parse(package / "package.xml").findtext("name") == PACKAGE
    assert "GetTopicName.srv" in (package / "CMakeLists.txt").read_text()
    assert (package / "srv" / "GetTopicName.srv").stat().st_mode & 0o444
    with pytest.raises(ConfigurationError, match="is not overwritten"):
        write(tmp_path)


@pytest.mark.ros
def test_it_is_what_debian_s_genpy_makes_of_the_description(tmp_path: Path) -> None:
    """The same md5sum, or rospy would refuse to call; and the same bytes."""
    generated(tmp_path)
    program = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        f"from {PACKAGE}.srv import GetTopicName, GetTopicNameRequest\n"
        "import io; buffer = io.BytesIO()\n"
        "GetTopicNameRequest('a', '<node/>').serialize(buffer)\n"
        "print(GetTopicName._md5sum, buffer.getvalue().hex())\n"
    )
    done = subprocess.run(
        ["/usr/bin/python3", "-c", program], capture_output=True, text=True, check=True, timeout=60
    )
    kind = service_type()
    request = kind.request.create(name="a", metadata="<node/>")
    assert done.stdout.split() == [kind.md5sum, bytes(kind.request.serialize(request)).hex()]
