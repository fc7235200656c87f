"""Enrollment over the network and from pictures: both sides of `docs/spec/enrollment.md`."""
