"""Authorization at the master: statements, presented grants, access rules. Pure."""
