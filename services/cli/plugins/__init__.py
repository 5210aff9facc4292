"""Commands for authors of things of their own."""
