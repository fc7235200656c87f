"""Who may do what at the master: statements, grants presented, access rules. Pure."""
