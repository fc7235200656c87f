"""Connection headers of a peer /viewer and a program of /robot, and how they are admitted."""

from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.participant.access import FIELD
from rossec.participant.authorized import memory_scope
from rossec.participant.handshakes import Fields
from rossec.sidecar.core.layers import (
    Answered,
    CallProgram,
    Command,
    Event,
    HeaderArrived,
    Layer,
    ListeningAddress,
    local_endpoint,
    topic_endpoint,
)
from rossec.sidecar.core.node_connections import AdmittedConnection, admit_peer
from tests.rossec.sidecar.agent_setup import AgentSetup

SLAVE = local_endpoint(WireProtocol.HTTP, 5000)
TOPICS_VIA_API = topic_endpoint(SLAVE)
TOPIC_PORT = ["TCPROS", "localhost", 5001]
TOPIC_ENDPOINT = local_endpoint(WireProtocol.TCPROS, 5001)
PEER = ListeningAddress(WireProtocol.TCPROS, "10.0.0.7", 6001)
STRING = {"type": b"std_msgs/String", "md5sum": b"992ce8a1687cec8c8bd883ec73ca41d1"}
REQUEST = {"callerid": b"/viewer", "topic": b"/word", "tcp_nodelay": b"1", **STRING}
ANSWER = {"callerid": b"/robot", "message_definition": b"string data\n", "latching": b"0", **STRING}
SERVICE = {"callerid": b"/viewer", "service": b"/say", "md5sum": b"*"}


def no_key(name: str) -> bytes:
    raise AssertionError(name)


def proof(setup: AgentSetup, name: str, right: Right, topic: str) -> Fields:
    return {FIELD: setup.access(name).present(right, topic, setup.site.now())}


def admit(
    setup: AgentSetup, fields: Fields, endpoint: ListeningAddress = TOPICS_VIA_API
) -> Layer[AdmittedConnection]:
    peer = setup.identity("/viewer")
    return admit_peer(
        setup.agent, endpoint, fields, peer, no_key, memory_scope("/robot").child, setup.site.now()
    )


REQUEST_TOPIC = CallProgram(SLAVE, "requestTopic", ("/viewer", "/word", [["TCPROS"]]))
REQUEST_ANSWERED: tuple[Command, Event] = (REQUEST_TOPIC, Answered([1, "ready", TOPIC_PORT]))
"""The request for the topic port of a program, and its answer."""


def arrived(setup: AgentSetup, fields: Fields, peer: str | None = None) -> HeaderArrived:
    identity = None if peer is None else setup.identity(peer)
    return HeaderArrived(fields, identity, setup.site.now())
