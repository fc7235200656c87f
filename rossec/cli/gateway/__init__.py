"""`rossec gateway`: topics of other domains, brought here once for everybody."""
