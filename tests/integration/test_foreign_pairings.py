"""Every form of a node reaches those of another domain, and stock tools behind a sidecar do.

A hospital and a home trust each other; each has a master, and the home's follows the hospital's.
"""

import contextlib
import sys
from collections.abc import Iterator
from typing import Final

import pytest

from tests.integration.foreignworld import LABEL, TOOL, Cast, follow, pairs, prepare, running_programs, world
from tests.integration.sidecarworld import ROSSEC, wait
from tests.support.fleet import SECURE
from tests.support.kinds import KINDS, SEEN

pytestmark = [pytest.mark.ros, pytest.mark.timeout(180)]


@pytest.fixture(scope="module")
def cast(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cast]:
    directory = tmp_path_factory.mktemp("foreign")
    home, hospital = world(directory, "home"), world(directory, "hospital")
    prepare(home, hospital)
    with contextlib.ExitStack() as stack:
        for side, other in ((hospital, home), (home, hospital)):
            way = f"uri: 'http://127.0.0.1:{other.port}'"
            stack.enter_context(side.master(*follow(other, way)))
        yield stack.enter_context(running_programs(home, hospital, directory / "never"))


@pairs
def test_foreign_messages_arrive_at_every_form(cast: Cast, source: str, sink: str) -> None:
    listener = cast.listeners[sink]
    listener.wait_for(f"HEARD {LABEL}/{source} words {source} ")
    listener.wait_for(f"HEARD {LABEL}/{source} latched {source} kept")


@pairs
def test_foreign_publishers_filter(cast: Cast, source: str, sink: str) -> None:
    about = f"HEARD {LABEL}/{source} pose "
    listener = cast.listeners[sink]
    wait(lambda: listener.said.count(about) > 3)
    poses = {line.removeprefix(about).strip() for line in listener.lines if line.startswith(about)}
    assert poses == {SEEN}


@pairs
def test_foreign_services_are_called(cast: Cast, source: str, sink: str) -> None:
    for about in ("CALLED", "KEPT"):
        cast.listeners[sink].wait_for(f"{about} {LABEL}/{source} {source} answers")


def test_stock_tools_list_and_describe_foreign_topics(cast: Cast) -> None:
    for listener in cast.listeners.values():
        listener.wait_for(f"HEARD {LABEL}/sidecar words")
    listed = cast.tool("rostopic", "list").split()
    assert {f"/{LABEL}/{kind}/words" for kind in KINDS} <= set(listed)
    said = cast.tool("rostopic", "info", f"/{LABEL}/inprocess/words")
    assert "Type: std_msgs/String" in said
    assert f" * /{LABEL}/inprocess_speaker (http://127.0.0.1:" in said
    assert " * /builtin_listener (http://127.0.0.1:" in said


def test_stock_tools_receive_foreign_messages(cast: Cast) -> None:
    said = cast.tool("rostopic", "echo", "-n", "1", f"/{LABEL}/inprocess/latched")
    assert 'data: "inprocess kept"' in said
    line = (ROSSEC, "run", *TOOL, "--", "rostopic", "hz", f"/{LABEL}/sidecar/words")
    with cast.home.started(cast.home.hosts.far, *line) as running:
        running.wait_for("average rate: ")


def test_stock_tools_call_foreign_services(cast: Cast) -> None:
    listed = cast.tool("rosservice", "list").split()
    assert {f"/{LABEL}/{kind}/switch" for kind in KINDS} <= set(listed)
    name = f"/{LABEL}/sidecar/switch"
    said = cast.tool("rosservice", "info", name)
    assert f"Node: /{LABEL}/sidecar_speaker\n" in said
    assert "Type: std_srvs/SetBool\n" in said
    assert 'message: "sidecar answers"' in cast.tool("rosservice", "call", name, "true")


