"""The parts every kind of node shares: rights, handshakes, guards, the session with the master."""
