"""What every form of a node is made of: rights, handshakes, guards, the session with the master."""
