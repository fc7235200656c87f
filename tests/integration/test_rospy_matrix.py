"""In-process rospy programs: everything works, and loopback shows no plaintext."""

import os
import secrets
import sys
from dataclasses import dataclass
from typing import Final

import pytest

from rossec.channel.opening import WireProtocol, first_bytes
from tests.support.fleet import PROJECT
from tests.support.matrix import SECRET, VARIANTS
from tests.support.recorder import Recording, record

pytestmark = pytest.mark.ros

MARKER: Final = secrets.token_hex(24).encode()
HOSTS: Final = ("127.0.0.1", "::1")
PRIVATE: Final = (
    SECRET.encode(),
    b"numbers",
    b"switch",
    b"shared",
    b"colour",
    b"/server",
    b"/client",
    b"methodCall",
    b"methodResponse",
    b"registerPublisher",
    b"requestTopic",
    b"callerid",
    b"md5sum",
    b"std_msgs",
    b"rossec_grants",
    b"rossec-grant",
)


@dataclass(frozen=True)
class Played:
    host: str
    said: str
    recording: Recording


@pytest.fixture(scope="module", params=HOSTS)
def played(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Played:
    """All variants of names in one recording."""
    path = tmp_path_factory.mktemp("matrix")
    command = [sys.executable, "-m", "tests.support.matrix", str(path), request.param]
    env = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
    env["PYTHONPATH"] = str(PROJECT)
    recording, done = record(path / "packets", MARKER, command, env)
    assert done.returncode == 0, done.stdout + done.stderr
    return Played(request.param, done.stdout, recording)


@pytest.mark.parametrize("variant", VARIANTS)
def test_everything_a_rospy_program_does_works(played: Played, variant: str) -> None:
    names = VARIANTS[variant]
    mine = f"{variant}: SEEN "
    lines = [line.removeprefix(mine) for line in played.said.splitlines() if mine in line]
    seen = dict(line.split(" ", 1) for line in lines)
    assert seen["latched"] == f"{SECRET} latched"
    assert seen["caller"] == names.names["server"]
    assert seen["header"] == "False", "what is ours stays ours"
    assert seen["call"] == f"{SECRET} 1"
    assert seen["persistent"] == str([f"{SECRET} {number}" for number in (2, 3, 4)])
    assert (seen["parameter"], seen["cached"]) == (SECRET, SECRET)
    assert seen["search"] == names.resolve("shared")
    assert seen["has"] == "[True, False]"
    assert seen["tree"] == "{'deep': [1, 2.5, True, 'x']}"
    assert seen["deleted"] == "gone"
    assert seen["private"] == "11"
    assert seen["ordered"] == "True", "no message was lost or out of order"
    assert seen["simtime"] == "True", "time and timers follow /clock"
    assert seen["name"] == names.names["client"]


def test_only_ciphertext_crosses_the_sockets(played: Played) -> None:
    recording = played.recording
    assert recording.dropped == 0
    assert recording.holds(MARKER), "the control: what is sent in clear is seen"
    for word in PRIVATE:
        assert not recording.holds(word), f"{word!r} went over loopback in clear"


def test_every_connection_introduces_itself_as_rossec(played: Played) -> None:
    openings = tuple(first_bytes(flavour) for flavour in WireProtocol)
    flows = played.recording.flows
    family = 16 if played.host == "::1" else 4
    callers = [data for data in flows.values() if data.startswith(openings)]
    assert len(callers) > 20
    assert {len(flow[0]) for flow, data in flows.items() if data in callers} == {family}
    assert {data[:4] for data in flows.values()} >= {openings[0][:4], openings[1][:4]}
