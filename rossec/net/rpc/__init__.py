"""XML-RPC over secure streams: client and server."""
