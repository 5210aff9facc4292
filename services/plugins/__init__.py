"""For authors of things of their own: files to begin with, and checks of what they have written.

Never here: what a run needs.
"""
