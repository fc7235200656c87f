"""Secures programs that know nothing of rossec: a master of their own on loopback, and its guard."""
