"""`rossec ca`."""
