"""`rossec policy`, `explain`, `simulate` and `privacy`."""
