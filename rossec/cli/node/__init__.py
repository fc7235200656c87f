"""`rossec node`, `run`, `sidecar` and `doctor`: what is done on a node's host."""
