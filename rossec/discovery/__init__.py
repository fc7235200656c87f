"""Finding the master of one's own trust domain on the local link, without configuration."""
