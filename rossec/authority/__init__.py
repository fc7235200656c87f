"""The authority's operations: its directory, signing, approvals, renewals, backups."""
