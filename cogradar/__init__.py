"""cogradar in Python."""
