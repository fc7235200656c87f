"""`rossec namespace`: names by rules."""
