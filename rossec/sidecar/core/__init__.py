"""What a sidecar decides about programs' calls and connections. Pure."""
