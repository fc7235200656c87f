"""A program of /robot that registers with its master through the sidecar."""

from rossec.channel.opening import WireProtocol
from rossec.sidecar.core.layers import (
    Answered,
    CallMaster,
    ListeningAddress,
    OpenEgress,
    OpenIngress,
    PortOpened,
    local_endpoint,
)
from rossec.sidecar.core.master_calls import handle_call
from tests.rossec.sidecar.agent_setup import HOST, AgentSetup, run_layer

OWN_URI = "http://localhost:5000"  # as a program may write it
SLAVE = local_endpoint(WireProtocol.HTTP, 5000)
INGRESS_URI = f"http://{HOST}:7000/"
SERVICE = local_endpoint(WireProtocol.TCPROS, 5001)
PEER = ListeningAddress(WireProtocol.HTTP, "10.0.0.7", 6000)
OK = Answered([1, "done", 0])


def register(setup: AgentSetup, *uris: str) -> object:
    egress = [(OpenEgress(PEER), PortOpened(8000)) for uri in uris if uri == PEER.uri]
    params = ("/robot", "/scan", "pkg/Type", INGRESS_URI)
    return run_layer(
        handle_call(setup.agent, "registerSubscriber", ("/robot", "/scan", "pkg/Type", OWN_URI)),
        (OpenIngress(SLAVE), PortOpened(7000)),
        (CallMaster("registerSubscriber", params), Answered([1, "ok", list(uris)])),
        *egress,
    )
