"""The master as a service: configuration, limits, denials, metrics, administration."""
