"""`rossec federation`: which other masters this one follows."""
