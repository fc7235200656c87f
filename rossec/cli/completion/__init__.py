"""What Tab completes: imported at each press of it, so nothing here is slow to import."""
