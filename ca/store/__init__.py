"""The record of an authority in SQLite: requests, identities, the log of what was signed."""
