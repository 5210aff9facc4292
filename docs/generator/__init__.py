"""What the pages of the site take from the program: one function per part of the reference, and what Sphinx lacks here.

Nothing that it makes is committed. Never here: what a person should say, which is in the pages.
"""