def test_stock_tools_describe_foreign_nodes(cast: Cast) -> None:
    """What a foreign node says of its connections names both ends as they are called here."""
    listed = cast.tool("rosnode", "list").split()
    assert {f"/{LABEL}/{kind}_speaker" for kind in KINDS} <= set(listed)
    assert "/inprocess_listener" in listed
    cast.listeners["sidecar"].wait_for(f"HEARD {LABEL}/sidecar words")
    for kind in ("sidecar", "inprocess"):
        said = cast.tool("rosnode", "info", f"/{LABEL}/{kind}_speaker")
        assert f" * /{LABEL}/{kind}/words [std_msgs/String]" in said
        assert f" * /{LABEL}/{kind}/switch" in said
        assert f" * topic: /{LABEL}/{kind}/words\n    * to: /sidecar_listener\n" in said
        assert "Unable to communicate" not in said
    said = cast.tool("rosnode", "info", "/sidecar_listener")
    assert f" * topic: /{LABEL}/sidecar/words\n    * to: /{LABEL}/sidecar_speaker (" in said
    assert "xmlrpc reply from" in cast.tool("rosnode", "ping", "-c", "1", f"/{LABEL}/builtin_speaker")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("rostopic", "pub", "-1", f"/{LABEL}/x", "std_msgs/String", "hi"), "cannot be published"),
        (("rosparam", "set", f"/{LABEL}/x", "1"), "cannot be set"),
        (("rosparam", "delete", f"/{LABEL}/x"), "cannot be deleted"),
    ],
    ids=["publish", "set", "delete"],
)
def test_stock_tools_offer_nothing_below_remote(cast: Cast, words: tuple[str, ...], reason: str) -> None:
    done = cast.home.run(cast.home.hosts.far, *words, options=TOOL)
    said = done.stdout + done.stderr
    assert f"{reason} here: names below /remote are those of other masters" in said
    assert "take a name outside /remote" in said


REMAPPED: Final = """
import rospy
from std_msgs.msg import String
from std_srvs.srv import SetBool
rospy.init_node("tool")
message = rospy.wait_for_message("word", String, timeout=20)
header = message._connection_header
print("GOT", message.data, header["topic"], header["callerid"], flush=True)
rospy.wait_for_service("~lamp", timeout=20)
print("ANSWERED", rospy.ServiceProxy("~lamp", SetBool)(True).message, flush=True)
"""


@pytest.mark.parametrize("form", ["inprocess", "sidecar"])
def test_remapped_and_private_names_reach_foreigners(cast: Cast, form: str) -> None:
    """The program reads local names alone: the topic's alias, and that of the publisher."""
    remapping = f"word:=/{LABEL}/inprocess/latched", f"~lamp:=/{LABEL}/inprocess/switch"
    program = sys.executable, "-c", (SECURE if form == "inprocess" else "") + REMAPPED, *remapping
    secured = program if form == "inprocess" else (ROSSEC, "run", "--", *program)
    with cast.home.started(cast.home.hosts.near, *secured) as running:
        running.wait_for(f"GOT inprocess kept /{LABEL}/inprocess/latched /{LABEL}/inprocess_speaker\n")
        running.wait_for("ANSWERED inprocess answers")


def test_rossecs_own_tools_write_the_label(cast: Cast) -> None:
    def own(*words: str) -> str:
        with cast.home.started(cast.home.hosts.far, ROSSEC, *words, "--as", "/tool") as running:
            wait(lambda: running.process.poll() is not None)
            running._reader.join()
            return running.said

    said = own("graph")
    assert "hospital:/builtin/words (std_msgs/String)\n  published by hospital:/builtin_speaker\n" in said
    assert "hospital:/builtin/switch provided by hospital:/builtin_speaker\n" in said
    assert "hospital:/builtin/switch\n" in own("service", "list")
    said = own("service", "info", "hospital:/sidecar/switch")
    assert "node: hospital:/sidecar_speaker\n" in said
    assert "identity" not in said
    assert "builtin answers" in own("service", "call", "hospital:/builtin/switch", "{data: true}")
    echo = "topic", "echo", "hospital:/sidecar/latched", "std_msgs/String", "-n", "1"
    assert own(*echo) == 'data: "sidecar kept"\n---\n'
    refused = own("topic", "pub", "hospital:/x", "std_msgs/String", "{data: hi}")
    assert f"/{LABEL}/x cannot be published here" in refused
