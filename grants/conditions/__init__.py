"""Conditions on time and content: a small language, read and compiled. Pure."""
