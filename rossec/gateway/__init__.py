"""The gateway: one copy of what another domain sends, for everybody here who may have it."""
