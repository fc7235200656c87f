"""`rossec master`, and what an operator asks about a running one."""
