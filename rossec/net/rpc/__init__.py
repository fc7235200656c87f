"""XML-RPC over secure streams: client and server."""

from rossec.net.rpc.calls import CALL_DEADLINE, REQUEST_DEADLINE, CallFailed, Dispatch, RpcClient, serve_calls
from rossec.net.rpc.time_slices import AT_ONCE, of_loop, source_of

__all__ = [
    "AT_ONCE",
    "CALL_DEADLINE",
    "REQUEST_DEADLINE",
    "CallFailed",
    "Dispatch",
    "RpcClient",
    "of_loop",
    "serve_calls",
    "source_of",
]
