"""Subscribes a plain program behind a sidecar to a publisher."""

from rossec.channel.opening import WireProtocol
from rossec.participant.handshakes import Fields
from rossec.sidecar.core.layers import parse_endpoint
from rossec.sidecar.loopback_port import PlainStream
from tests.rossec.sidecar.program import Program


async def subscribed(program: Program, topic: str, fields: Fields) -> tuple[PlainStream, Fields]:
    """Register, ask the publisher and connect, with these fields in the connection header."""
    kind = fields["type"].decode()
    uris = await program.register("registerSubscriber", topic, kind)
    assert isinstance(uris, list)
    answer = await program.ask(uris[0], "requestTopic", topic, [["TCPROS"]])
    assert isinstance(answer, list)
    endpoint = parse_endpoint(f"rosrpc://{answer[2][1]}:{answer[2][2]}", WireProtocol.TCPROS)
    assert endpoint is not None
    return await program.connect(endpoint, {"topic": topic.encode(), **fields})
