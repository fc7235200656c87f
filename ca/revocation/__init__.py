"""What is revoked: signed lists, the Merkle tree of many entries, a node's view of them. Pure."""
