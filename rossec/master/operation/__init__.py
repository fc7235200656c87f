"""The master as a service: configuration, limits, audit, metrics."""
