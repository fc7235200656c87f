"""The record of an authority in SQLite: requests, identities, and the log."""
