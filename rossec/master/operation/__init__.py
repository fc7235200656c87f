"""The master as a service: configuration, limits, audit, metrics, and its process."""
