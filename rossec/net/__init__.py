"""The loops: asyncio around the sans-IO channel."""
