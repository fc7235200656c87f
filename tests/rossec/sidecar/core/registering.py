"""A program of /robot that registers with its master through the sidecar."""

from rossec.channel.opening import WireProtocol
from rossec.sidecar.core.commands import CallMaster, OpenEgress, OpenIngress
from rossec.sidecar.core.endpoints import Endpoint, local_endpoint
from rossec.sidecar.core.events import Answered, Opened
from rossec.sidecar.core.master_calls import handle_call
from tests.rossec.sidecar.agent_setup import HOST, AgentSetup, run_layer

OWN_URI = "http://localhost:5000"  # as a program may write it
SLAVE = local_endpoint(WireProtocol.HTTP, 5000)
INGRESS_URI = f"http://{HOST}:7000/"
SERVICE = local_endpoint(WireProtocol.TCPROS, 5001)
PEER = Endpoint(WireProtocol.HTTP, "10.0.0.7", 6000)
OK = Answered([1, "done", 0])


def register(setup: AgentSetup, *uris: str) -> object:
    egress = [(OpenEgress(PEER), Opened(8000)) for uri in uris if uri == PEER.uri]
    params = ("/robot", "/scan", "pkg/Type", INGRESS_URI)
    return run_layer(
        handle_call(setup.agent, "registerSubscriber", ("/robot", "/scan", "pkg/Type", OWN_URI)),
        (OpenIngress(SLAVE), Opened(7000)),
        (CallMaster("registerSubscriber", params), Answered([1, "ok", list(uris)])),
        *egress,
    )
