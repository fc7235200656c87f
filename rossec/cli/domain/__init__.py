"""`rossec domain`: which foreign domains are trusted, how far, and until when."""
