"""The state of the master: registrations and parameters. Pure."""
