"""What the master knows: registrations and parameters. Pure."""
