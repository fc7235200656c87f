"""`rossec master`, and commands about a running one."""
