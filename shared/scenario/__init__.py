"""Scenario files: what the radar is and assumes, what nature decides, and one line for everything that is wrong.

Never here: a computation with what they say.
"""
