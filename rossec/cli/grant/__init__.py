"""`rossec grant`."""
